"""The square cloth of the comparison scenes as a garment of this package, and the order of its particles."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from peers import scenes

from cloth_core.garment import Garment
from cloth_core.pattern import Pattern

__all__ = ["as_grid", "sheet"]


def sheet(n: int) -> Garment:
    """A level square of scenes.SIDE at scenes.HEIGHT with n x n particles."""
    half = scenes.SIDE / 2
    panel: dict[str, Any] = {
        "translation": [0.0, scenes.HEIGHT, 0.0],  # the file has y up
        "rotation": [-90.0, 0.0, 0.0],
        "vertices": [[-half, -half], [half, -half], [half, half], [-half, half]],
        "edges": [{"endpoints": [k, (k + 1) % 4]} for k in range(4)],
    }
    data = {
        "pattern": {"panels": {"sheet": panel}, "stitches": [], "panel_order": ["sheet"]},
        "properties": {"curvature_coords": "relative", "units_in_meter": 1},
    }
    # A spacing a little too large would need one cell more.
    return Garment.from_pattern(Pattern.from_json(json.dumps(data), "sheet"), scenes.SIDE / (n - 1) * (1.0 + 1e-9))


def as_grid(garment: Garment, x: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each grid point x (n, 3) of a scene the garment's particle that starts there, shape (n,).

    Raises:
        ValueError: the garment's particles do not start on that grid.
    """
    if len(x) != garment.particle_count:
        raise ValueError(f"the sheet has {garment.particle_count} particles, the scene {len(x)}")
    ours, theirs = (np.lexsort(np.round(1e6 * p[:, :2]).T) for p in (garment.start, x))
    order = np.empty(len(x), dtype=np.int64)
    order[theirs] = ours
    worst = float(np.abs(garment.start[order] - x).max())
    if worst > 1e-6:
        raise ValueError(f"the sheet starts up to {worst:.2g} m beside the scene's grid")
    return order
