"""Sides of a triangle mesh, and which triangle stands for which vertex and side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Representatives", "representatives", "unique_edges"]

Ints = NDArray[np.int32]


class Representatives(NamedTuple):
    """Each vertex and each side of a mesh belongs to exactly one of its triangles (Curtis et al. 2008).

    Held against each other, two triangles test only what they own, so that nothing is tested twice.

    Attributes:
        edges: vertex indices of each side, shape (e, 2), lower index first, sorted.
        triangle_edges: side k of a triangle joins corners k and k + 1, shape (t, 3).
        own_vertices, own_edges: how many a triangle owns, and which (-1 where there is none), shape (t, 4).
    """

    edges: Ints
    triangle_edges: Ints
    own_vertices: Ints
    own_edges: Ints


def unique_edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Sides (e, 2), lower index first and sorted, and for each triangle its three sides (t, 3)."""
    if len(triangles) == 0:
        return np.zeros((0, 2), dtype=np.int32), np.zeros((0, 3), dtype=np.int32)
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    key = sides[:, 0].astype(np.int64) * (int(triangles.max()) + 1) + sides[:, 1]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return sides[first].astype(np.int32), inverse.reshape(-1, 3).astype(np.int32)


def representatives(triangles: Ints) -> Representatives:
    """Give each vertex and side to the first triangle that has it; triangles (t, 3)."""
    edges, triangle_edges = unique_edges(triangles)
    return Representatives(edges, triangle_edges, _owned(triangles), _owned(triangle_edges))


def _owned(table: Ints) -> Ints:
    """What is named in each row of table (t, 3) and in none before it: how many, and which, (t, 4)."""
    flat = table.reshape(-1)
    first = np.zeros(len(flat), dtype=bool)
    first[np.unique(flat, return_index=True)[1]] = True
    mine = first.reshape(-1, 3)
    # Those that are owned to the front, in their order.
    order = np.argsort(~mine, axis=1, kind="stable")
    count = mine.sum(axis=1)
    entries = np.where(np.arange(3) < count[:, None], np.take_along_axis(table, order, axis=1), -1)
    return np.ascontiguousarray(np.column_stack([count, entries]), dtype=np.int32)
