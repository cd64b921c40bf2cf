"""Strain limit: woven cloth hardly stretches beyond its limit (the paper: at most 5 %), however hard it is pulled.

A spring that has reached the limit takes no further extension: its ends get equal and opposite impulses that only pull,
as many as needed (Provot's limit of 1995 as a unilateral constraint on velocities). No stiffness is added, so that the
stable time step stays as it is; springs well below the limit are not looked at.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel
from cloth_core.springs import SpringFamily, Springs

__all__ = [
    "StrainLimit",
    "build_strain_limit",
    "hold_strain",
    "limited_springs",
    "no_strain_limit",
    "repeat_strain_impulses",
    "watch_strain",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

# The limit that is enforced lies a little inside the fabric's, so that what is left after the sweeps stays within it.
_MARGIN = 0.97
# Springs from this share of the limit on are looked at in each step.
_WATCHED = 0.7
_SWEEPS = 4
# Time in which a spring that is too long shrinks back, to 1/e [s], and its largest speed then [m/s]: much slower, and a
# heavy load that sags a little in each step is never brought back within the limit.
_RETURN_TIME = 0.003
_RETURN_SPEED = 0.1


class StrainLimit(NamedTuple):
    """State of the limit; arrays over the springs that have one.

    Attributes:
        pairs: particles at their ends, (s, 2).
        longest: largest length allowed [m], (s,).
        watched_from: length from which a spring is looked at [m], (s,).
        impulse: what each spring gave in the last step [N s], (s,); the next step starts from it.
        watched: springs that are looked at; the first watched_count[0] count, (s,).
    """

    pairs: Ints
    longest: Floats
    watched_from: Floats
    impulse: Floats
    watched: Ints
    watched_count: Ints


def build_strain_limit(springs: Springs, limit: float) -> StrainLimit:
    """Limit the extension of the structural springs to `limit` (0.05 = 5 %)."""
    limited = limited_springs(springs)
    rest_length = springs.rest_length[limited]
    return StrainLimit(
        pairs=springs.pairs[limited],
        longest=(1.0 + _MARGIN * limit) * rest_length,
        watched_from=(1.0 + _WATCHED * limit) * rest_length,
        impulse=np.zeros(len(rest_length)),
        watched=np.zeros(len(rest_length), dtype=np.int32),
        watched_count=np.zeros(1, dtype=np.int32),
    )


def limited_springs(springs: Springs) -> Bools:
    """Which springs have a limit, (s,)."""
    return np.asarray(springs.family == SpringFamily.STRUCTURAL)


def no_strain_limit() -> StrainLimit:
    """No spring has one: nothing to watch and nothing to hold."""
    floats, ints = np.zeros(0), np.zeros(0, dtype=np.int32)
    return StrainLimit(ints.reshape(0, 2), floats, floats, floats.copy(), ints, np.zeros(1, dtype=np.int32))


@borrowing_kernel
def watch_strain(x: Floats, limit: StrainLimit) -> None:
    """Note the springs that are near their limit; x (n, 3) [m]."""
    count = 0
    for s in range(limit.longest.shape[0]):
        i, j = limit.pairs[s, 0], limit.pairs[s, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        if dx * dx + dy * dy + dz * dz > limit.watched_from[s] * limit.watched_from[s]:
            limit.watched[count] = s
            count += 1
        else:
            limit.impulse[s] = 0.0
    limit.watched_count[0] = count


@borrowing_kernel
def repeat_strain_impulses(x: Floats, v: Floats, inverse_mass: Floats, limit: StrainLimit, dt: float) -> None:
    """Give each watched spring what it needed in the last step, before contact and its friction have their say."""
    for entry in range(limit.watched_count[0]):
        s = limit.watched[entry]
        if limit.impulse[s] > 0.0:
            _pull(x, v, inverse_mass, limit.pairs[s, 0], limit.pairs[s, 1], limit.impulse[s], dt)


@borrowing_kernel
def hold_strain(x: Floats, v: Floats, inverse_mass: Floats, limit: StrainLimit, dt: float) -> None:
    """Bring the watched springs back within their limit at the end of a step, in place.

    Shapes: x, v (n, 3) [m, m/s]; inverse_mass (n,) [1/kg]; dt [s].
    """
    count = limit.watched_count[0]
    if count == 0:
        return
    for sweep in range(_SWEEPS):
        for entry in range(count):
            # Forth and back: what hangs from a spring is felt along a whole row within one sweep.
            s = limit.watched[entry if sweep % 2 == 0 else count - 1 - entry]
            i, j = limit.pairs[s, 0], limit.pairs[s, 1]
            compliance = inverse_mass[i] + inverse_mass[j]
            if compliance == 0.0:
                continue
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            excess = length - limit.longest[s]
            rate = (dx * (v[j, 0] - v[i, 0]) + dy * (v[j, 1] - v[i, 1]) + dz * (v[j, 2] - v[i, 2])) / length
            # What was within the limit may just reach it; what was beyond grows no longer.
            target = max(excess - dt * rate, 0.0)
            before = limit.impulse[s]
            limit.impulse[s] = max(before + (excess - target) / (dt * compliance), 0.0)
            _pull(x, v, inverse_mass, i, j, limit.impulse[s] - before, dt)
    # What is beyond shrinks back gently, by its place only: a velocity inwards would stay in the cloth as a swing,
    # and the next one would come on top of it.
    for entry in range(count):
        s = limit.watched[entry]
        i, j = limit.pairs[s, 0], limit.pairs[s, 1]
        compliance = inverse_mass[i] + inverse_mass[j]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        excess = length - limit.longest[s]
        if compliance == 0.0 or excess <= 0.0:
            continue
        way = min(excess * min(dt / _RETURN_TIME, 0.7), _RETURN_SPEED * dt) / (length * compliance)
        a, b = inverse_mass[i] * way, inverse_mass[j] * way
        x[i, 0] += a * dx
        x[i, 1] += a * dy
        x[i, 2] += a * dz
        x[j, 0] -= b * dx
        x[j, 1] -= b * dy
        x[j, 2] -= b * dz


@borrowing_kernel
def _pull(x: Floats, v: Floats, inverse_mass: Floats, i: int, j: int, impulse: float, dt: float) -> None:
    """Pull i and j together by an impulse [N s] along their line."""
    dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    if length < 1e-12:
        return
    a, b = inverse_mass[i] * impulse / length, inverse_mass[j] * impulse / length
    v[i, 0] += a * dx
    v[i, 1] += a * dy
    v[i, 2] += a * dz
    v[j, 0] -= b * dx
    v[j, 1] -= b * dy
    v[j, 2] -= b * dz
    x[i, 0] += a * dx * dt
    x[i, 1] += a * dy * dt
    x[i, 2] += a * dz * dt
    x[j, 0] -= b * dx * dt
    x[j, 1] -= b * dy * dt
    x[j, 2] -= b * dz * dt
