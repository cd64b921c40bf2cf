"""Error of a drape, one definition: how far its surface lies from the surface of the converged solution.

Points of each surface are held against the other surface, both ways, and the distances summed up by area. Where both
drapes are of the same pattern, the points of a panel are held against the *same* panel: otherwise the front of a flat
garment that has slid onto its back would count as right, a fold would be measured against the next fold, and the figure
would be an underestimate; a tolerance must not be promised on one. What a panel slides within its own surface is not
seen either way (that is a surface's nature); where its outline lies is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree
from cloth_core.errors import ClothError
from cloth_core.mesh_distance import distances_to_mesh

__all__ = ["Drape", "DrapeError", "drape_error", "motion_error", "sample_points"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Distance of sample points [m]: well below the spacing of any garment, so that the samples resolve its triangles.
_SAMPLE_SPACING = 0.005


@dataclass(frozen=True)
class Drape:
    """A surface in space.

    Attributes:
        positions: [m], shape (n, 3).
        triangles: corner indices, shape (m, 3).
        panels: panel of each triangle, shape (m,).
        panel_names: what these numbers stand for; two drapes of one pattern have the same names.
    """

    positions: Floats
    triangles: Ints
    panels: Ints
    panel_names: tuple[str, ...]

    @classmethod
    def of_surface(cls, positions: Floats, triangles: Ints) -> Drape:
        """A surface without panels."""
        return cls(positions, triangles, np.zeros(len(triangles), dtype=np.int32), ("",))


@dataclass(frozen=True)
class DrapeError:
    """Distance of two drapes [m].

    Attributes:
        rms: root of the mean of the squared distances, the mean of both ways.
        largest: of all distances, both ways.
        rms_of_panel: the same as rms for each panel by its name.
    """

    rms: float
    largest: float
    rms_of_panel: dict[str, float]


def sample_points(positions: Floats, triangles: Ints, spacing: float = _SAMPLE_SPACING) -> tuple[Floats, Floats]:
    """Points spread evenly over triangles, and the area that each stands for.

    Each triangle is cut into k^2 like ones, so small that no side is longer than the spacing; a point lies in the
    centroid of each.

    Args:
        positions: [m], shape (n, 3).
        triangles: corner indices, shape (m, 3).
        spacing: longest side of the parts [m].

    Returns:
        points [m], shape (p, 3), and areas [m^2], shape (p,).
    """
    corner = positions[triangles]
    sides = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2.0
    cuts = np.maximum(np.ceil(sides / spacing - 1e-9).astype(int), 1)
    points, areas = [np.zeros((0, 3))], [np.zeros(0)]
    for k in np.unique(cuts):
        own = cuts == k
        weights = _centroids(int(k))
        points.append(np.einsum("pc,tcx->tpx", weights, corner[own]).reshape(-1, 3))
        areas.append(np.repeat(area[own] / k**2, k**2))
    return np.concatenate(points), np.concatenate(areas)


def drape_error(first: Drape, second: Drape, spacing: float = _SAMPLE_SPACING) -> DrapeError:
    """Distance of two drapes; symmetric. Panels are held against panels of the same name where both have the same ones.

    The corners of the triangles count for the largest distance; they have no area of their own for the mean.

    Args:
        first, second: the drapes.
        spacing: of the sample points [m].

    Raises:
        ClothError: a drape has no triangle, or a position that is not finite.
    """
    for drape in (first, second):
        if len(drape.triangles) == 0:
            raise ClothError("drape error: a drape without triangles has no surface; give one that was simulated")
        if not np.isfinite(drape.positions).all():
            raise ClothError("drape error: a position is not finite; the run that made it has failed")
    by_panel = first.panel_names == second.panel_names and len(first.panel_names) > 1
    names = first.panel_names if by_panel else ("",)
    squared = np.zeros((len(names), 2))
    area = np.zeros((len(names), 2))
    largest = 0.0
    for k in range(len(names)):
        parts = [_part(drape, k if by_panel else None) for drape in (first, second)]
        for way in range(2):
            points, weights, corners = _samples(parts[way], spacing)
            vertices, triangles, tree = parts[1 - way]
            distance = distances_to_mesh(points, vertices, triangles, tree)
            squared[k, way] = weights @ distance**2
            area[k, way] = weights.sum()
            largest = max(largest, float(distance.max()))
            largest = max(largest, float(distances_to_mesh(corners, vertices, triangles, tree).max()))
    whole = float(np.sqrt((squared.sum(axis=0) / area.sum(axis=0)).mean()))
    each = np.sqrt((squared / area).mean(axis=1))
    return DrapeError(whole, largest, {name: float(rms) for name, rms in zip(names, each, strict=True) if name})


def motion_error(
    first: Sequence[Drape], second: Sequence[Drape], spacing: float = _SAMPLE_SPACING
) -> tuple[list[DrapeError], float]:
    """Distance of two motions at the same times: at each of them, and its RMS over the times [m].

    Raises:
        ClothError: they do not have the same number of times, or none.
    """
    if len(first) != len(second) or not first:
        raise ClothError(f"motion error: {len(first)} and {len(second)} times; give the same times of both, at least 1")
    errors = [drape_error(a, b, spacing) for a, b in zip(first, second, strict=True)]
    return errors, math.sqrt(sum(e.rms**2 for e in errors) / len(errors))


def _part(drape: Drape, panel: int | None) -> tuple[Floats, Ints, AabbTree]:
    triangles = drape.triangles if panel is None else drape.triangles[drape.panels == panel]
    vertices = np.ascontiguousarray(drape.positions, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    return vertices, triangles, build_tree(vertices, triangles)


def _samples(part: tuple[Floats, Ints, AabbTree], spacing: float) -> tuple[Floats, Floats, Floats]:
    vertices, triangles, _ = part
    points, weights = sample_points(vertices, triangles, spacing)
    return points, weights, vertices[np.unique(triangles)]


def _centroids(k: int) -> Floats:
    """Barycentric coordinates of the centroids of the k^2 like parts of a triangle, shape (k^2, 3)."""
    i, j = np.meshgrid(np.arange(k), np.arange(k), indexing="ij")
    upright = i + j < k
    inverted = i + j < k - 1
    u = np.concatenate([i[upright] + 1.0 / 3.0, i[inverted] + 2.0 / 3.0]) / k
    v = np.concatenate([j[upright] + 1.0 / 3.0, j[inverted] + 2.0 / 3.0]) / k
    return np.stack([u, v, 1.0 - u - v], axis=1)
