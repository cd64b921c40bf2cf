"""How many parts of a cloth come closer to each other than layers can lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import build_tree, refit_tree
from cloth_core.closest_points import point_triangle
from cloth_core.kernel import kernel
from cloth_core.self_contact import NONE_LEFT_OUT, self_overlapping_pairs

__all__ = ["close_pairs"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Corners nearer than this many sides to a triangle are the cloth around it, not another layer.
_RINGS = 2


def close_pairs(x: Floats, triangles: Ints, distance: float, identity: Ints | None = None) -> int:
    """Number of pairs (vertex, triangle) closer than a distance [m] that are not neighbours within the cloth.

    Neighbours are those that two sides of triangles join.

    Args:
        x: positions [m], shape (n, 3).
        triangles: corner indices, shape (m, 3).
        distance: [m].
        identity: equal numbers become one point once everything is sewn, (n,); each is its own if none is given.
    """
    if len(triangles) == 0:
        return 0
    point = np.arange(len(x), dtype=np.int32) if identity is None else identity
    tree = build_tree(x, triangles)
    refit_tree(tree, x, triangles, 0.5 * distance)
    pairs = np.zeros((4096, 2), dtype=np.int32)
    found = self_overlapping_pairs(tree, NONE_LEFT_OUT, pairs)
    if found > len(pairs):
        pairs = np.zeros((found, 2), dtype=np.int32)
        found = self_overlapping_pairs(tree, NONE_LEFT_OUT, pairs)
    candidates = np.concatenate([pairs[:found], pairs[:found, ::-1]])
    corners = np.repeat(candidates[:, 1], 3), triangles[candidates[:, 0]].ravel()
    keys = np.unique(corners[0].astype(np.int64) * len(x) + corners[1])
    rows = np.stack([keys % len(x), keys // len(x)], axis=1).astype(np.int32)
    near = rows[_closer(x, triangles, rows, distance)]
    return int((~_neighbours(len(x), point[triangles], point[near[:, 0]], near[:, 1])).sum())


def _neighbours(count: int, triangles: Ints, vertex: Ints, triangle: Ints) -> NDArray[np.bool_]:
    """Which pairs of a vertex (k,) and a triangle (k,) are joined by at most so many sides; shape (k,)."""
    from scipy.sparse import coo_matrix, identity

    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    ones = np.ones(2 * len(a), dtype=bool)
    side = coo_matrix((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count)).tocsr()
    ring = (side + identity(count, dtype=bool, format="csr")).astype(bool)
    joined = ring
    for _ in range(_RINGS - 1):
        joined = (joined @ ring).astype(bool)
    near = np.zeros(len(vertex), dtype=bool)
    for k in range(3 if len(vertex) else 0):
        near |= np.asarray(joined[vertex, triangles[triangle, k]]).ravel().astype(bool)
    return near


@kernel
def _closer(x: Floats, triangles: Ints, rows: Ints, distance: float) -> NDArray[np.bool_]:
    out = np.zeros(rows.shape[0], dtype=np.bool_)
    for k in range(rows.shape[0]):
        a, b, c = triangles[rows[k, 1]]
        squared, _, _, _ = point_triangle(x[rows[k, 0]], x[a], x[b], x[c])
        out[k] = squared < distance * distance
    return out
