"""Takes single sides of cloth out of each other by moving a few points by a few millimetres.

What merges moves by half of its gap, and where cloth lies close beside it something may cross then that did not before.
The search is greedy and local: it is meant for the last few crossings of a seam, not for cloth that is entangled.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.intersections import crossing_pairs, self_crossing_pairs

__all__ = ["nudged_apart"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Ways that are tried [m], the shortest first, in each of 26 directions: to all neighbours in a lattice.
_WAYS = (0.0005, 0.001, 0.002, 0.004)
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
# More crossings than this are left alone.
_MOST = 16


def nudged_apart(x: Floats, triangles: Ints, body: Body | None, allowed: int) -> tuple[Floats, int]:
    """Positions in which at most `allowed` sides cross cloth or body, if moving single points by up to 4 mm does it.

    Args:
        x: positions [m], (n, 3).
        triangles: (m, 3).
        body: or None.
        allowed: how many sides may cross.

    Returns:
        positions [m], (n, 3), and how many sides cross there: never more than at x.
    """
    count, at = _crossings(x, triangles, body)
    if count <= allowed or count > _MOST:
        return x, count
    # Nothing but the triangles of a point that moves can change how much crosses.
    low, high = x[at].min(axis=0), x[at].max(axis=0)
    longest = np.linalg.norm(x[triangles[:, 0]] - x[triangles[:, 1]], axis=1).max() + max(_WAYS)
    corner = x[triangles]
    near = ((corner.min(axis=1) <= high + 2.0 * longest) & (corner.max(axis=1) >= low - 2.0 * longest)).all(axis=1)
    nearby = np.ascontiguousarray(triangles[near])
    elsewhere = count - _crossings(x, nearby, body)[0]
    x = x.copy()
    while count > allowed:
        better = _better(x, nearby, body, at, count - elsewhere)
        if better is None:
            break
        point, place = better
        x[point] = place
        local, at = _crossings(x, nearby, body)
        count = elsewhere + local
    return x, count


def _better(x: Floats, triangles: Ints, body: Body | None, points: Ints, count: int) -> tuple[int, Floats] | None:
    """A point and the nearest place for it at which fewer than `count` sides cross."""
    for way in _WAYS:
        for point in points.tolist():
            before = x[point].copy()
            for direction in _DIRECTIONS:
                x[point] = before + way * direction
                if _crossings(x, triangles, body)[0] < count:
                    place = x[point].copy()
                    x[point] = before
                    return point, place
            x[point] = before
    return None


def _crossings(x: Floats, triangles: Ints, body: Body | None) -> tuple[int, Ints]:
    """How many sides cross, and the points of what crosses."""
    edges, pairs = self_crossing_pairs(x, triangles)
    count = len(np.unique(pairs[:, 0]))
    points = [edges[pairs[:, 0]].ravel(), triangles[pairs[:, 1]].ravel()]
    if body is not None:
        edges, pairs = crossing_pairs(x, triangles, body.vertices, body.triangles, body.tree)
        count += len(np.unique(pairs[:, 0]))
        points.append(edges[pairs[:, 0]].ravel())
    return count, np.unique(np.concatenate(points))
