"""Distance of points to a triangle mesh: branch and bound in its AABB tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import DEPTH, AabbTree
from cloth_core.closest_points import point_triangle
from cloth_core.kernel import borrowing_kernel

__all__ = ["distances_to_mesh"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@borrowing_kernel
def _box_distance(tree: AabbTree, node: int, p: Floats) -> float:
    squared = 0.0
    for k in range(3):
        gap = max(tree.lower[node, k] - p[k], max(0.0, p[k] - tree.upper[node, k]))
        squared += gap * gap
    return squared


def distances_to_mesh(points: Floats, vertices: Floats, triangles: Ints, tree: AabbTree) -> Floats:
    """Distance of each point (k, 3) to the nearest triangle [m], shape (k,)."""
    out = np.empty(len(points))
    _measure(points, vertices, triangles, tree, np.zeros(DEPTH, dtype=np.int32), out)
    return out


@borrowing_kernel
def _measure(points: Floats, vertices: Floats, triangles: Ints, tree: AabbTree, stack: Ints, out: Floats) -> None:
    """As `distances_to_mesh`, written to out (k,); stack: room for the nodes that wait."""
    for i in range(points.shape[0]):
        p = points[i]
        best = np.inf
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            if _box_distance(tree, node, p) >= best:
                continue
            t = tree.triangle[node]
            if t >= 0:
                a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
                best = min(best, point_triangle(p, a, b, c)[0])
                continue
            # The nearer child is looked at first: it soon rules out most of the other one.
            left, right = node + 1, tree.right[node]
            if _box_distance(tree, left, p) < _box_distance(tree, right, p):
                left, right = right, left
            stack[top] = left
            stack[top + 1] = right
            top += 2
        out[i] = np.sqrt(best)
