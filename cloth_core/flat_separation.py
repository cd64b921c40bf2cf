"""A quick and certain "apart" for a segment and a triangle that lie nearly in one plane.

In a flat panel every side lies in the plane of every triangle, and only exact arithmetic finds that their volumes are
zero. But two sets that have a point in common have one in every projection too: what a line separates in the projection
along the triangle's normal does not meet, whatever the volumes are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel

__all__ = ["certainly_apart"]

Floats = NDArray[np.float64]

# Error bound of the determinant below, relative to the sum of the magnitudes of its terms (Shewchuk, ccwerrboundA).
_ERROR_BOUND = (3.0 + 16.0 * 2.0**-53) * 2.0**-53


@borrowing_kernel
def certainly_apart(p: Floats, q: Floats, a: Floats, b: Floats, c: Floats) -> bool:
    """Whether segment pq and triangle abc, all (3,), surely have no point in common; False says nothing.

    Looked at in the coordinate plane that the triangle is most nearly parallel to: the segment is beyond the line of
    one of the triangle's sides, or the whole triangle is on one side of the segment's line.
    """
    u, v = _most_parallel_plane(a, b, c)
    for k in range(3):
        start, end, third = (a, b, c) if k == 0 else ((b, c, a) if k == 1 else (c, a, b))
        inside = _side(start, end, third, u, v)
        if inside != 0 and _side(start, end, p, u, v) == -inside and _side(start, end, q, u, v) == -inside:
            return True
    one = _side(p, q, a, u, v)
    return one != 0 and _side(p, q, b, u, v) == one and _side(p, q, c, u, v) == one


@inlined_kernel
def _most_parallel_plane(a: Floats, b: Floats, c: Floats) -> tuple[int, int]:
    """Two axes: those across the largest component of (b - a) x (c - a)."""
    most, axis = -1.0, 0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        component = abs((b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i]))
        if component > most:
            most, axis = component, k
    return (axis + 1) % 3, (axis + 2) % 3


@inlined_kernel
def _side(a: Floats, b: Floats, c: Floats, u: int, v: int) -> int:
    """1 if abc surely runs counter-clockwise in the plane of axes u and v, -1 if surely clockwise, 0 if not sure."""
    left = (a[u] - c[u]) * (b[v] - c[v])
    right = (a[v] - c[v]) * (b[u] - c[u])
    area, bound = left - right, _ERROR_BOUND * (abs(left) + abs(right))
    return 1 if area > bound else (-1 if area < -bound else 0)
