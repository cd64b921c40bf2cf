"""Scenes that come to rest within a second: a handkerchief above a box."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

__all__ = ["BOX_TRIANGLES", "BOX_VERTICES", "handkerchief"]

BOX_VERTICES: NDArray[np.float64] = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1.0, 1.0)])
"""Corners of a box of 20 cm around the origin [m]."""
BOX_TRIANGLES: NDArray[np.int32] = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int32,
)  # fmt: skip


def handkerchief(size: float = 0.3) -> str:
    """Pattern of a level square of `size` [m], 5 cm above the box, as JSON."""
    half = size / 2
    panel = {
        "translation": [0.0, 0.15, 0.0],
        "rotation": [-90.0, 0.0, 0.0],
        "vertices": [[-half, -half], [half, -half], [half, half], [-half, half]],
        "edges": [{"endpoints": [corner, (corner + 1) % 4]} for corner in range(4)],
    }
    return json.dumps(
        {
            "pattern": {"panels": {"cloth": panel}, "stitches": []},
            "properties": {"units_in_meter": 1, "curvature_coords": "relative"},
        }
    )
