"""Cloth that passes through itself where it starts: contact cannot part it any more, so that it must be named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_pairs

__all__ = ["crossed_start_warnings", "crossing_at_start"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Flat to this share of its size a panel counts as plane.
_PLANE = 1e-9


def crossing_at_start(garment: Garment) -> Ints:
    """Sides of the cloth that pass through it at its start, as particle pairs (k, 2).

    Sides and triangles that meet in a point of a seam do not count: there they are sewn together. What lies in one
    plane does not cross, but is what exact tests take longest to say; so a plane panel is not tested against itself.
    """
    merged, panel = garment.merged_indices, garment.panel_of_particle
    number = np.where(_plane_panels(garment)[panel], panel, len(garment.panel_names) + merged)
    edges, pairs = self_crossing_pairs(garment.start, garment.triangles, number)
    sides = merged[edges[pairs[:, 0]]]
    corners = merged[garment.triangles[pairs[:, 1]]]
    apart = (sides[:, :, None] != corners[:, None, :]).all(axis=(1, 2))
    return np.asarray(edges[np.unique(pairs[apart, 0])])


def crossed_start_warnings(garment: Garment) -> tuple[str, ...]:
    """One line if the cloth passes through itself at its start, none else."""
    sides = crossing_at_start(garment)
    if len(sides) == 0:
        return ()
    names = [garment.panel_names[k] for k in np.unique(garment.panel_of_particle[sides[:, 0]])]
    shown = ", ".join(f"'{name}'" for name in names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return (
        f"garment '{garment.name}': {len(sides)} sides of panel {shown} pass through the cloth where it starts; what "
        "crosses stays where it is, and no more will cross; place the panels apart",
    )


def _plane_panels(garment: Garment) -> NDArray[np.bool_]:
    """Which panels start in one plane, (number of panels,)."""
    plane = np.zeros(len(garment.panel_names), dtype=bool)
    for k in range(len(plane)):
        x = garment.start[garment.panel_of_particle == k]
        if len(x) < 3:
            continue
        x = x - x.mean(axis=0)
        spread = np.linalg.eigvalsh(x.T @ x)  # ascending: squares of the thickness, width and length
        plane[k] = spread[0] <= _PLANE**2 * spread[2] * len(x)
    return plane
