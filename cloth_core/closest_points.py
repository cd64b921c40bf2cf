"""Closest points of point and triangle, and of two segments (Ericson, Real-Time Collision Detection, chapter 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel

__all__ = ["away_from_triangle", "point_triangle", "segment_segment"]

Floats = NDArray[np.float64]

# Squared sine of the angle at a corner from which on a triangle is taken for a line.
_COLLAPSED = 1e-10


# Below are numbers as arguments instead of arrays: those come in several layouts, each of which is compiled by itself.


@inlined_kernel
def _squared(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z


@borrowing_kernel
def _segment_segment(
    px: float, py: float, pz: float, qx: float, qy: float, qz: float,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
) -> tuple[float, float, float]:  # fmt: skip
    """As `segment_segment`."""
    ux, uy, uz = qx - px, qy - py, qz - pz
    wx, wy, wz = bx - ax, by - ay, bz - az
    rx, ry, rz = px - ax, py - ay, pz - az
    uu = ux * ux + uy * uy + uz * uz
    ww = wx * wx + wy * wy + wz * wz
    wr = wx * rx + wy * ry + wz * rz
    ur = ux * rx + uy * ry + uz * rz
    uw = ux * wx + uy * wy + uz * wz
    if uu <= 0.0 and ww <= 0.0:
        s, t = 0.0, 0.0
    elif uu <= 0.0:
        s, t = 0.0, min(max(wr / ww, 0.0), 1.0)
    elif ww <= 0.0:
        s, t = min(max(-ur / uu, 0.0), 1.0), 0.0
    else:
        whole = uu * ww - uw * uw
        s = min(max((uw * wr - ur * ww) / whole, 0.0), 1.0) if whole > 1e-12 * uu * ww else 0.0
        t = (uw * s + wr) / ww
        if t < 0.0:
            t = 0.0
            s = min(max(-ur / uu, 0.0), 1.0)
        elif t > 1.0:
            t = 1.0
            s = min(max((uw - ur) / uu, 0.0), 1.0)
    dx = rx + s * ux - t * wx
    dy = ry + s * uy - t * wy
    dz = rz + s * uz - t * wz
    return dx * dx + dy * dy + dz * dz, s, t


@borrowing_kernel
def _nearest_side(
    px: float, py: float, pz: float, ax: float, ay: float, az: float,
    bx: float, by: float, bz: float, cx: float, cy: float, cz: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """As `point_triangle`, for a triangle that has collapsed to a line: rounding would decide where its face is."""
    s, _, ab = _segment_segment(px, py, pz, px, py, pz, ax, ay, az, bx, by, bz)
    squared, u, v, w = s, 1.0 - ab, ab, 0.0
    s, _, bc = _segment_segment(px, py, pz, px, py, pz, bx, by, bz, cx, cy, cz)
    if s < squared:
        squared, u, v, w = s, 0.0, 1.0 - bc, bc
    s, _, ca = _segment_segment(px, py, pz, px, py, pz, cx, cy, cz, ax, ay, az)
    if s < squared:
        squared, u, v, w = s, ca, 0.0, 1.0 - ca
    return squared, u, v, w


@borrowing_kernel
def _point_triangle(
    px: float, py: float, pz: float, ax: float, ay: float, az: float,
    bx: float, by: float, bz: float, cx: float, cy: float, cz: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """As `point_triangle`."""
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    apx, apy, apz = px - ax, py - ay, pz - az
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return _squared(apx, apy, apz), 1.0, 0.0, 0.0
    bpx, bpy, bpz = px - bx, py - by, pz - bz
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return _squared(bpx, bpy, bpz), 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 - d3 > 0.0:
        t = d1 / (d1 - d3)
        return _squared(apx - t * abx, apy - t * aby, apz - t * abz), 1.0 - t, t, 0.0
    cpx, cpy, cpz = px - cx, py - cy, pz - cz
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return _squared(cpx, cpy, cpz), 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 - d6 > 0.0:
        t = d2 / (d2 - d6)
        return _squared(apx - t * acx, apy - t * acy, apz - t * acz), 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / (d4 - d3 + d5 - d6) if d4 - d3 + d5 - d6 > 0.0 else 0.0
        return (
            _squared(bpx - t * (cx - bx), bpy - t * (cy - by), bpz - t * (cz - bz)),
            0.0,
            1.0 - t,
            t,
        )
    whole = va + vb + vc
    if whole <= _COLLAPSED * (abx * abx + aby * aby + abz * abz) * (acx * acx + acy * acy + acz * acz):
        return _nearest_side(px, py, pz, ax, ay, az, bx, by, bz, cx, cy, cz)
    v, w = vb / whole, vc / whole
    return _squared(apx - v * abx - w * acx, apy - v * aby - w * acy, apz - v * abz - w * acz), 1.0 - v - w, v, w


@borrowing_kernel
def segment_segment(p: Floats, q: Floats, a: Floats, b: Floats) -> tuple[float, float, float]:
    """Squared distance [m^2] of segments pq and ab; where the closest points lie, s along pq, t along ab; all (3,)."""
    return _segment_segment(p[0], p[1], p[2], q[0], q[1], q[2], a[0], a[1], a[2], b[0], b[1], b[2])


@borrowing_kernel
def point_triangle(p: Floats, a: Floats, b: Floats, c: Floats) -> tuple[float, float, float, float]:
    """Squared distance [m^2] of p to triangle abc and the barycentric coordinates of its closest point; all (3,)."""
    return _point_triangle(p[0], p[1], p[2], a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])


@inlined_kernel
def away_from_triangle(
    p: Floats, a: Floats, b: Floats, c: Floats, u: float, v: float, w: float, distance: float
) -> tuple[float, float, float]:
    """Unit vector to p from the point of triangle abc with these barycentric coordinates, so far away [m]; all (3,)."""
    nx = (p[0] - u * a[0] - v * b[0] - w * c[0]) / distance
    ny = (p[1] - u * a[1] - v * b[1] - w * c[1]) / distance
    nz = (p[2] - u * a[2] - v * b[2] - w * c[2]) / distance
    return nx, ny, nz
