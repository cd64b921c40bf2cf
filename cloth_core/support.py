"""Whether anything can hold a garment up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.scene import Scene

__all__ = ["why_unsupported"]

Floats = NDArray[np.float64]

# Cloth has fallen past a body when all of it is lower than the body by this [m].
_PAST = 0.05


def why_unsupported(scene: Scene, x: Floats) -> str | None:
    """Why nothing holds cloth at x (n, 3) [m] up for ever; None if something may, or if nothing pulls it down."""
    if not any(scene.gravity) or len(scene.pins) > 0:
        return None
    if scene.body is None:
        return "nothing supports the garment: there is neither a body nor a pin"
    if float(x[:, 2].max()) < float(scene.body.vertices[:, 2].min()) - _PAST:
        return "not supported by the body: it has fallen past it"
    return None
