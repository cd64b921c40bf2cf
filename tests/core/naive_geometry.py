"""Distances and intersections as a textbook states them, for comparison: any leading dimensions, no case is clever.

All points have shape (..., 3) and are broadcast against each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["edge_edge_distance", "is_edge_intersecting_triangle", "point_triangle_distance"]

Floats = NDArray[np.float64]


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).sum(axis=-1))


def _point_segment(p: Floats, a: Floats, b: Floats) -> Floats:
    """Squared distance: the nearest point of the line, unless it lies beyond an end."""
    d = b - a
    length = _dot(d, d)
    t = np.clip(_dot(p - a, d) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    offset = a + t[..., None] * d - p
    return _dot(offset, offset)


def point_triangle_distance(p: ArrayLike, a: ArrayLike, b: ArrayLike, c: ArrayLike) -> Floats:
    """Squared distance: to the plane if the point is above the triangle, else to the nearest side."""
    p, a, b, c = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (p, a, b, c)))
    normal = np.cross(b - a, c - a)
    area = _dot(normal, normal)
    above = area > 0
    for start, end in ((a, b), (b, c), (c, a)):
        above &= _dot(np.cross(end - start, p - start), normal) >= 0
    plane = _dot(p - a, normal) ** 2 / np.where(area > 0, area, 1.0)
    sides = np.min([_point_segment(p, a, b), _point_segment(p, b, c), _point_segment(p, c, a)], axis=0)
    return np.asarray(np.where(above, plane, sides))


def edge_edge_distance(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Floats:
    """Squared distance: at the lines' common perpendicular if its feet lie on both edges, else from an end."""
    a, b, c, d = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (a, b, c, d)))
    u, v, w = b - a, d - c, c - a
    across = np.cross(u, v)
    scale = _dot(across, across)
    safe = np.where(scale > 0, scale, 1.0)
    s, t = _dot(np.cross(w, v), across) / safe, _dot(np.cross(w, u), across) / safe
    feet = (scale > 0) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    ends = np.min(
        [_point_segment(a, c, d), _point_segment(b, c, d), _point_segment(c, a, b), _point_segment(d, a, b)], axis=0
    )
    return np.asarray(np.where(feet, _dot(w, across) ** 2 / safe, ends))


def is_edge_intersecting_triangle(
    a: ArrayLike, b: ArrayLike, p: ArrayLike, q: ArrayLike, r: ArrayLike
) -> NDArray[np.bool_]:
    """Whether the ends lie on different sides of the plane, and the line turns the same way past all three sides."""
    a, b, p, q, r = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (a, b, p, q, r)))

    def volume(i: Floats, j: Floats, k: Floats, m: Floats) -> Floats:
        return _dot(np.cross(j - i, k - i), m - i)

    turns = np.sign([volume(a, b, p, q), volume(a, b, q, r), volume(a, b, r, p)])
    through = np.abs(turns.sum(axis=0)) == 3
    return np.asarray(through & (volume(p, q, r, a) * volume(p, q, r, b) < 0))
