"""Generalised winding number: how often a surface goes round a point, also where it has holes or overlaps itself.

It is 1 inside and 0 outside of a closed surface, changes smoothly across a hole, and adds up over shells (Jacobson et
al., "Robust inside-outside segmentation using generalized winding numbers", 2013). A group of triangles that is far
away for its size counts as one dipole with its first correction (Barill et al., "Fast winding numbers for soups and
clouds", 2018).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import DEPTH, AabbTree
from cloth_core.kernel import borrowing_kernel, kernel

__all__ = ["Dipoles", "dipoles", "winding_numbers"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# A node counts as one dipole from this many radii on; the sum is then right to about 0.01.
_FAR = 2.5


class Dipoles(NamedTuple):
    """The triangles below each node of a tree with k nodes, as one.

    Attributes:
        centre: mean of the triangles' centres, weighted by area [m], (k, 3).
        moment: sum of the triangles' normals times area [m^2], (k, 3).
        spread: sum of (triangle's centre - centre) times normal times area, as outer products [m^3], (k, 3, 3).
        radius: from the centre to the farthest corner of the node's box [m], (k,).
        area: [m^2], (k,).
    """

    centre: Floats
    moment: Floats
    spread: Floats
    radius: Floats
    area: Floats


@kernel
def dipoles(vertices: Floats, triangles: Ints, tree: AabbTree) -> Dipoles:
    """Sum up the triangles (t, 3) with corners (n, 3) [m] of each node, from the leaves to the root."""
    count = tree.triangle.shape[0]
    centre, moment = np.zeros((count, 3)), np.zeros((count, 3))
    spread = np.zeros((count, 3, 3))
    radius, area = np.zeros(count), np.zeros(count)
    for node in range(count - 1, -1, -1):
        t = tree.triangle[node]
        if t >= 0:
            a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
            ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
            moment[node, 0] = 0.5 * (uy * wz - uz * wy)
            moment[node, 1] = 0.5 * (uz * wx - ux * wz)
            moment[node, 2] = 0.5 * (ux * wy - uy * wx)
            area[node] = np.sqrt(moment[node, 0] ** 2 + moment[node, 1] ** 2 + moment[node, 2] ** 2)
            for k in range(3):
                centre[node, k] = (a[k] + b[k] + c[k]) / 3.0
        else:
            left, right = node + 1, tree.right[node]
            area[node] = area[left] + area[right]
            share = area[left] / area[node] if area[node] > 0.0 else 0.5
            for k in range(3):
                moment[node, k] = moment[left, k] + moment[right, k]
                centre[node, k] = share * centre[left, k] + (1.0 - share) * centre[right, k]
            for side in range(2):
                child = right if side == 1 else left
                for k in range(3):
                    for m in range(3):
                        apart = centre[child, k] - centre[node, k]
                        spread[node, k, m] += spread[child, k, m] + apart * moment[child, m]
        squared = 0.0
        for k in range(3):
            reach = max(tree.upper[node, k] - centre[node, k], centre[node, k] - tree.lower[node, k])
            squared += reach * reach
        radius[node] = np.sqrt(squared)
    return Dipoles(centre, moment, spread, radius, area)


def winding_numbers(points: Floats, vertices: Floats, triangles: Ints, tree: AabbTree, sums: Dipoles) -> Floats:
    """Winding number of a mesh around each of the points (k, 3) [m], right to about 0.01; shape (k,)."""
    out = np.zeros(len(points))
    _wind(points, vertices, triangles, tree, sums, np.zeros(DEPTH, dtype=np.int32), out)
    return out


@borrowing_kernel
def _wind(
    points: Floats, vertices: Floats, triangles: Ints, tree: AabbTree, sums: Dipoles, stack: Ints, out: Floats
) -> None:
    """As `winding_numbers`, written to out (k,); stack: room for the nodes that wait."""
    for i in range(points.shape[0]):
        p = points[i]
        angle = 0.0
        top = 1 if tree.triangle.shape[0] > 0 else 0
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            t = tree.triangle[node]
            if t >= 0:
                angle += _solid_angle(
                    p, vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
                )
                continue
            x, y, z = sums.centre[node, 0] - p[0], sums.centre[node, 1] - p[1], sums.centre[node, 2] - p[2]
            squared = x * x + y * y + z * z
            if squared > (_FAR * sums.radius[node]) ** 2:
                m, s = sums.moment[node], sums.spread[node]
                along = x * m[0] + y * m[1] + z * m[2]
                across = (
                    x * (s[0, 0] * x + s[0, 1] * y + s[0, 2] * z)
                    + y * (s[1, 0] * x + s[1, 1] * y + s[1, 2] * z)
                    + z * (s[2, 0] * x + s[2, 1] * y + s[2, 2] * z)
                )
                trace = s[0, 0] + s[1, 1] + s[2, 2]
                angle += (along + trace - 3.0 * across / squared) / (squared * np.sqrt(squared))
                continue
            stack[top] = tree.right[node]
            stack[top + 1] = node + 1
            top += 2
        out[i] = angle / (4.0 * np.pi)


@borrowing_kernel
def _solid_angle(p: Floats, a: Floats, b: Floats, c: Floats) -> float:
    """Signed solid angle of abc as seen from p (van Oosterom and Strackee 1983)."""
    ax, ay, az = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    bx, by, bz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    la = np.sqrt(ax * ax + ay * ay + az * az)
    lb = np.sqrt(bx * bx + by * by + bz * bz)
    lc = np.sqrt(cx * cx + cy * cy + cz * cz)
    above = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab = ax * bx + ay * by + az * bz
    bc = bx * cx + by * cy + bz * cz
    ca = cx * ax + cy * ay + cz * az
    if above == 0.0:
        return 0.0
    return float(2.0 * np.arctan2(above, la * lb * lc + ab * lc + bc * la + ca * lb))
