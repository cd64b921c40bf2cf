"""What friction between yarns would do to drape: a strip that overhangs 60 mm, bent from flat by its growing weight.

    python benchmarks/bending_friction.py

Kawabata's bending test finds M = B kappa + HB while curvature grows, HB being half of the hysteresis 2HB. A strip then
stays straight where the moment of its weight is less than HB. Its reach is that of Cusick's disc along one radius; the
disc itself is held out further by its hoop, so that only differences say something. Six denims (J. Textiles 2016,
4614168, table 5) have HB / B = 23 to 54 1/m.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "core"))

from apparatus import GRAVITY
from cusick import DISC_RADIUS, PUBLISHED, SUPPORT_RADIUS

# HB / B [1/m].
FRICTION = (0.0, 23.0, 48.0)
_PARTS, _ITERATIONS, _SHARE = 400, 4000, 0.1


def reach(bending: float, weight: float, length: float, friction: float) -> float:
    """Horizontal reach [m] of a strip of bending stiffness [N m], weight per area [N/m^2], length [m] and HB [N].

    The angle's derivative is (M - HB) / B where M > HB, else 0; M(s) = weight * integral of x(u) - x(s) from s on.
    """
    ds = length / _PARTS
    s = np.linspace(0.0, length, _PARTS + 1)
    angle = np.zeros(_PARTS + 1)
    x = s
    for _ in range(_ITERATIONS):
        middle = 0.5 * (angle[1:] + angle[:-1])
        x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * ds)])
        beyond = np.concatenate([np.cumsum(0.5 * (x[1:] + x[:-1])[::-1] * ds)[::-1], [0.0]])
        moment = weight * (beyond - x * (length - s))
        curvature = np.maximum(moment - friction, 0.0) / bending
        wanted = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * ds)])
        if np.abs(wanted - angle).max() < 1e-9:
            break
        angle += _SHARE * (wanted - angle)
    return float(x[-1])


def main() -> None:
    """Prints the table."""
    length, support, cloth = DISC_RADIUS - SUPPORT_RADIUS, SUPPORT_RADIUS**2, DISC_RADIUS**2
    print("fabric: (radius^2 - support^2) / (disc^2 - support^2) [%] of a strip with HB / B =", FRICTION, "1/m")
    for name, (area_density, _, bending, published, _) in PUBLISHED.items():
        shares = []
        for friction in FRICTION:
            radius = SUPPORT_RADIUS + reach(bending, area_density * GRAVITY, length, bending * friction)
            shares.append(100.0 * (radius**2 - support) / (cloth - support))
        print(f"{name}: {', '.join(f'{share:.0f}' for share in shares)} (disc, published: {published:g})")


if __name__ == "__main__":
    main()
