"""Distances of many pairs at once: segments from segments, points from triangles; eight pairs at a time.

A broad phase measures tens of thousands of pairs, most of them only to find that they are too far apart. Where the
closest points lie does not matter then, so that the distance is all that is computed, without a branch. The formulas
are those of `cloth_core.closest_points` and `tests/core/naive_geometry.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel
from cloth_core.lanes import LANES, fill, larger, load, smaller, store, where_positive

__all__ = ["point_triangle_distances", "segment_distances"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Squared lengths below this are none [m^2]: a segment of no length is a point.
_NO_LENGTH = 1e-200
# Squared sine of the angle at a corner from which on a triangle is taken for a line, as in `closest_points`.
_COLLAPSED = 1e-10


@kernel
def segment_distances(x: Floats, edges: Ints, y: Floats, others: Ints, pairs: Ints) -> Floats:
    """Distances (s,) [m] of edges[i], ends in x, to others[j], ends in y, for each (i, j) of pairs.

    Shapes: x (n, 3), y (m, 3) [m]; edges, others (any, 2); pairs (s, 2).
    """
    ends = np.empty(12 * LANES)
    squared = np.empty(LANES)
    count = pairs.shape[0]
    distance = np.empty(count)
    for block in range(0, count, LANES):
        for lane in range(LANES):
            row = min(block + lane, count - 1)  # the last block repeats the last pair
            i, j = pairs[row, 0], pairs[row, 1]
            p, q, a, b = edges[i, 0], edges[i, 1], others[j, 0], others[j, 1]
            _put(ends, 0, lane, x, p)
            _put(ends, 1, lane, x, q)
            _put(ends, 2, lane, y, a)
            _put(ends, 3, lane, y, b)
        store(squared, 0, _segments(ends))
        for lane in range(min(LANES, count - block)):
            distance[block + lane] = np.sqrt(squared[lane])
    return distance


@kernel
def point_triangle_distances(points: Floats, vertices: Floats, triangles: Ints, pairs: Ints) -> Floats:
    """Distances (s,) [m] of points[i] to triangles[j], corners in vertices, for each (i, j) of pairs.

    Shapes: points (n, 3), vertices (m, 3) [m]; triangles (t, 3); pairs (s, 2).
    """
    ends = np.empty(12 * LANES)
    squared = np.empty(LANES)
    count = pairs.shape[0]
    distance = np.empty(count)
    for block in range(0, count, LANES):
        for lane in range(LANES):
            row = min(block + lane, count - 1)
            p, j = pairs[row, 0], pairs[row, 1]
            a, b, c = triangles[j, 0], triangles[j, 1], triangles[j, 2]
            _put(ends, 0, lane, points, p)
            _put(ends, 1, lane, vertices, a)
            _put(ends, 2, lane, vertices, b)
            _put(ends, 3, lane, vertices, c)
        store(squared, 0, _points_and_triangles(ends))
        for lane in range(min(LANES, count - block)):
            distance[block + lane] = np.sqrt(squared[lane])
    return distance


@inlined_kernel
def _put(ends: Floats, which: int, lane: int, points: Floats, i: int) -> None:
    """Write point i of points (n, 3) to a lane, as number `which` (0 to 3) of the four points of its pair."""
    for axis in range(3):
        ends[(3 * which + axis) * LANES + lane] = points[i, axis]


@inlined_kernel
def _dot(ax: Any, ay: Any, az: Any, bx: Any, by: Any, bz: Any) -> Any:
    return ax * bx + ay * by + az * bz


@borrowing_kernel
def _segments(ends: Floats) -> Any:
    """Squared distances of eight pairs of segments; ends: 12 coordinates, of eight pairs each."""
    zero, one, least = fill(0.0), fill(1.0), fill(_NO_LENGTH)
    px, py, pz = load(ends, 0), load(ends, LANES), load(ends, 2 * LANES)
    ax, ay, az = load(ends, 6 * LANES), load(ends, 7 * LANES), load(ends, 8 * LANES)
    ux, uy, uz = load(ends, 3 * LANES) - px, load(ends, 4 * LANES) - py, load(ends, 5 * LANES) - pz
    wx, wy, wz = load(ends, 9 * LANES) - ax, load(ends, 10 * LANES) - ay, load(ends, 11 * LANES) - az
    rx, ry, rz = px - ax, py - ay, pz - az
    uu, ww = larger(_dot(ux, uy, uz, ux, uy, uz), least), larger(_dot(wx, wy, wz, wx, wy, wz), least)
    uw, ur, wr = _dot(ux, uy, uz, wx, wy, wz), _dot(ux, uy, uz, rx, ry, rz), _dot(wx, wy, wz, rx, ry, rz)
    # Nearest points of the two lines; between parallel ones any will do.
    s = (uw * wr - ur * ww) / larger(uu * ww - uw * uw, fill(1e-12) * uu * ww)
    s = smaller(larger(s, zero), one)
    # The nearest point of the second segment to that, and the nearest of the first to this one.
    t = smaller(larger((uw * s + wr) / ww, zero), one)
    s = smaller(larger((uw * t - ur) / uu, zero), one)
    dx, dy, dz = rx + s * ux - t * wx, ry + s * uy - t * wy, rz + s * uz - t * wz
    return _dot(dx, dy, dz, dx, dy, dz)


@borrowing_kernel
def _points_and_triangles(ends: Floats) -> Any:
    """Squared distances of eight points to eight triangles; ends: 12 coordinates, of eight pairs each."""
    px, py, pz = load(ends, 0), load(ends, LANES), load(ends, 2 * LANES)
    ax, ay, az = load(ends, 3 * LANES), load(ends, 4 * LANES), load(ends, 5 * LANES)
    bx, by, bz = load(ends, 6 * LANES), load(ends, 7 * LANES), load(ends, 8 * LANES)
    cx, cy, cz = load(ends, 9 * LANES), load(ends, 10 * LANES), load(ends, 11 * LANES)
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - bx, cy - by, cz - bz
    wx, wy, wz = ax - cx, ay - cy, az - cz
    nx, ny, nz = uz * wy - uy * wz, ux * wz - uz * wx, uy * wx - ux * wy
    normal = _dot(nx, ny, nz, nx, ny, nz)
    ex, ey, ez = px - ax, py - ay, pz - az
    fx, fy, fz = px - bx, py - by, pz - bz
    gx, gy, gz = px - cx, py - cy, pz - cz
    sides = smaller(
        smaller(_from_side(ex, ey, ez, ux, uy, uz), _from_side(fx, fy, fz, vx, vy, vz)),
        _from_side(gx, gy, gz, wx, wy, wz),
    )
    inside = smaller(
        smaller(_left_of(ex, ey, ez, ux, uy, uz, nx, ny, nz), _left_of(fx, fy, fz, vx, vy, vz, nx, ny, nz)),
        _left_of(gx, gy, gz, wx, wy, wz, nx, ny, nz),
    )
    flat = normal - fill(_COLLAPSED) * _dot(ux, uy, uz, ux, uy, uz) * _dot(wx, wy, wz, wx, wy, wz)
    height = _dot(ex, ey, ez, nx, ny, nz)
    plane = height * height / larger(normal, fill(_NO_LENGTH))
    return where_positive(smaller(inside, flat), plane, sides)


@inlined_kernel
def _from_side(ex: Any, ey: Any, ez: Any, ux: Any, uy: Any, uz: Any) -> Any:
    """Squared distance of points to the segments u that begin at -e from them."""
    along = _dot(ex, ey, ez, ux, uy, uz) / larger(_dot(ux, uy, uz, ux, uy, uz), fill(_NO_LENGTH))
    along = smaller(larger(along, fill(0.0)), fill(1.0))
    dx, dy, dz = ex - along * ux, ey - along * uy, ez - along * uz
    return _dot(dx, dy, dz, dx, dy, dz)


@inlined_kernel
def _left_of(ex: Any, ey: Any, ez: Any, ux: Any, uy: Any, uz: Any, nx: Any, ny: Any, nz: Any) -> Any:
    """Above 0 where a point lies on the triangle's side of the side u, seen along the normal n."""
    return _dot(uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex, nx, ny, nz)
