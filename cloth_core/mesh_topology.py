"""Sides of a triangle mesh, neighbours of its vertices, and which triangle stands for which vertex and side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel, zero

__all__ = ["Representatives", "point_neighbours", "representatives", "unique_edges"]

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
    return _unique_edges(np.ascontiguousarray(triangles, dtype=np.int32))


def representatives(triangles: Ints) -> Representatives:
    """Give each vertex and side to the first triangle that has it; triangles (t, 3)."""
    edges, triangle_edges = unique_edges(triangles)
    own_vertices = _owned(np.ascontiguousarray(triangles, dtype=np.int32))
    return Representatives(edges, triangle_edges, own_vertices, _owned(triangle_edges))


def point_neighbours(triangles: Ints) -> tuple[Ints, Ints]:
    """Neighbours of each point as a compressed list: start (k + 1,) and sorted neighbours; triangles (t, 3)."""
    edges, _ = unique_edges(triangles)
    return _both_ways(edges, int(triangles.max()) + 1)


@kernel
def _unique_edges(triangles: Ints) -> tuple[Ints, Ints]:
    count = 3 * triangles.shape[0]
    sides = np.empty((count, 2), dtype=np.int32)
    vertices = zero()
    for t in range(triangles.shape[0]):
        for k in range(3):
            i, j = triangles[t, k], triangles[t, (k + 1) % 3]
            sides[3 * t + k, 0], sides[3 * t + k, 1] = min(i, j), max(i, j)
            vertices = max(vertices, max(i, j) + 1)
    order = _sorted_by(sides[:, 0], _sorted_by(sides[:, 1], np.arange(count), vertices), vertices)
    edges = np.empty((count, 2), dtype=np.int32)
    triangle_edges = np.empty((triangles.shape[0], 3), dtype=np.int32)
    last = -1
    for side in order:
        if last < 0 or edges[last, 0] != sides[side, 0] or edges[last, 1] != sides[side, 1]:
            last += 1
            edges[last] = sides[side]
        triangle_edges[side // 3, side % 3] = last
    return edges[: last + 1].copy(), triangle_edges


@kernel
def _sorted_by(key: Ints, order: NDArray[np.int64], keys: int) -> NDArray[np.int64]:
    """The entries of `order` by their key (n,), 0 to keys - 1; equal ones stay as they are (counting sort)."""
    place = np.zeros(keys + 1, dtype=np.int64)
    for entry in order:
        place[key[entry] + 1] += 1
    for k in range(keys):
        place[k + 1] += place[k]
    result = np.empty_like(order)
    for entry in order:
        result[place[key[entry]]] = entry
        place[key[entry]] += 1
    return result


@kernel
def _owned(table: Ints) -> Ints:
    """What is named in each row of table (t, 3) and in none before it: how many, and which, (t, 4)."""
    owned = np.full((table.shape[0], 4), -1, dtype=np.int32)
    named = np.zeros(table.max() + 1 if table.size > 0 else 0, dtype=np.bool_)
    for row in range(table.shape[0]):
        count = 0
        for entry in table[row]:
            if not named[entry]:
                named[entry] = True
                count += 1
                owned[row, count] = entry
        owned[row, 0] = count
    return owned


@kernel
def _both_ways(edges: Ints, points: int) -> tuple[Ints, Ints]:
    """Compressed list of what each point shares a side with; edges (e, 2) as from `unique_edges`."""
    start = np.zeros(points + 1, dtype=np.int32)
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        start[j + 1] += 1
        if i != j:
            start[i + 1] += 1
    for point in range(points):
        start[point + 1] += start[point]
    neighbours = np.empty(start[points], dtype=np.int32)
    place = start.copy()
    # The sides are sorted: first all lower neighbours of a point, then all higher ones, each in their order.
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        neighbours[place[j]] = i
        place[j] += 1
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        if i != j:
            neighbours[place[i]] = j
            place[i] += 1
    return start, neighbours
