"""Whether anything can hold a garment up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.scene import Scene

__all__ = ["PATIENCE_WITH_FALLEN", "why_fallen", "why_unsupported"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Cloth has fallen past a body when all of it is lower than the body by this [m].
_PAST = 0.05
# How long the rest of a garment is waited for when a part of it has fallen past the body, which will not come back [s].
PATIENCE_WITH_FALLEN = 1.5


def why_unsupported(scene: Scene, x: Floats) -> str | None:
    """Why nothing holds cloth at x (n, 3) [m] up for ever; None if something may, or if nothing pulls it down."""
    if not any(scene.gravity) or len(scene.pins) > 0:
        return None
    if scene.body is None:
        return "nothing supports the garment: there is neither a body nor a pin"
    if float(x[:, 2].max()) < scene.body.lowest - _PAST:
        return "not supported by the body: it has fallen past it"
    return None


def why_fallen(scene: Scene, number: Ints, x: Floats, particle: int) -> str:
    """One line if a particle of x (k, 3) [m] is of a part that has fallen past the body, empty else; number as `Model`.

    The rest of the garment may hang well: a part that is sewn to nothing, a pocket for example, comes off by itself.
    """
    if scene.body is None or not any(scene.gravity):
        return ""
    if float(x[particle, 2]) >= scene.body.lowest - _PAST:
        return ""
    garment = scene.garment
    panel = garment.panel_names[garment.panel_of_particle[int(np.flatnonzero(number == particle)[0])]]
    return (
        f"panel '{panel}' is not supported by the body: it has fallen past it; see whether its garment is too wide, or "
        "sew it to what it belongs to"
    )
