"""All pairs of a cloth's parts by textbook formulas, how far they may travel together, and cloth to try it on."""

from __future__ import annotations

from typing import NamedTuple

import naive_geometry
import numpy as np
from scipy.spatial.transform import Rotation

from cloth_core.garment import Garment

__all__ = ["AllPairs", "all_pairs", "crumpled", "free_ways"]


class AllPairs(NamedTuple):
    """Each vertex against each triangle, each side against each other one, without a common corner.

    rows (k, 4): vertex and the triangle's corners, or two of each side; parts: how many of them are the first part's.
    """

    vertices: np.ndarray
    vertex_distance: np.ndarray
    sides: np.ndarray
    side_distance: np.ndarray


def all_pairs(x: np.ndarray, triangles: np.ndarray, identity: np.ndarray) -> AllPairs:
    used = np.unique(triangles)
    i, t = (a.ravel() for a in np.meshgrid(used, np.arange(len(triangles)), indexing="ij"))
    vertices = np.column_stack([i, triangles[t]])
    sides = np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    one, other = np.triu_indices(len(sides), 1)
    pairs = np.column_stack([sides[one], sides[other]])
    vertices = vertices[(identity[vertices[:, :1]] != identity[vertices[:, 1:]]).all(axis=1)]
    ends = identity[pairs]
    pairs = pairs[(ends[:, :2, None] != ends[:, None, 2:]).all(axis=(1, 2))]
    p, e = x[vertices], x[pairs]
    return AllPairs(
        vertices,
        np.sqrt(naive_geometry.point_triangle_distance(p[:, 0], p[:, 1], p[:, 2], p[:, 3])),
        pairs,
        np.sqrt(naive_geometry.edge_edge_distance(e[:, 0], e[:, 1], e[:, 2], e[:, 3])),
    )


def free_ways(x: np.ndarray, travel: np.ndarray, every: AllPairs) -> tuple[np.ndarray, np.ndarray]:
    """For all pairs how far both parts together may travel, and their distance."""
    v, e = travel[every.vertices], travel[every.sides]
    together = np.concatenate([v[:, 0] + v[:, 1:].max(axis=1), e[:, :2].max(axis=1) + e[:, 2:].max(axis=1)])
    return together, np.concatenate([every.vertex_distance, every.side_distance])


def crumpled(garment: Garment, seed: int) -> np.ndarray:
    """The particles anywhere in a ball of half the garment's size, neighbours not too far from each other."""
    rng = np.random.default_rng(seed)
    x = garment.start - garment.start.mean(axis=0)
    x = 0.6 * x @ Rotation.random(random_state=seed).as_matrix()
    for wave in rng.normal(size=(6, 3)):
        x = x + 0.02 * rng.normal(size=3) * np.sin(60 * (x @ wave) + rng.uniform(0, 6))[:, None]
    return np.asarray(x + 0.002 * rng.normal(size=x.shape))
