"""Boxes of the sides and triangles of a mesh, enlarged by how far their corners may move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import inlined_kernel, kernel

__all__ = ["ROW", "edge_boxes", "in_box", "overlap", "put_edge_box", "put_triangle_box", "triangle_boxes"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# A row of boxes: lower corner, upper corner, margin; 64 bytes, as a line of the cache has.
ROW = 8


@kernel
def edge_boxes(x: Floats, edges: Ints, margin: Floats) -> Floats:
    """Boxes of edges (e, 2) between points x (n, 3), enlarged by the larger margin (n,) of their ends [m], (e, 8)."""
    boxes = np.empty((edges.shape[0], ROW))
    for e in range(edges.shape[0]):
        put_edge_box(boxes, e, x, edges, max(margin[edges[e, 0]], margin[edges[e, 1]]))
    return boxes


@kernel
def triangle_boxes(x: Floats, triangles: Ints, margin: Floats) -> Floats:
    """Boxes of triangles (t, 3) between points x (n, 3), enlarged by the largest margin (n,) of each, (t, 8)."""
    boxes = np.empty((triangles.shape[0], ROW))
    for t in range(triangles.shape[0]):
        more = max(margin[triangles[t, 0]], max(margin[triangles[t, 1]], margin[triangles[t, 2]]))
        put_triangle_box(boxes, t, x, triangles, more)
    return boxes


@inlined_kernel
def put_edge_box(boxes: Floats, e: int, x: Floats, edges: Ints, more: float) -> None:
    """Write the box of one of the edges, enlarged by `more` [m]."""
    p, q = edges[e, 0], edges[e, 1]
    for axis in range(3):
        boxes[e, axis] = min(x[p, axis], x[q, axis]) - more
        boxes[e, 3 + axis] = max(x[p, axis], x[q, axis]) + more
    boxes[e, 6] = more


@inlined_kernel
def put_triangle_box(boxes: Floats, t: int, x: Floats, triangles: Ints, more: float) -> None:
    """Write the box of one of the triangles, enlarged by `more` [m]."""
    p, q, r = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    for axis in range(3):
        boxes[t, axis] = min(x[p, axis], min(x[q, axis], x[r, axis])) - more
        boxes[t, 3 + axis] = max(x[p, axis], max(x[q, axis], x[r, axis])) + more
    boxes[t, 6] = more


@inlined_kernel
def overlap(one: Floats, i: int, other: Floats, j: int) -> bool:
    """Whether box i of one table and box j of the other have a point in common; in one go, without a branch."""
    return bool(
        (one[i, 0] <= other[j, 3])
        & (other[j, 0] <= one[i, 3])
        & (one[i, 1] <= other[j, 4])
        & (other[j, 1] <= one[i, 4])
        & (one[i, 2] <= other[j, 5])
        & (other[j, 2] <= one[i, 5])
    )


@inlined_kernel
def in_box(x: Floats, i: int, margin: float, boxes: Floats, j: int) -> bool:
    """Whether point i of x (n, 3) is in box j, or not farther from it than margin [m] along any axis."""
    return bool(
        (x[i, 0] + margin >= boxes[j, 0])
        & (x[i, 0] - margin <= boxes[j, 3])
        & (x[i, 1] + margin >= boxes[j, 1])
        & (x[i, 1] - margin <= boxes[j, 4])
        & (x[i, 2] + margin >= boxes[j, 2])
        & (x[i, 2] - margin <= boxes[j, 5])
    )
