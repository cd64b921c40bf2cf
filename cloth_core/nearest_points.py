"""Distance of points to a surface: the nearest triangle by its AABB tree, exact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree
from cloth_core.closest_points import point_triangle
from cloth_core.kernel import kernel

__all__ = ["surface_distances"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@kernel
def surface_distances(points: Floats, vertices: Floats, triangles: Ints, tree: AabbTree) -> Floats:
    """Distance [m] of each point (k, 3) to the nearest triangle; vertices (n, 3), triangles (m, 3) with their tree."""
    out = np.empty(points.shape[0])
    stack = np.zeros(128, dtype=np.int32)
    for i in range(points.shape[0]):
        p = points[i]
        best = np.inf
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            if _squared_box_distance(tree, node, p) >= best:
                continue
            t = tree.triangle[node]
            if t >= 0:
                squared, _, _, _ = point_triangle(
                    p, vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
                )
                best = min(best, squared)
                continue
            # The nearer child is looked at first: it soon rules out most of the other one.
            near, far = node + 1, tree.right[node]
            if _squared_box_distance(tree, far, p) < _squared_box_distance(tree, near, p):
                near, far = far, near
            stack[top] = far
            stack[top + 1] = near
            top += 2
        out[i] = np.sqrt(best)
    return out


@kernel
def _squared_box_distance(tree: AabbTree, node: int, p: Floats) -> float:
    squared = 0.0
    for k in range(3):
        gap = max(tree.lower[node, k] - p[k], max(0.0, p[k] - tree.upper[node, k]))
        squared += gap * gap
    return squared
