"""Exact counting: which sides of one mesh cross which triangles of another or of the same.

When a side crosses a triangle, decided by exact signs (`orientation`):

- its ends lie strictly on different sides of the triangle's plane, and it passes through the triangle, the triangle's
  own sides and corners included: what goes through a seam between two triangles must not slip through unseen;
- or one of its ends lies exactly in the triangle, and another side of the mesh that starts there leads to the other
  side of the plane: the surface passes through at a corner.

What only touches does not cross: a tip that reaches the plane, a side in the plane, triangles that lie on each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import DEPTH, AabbTree, build_tree, next_leaf
from cloth_core.flat_separation import certainly_apart
from cloth_core.kernel import borrowing_kernel
from cloth_core.mesh_topology import unique_edges
from cloth_core.orientation import exact_orientation, orientation, quick_orientation
from cloth_core.pair_list import PairRoom

__all__ = [
    "crossed_triangles",
    "crossing_edges",
    "crossing_pairs",
    "segment_crosses",
    "self_crossing_edges",
    "self_crossing_pairs",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


def crossing_edges(
    vertices: Floats, triangles: Ints, other_vertices: Floats, other_triangles: Ints, tree: AabbTree | None = None
) -> Ints:
    """Sides of a mesh that cross at least one triangle of another mesh, as vertex pairs (k, 2).

    Args:
        vertices, triangles: the mesh whose sides are tested, (n, 3) [m] and (m, 3).
        other_vertices, other_triangles: the mesh that is crossed.
        tree: of the other mesh, if there is one already.
    """
    edges, pairs = crossing_pairs(vertices, triangles, other_vertices, other_triangles, tree)
    return np.asarray(edges[np.unique(pairs[:, 0])])


def crossing_pairs(
    vertices: Floats, triangles: Ints, other_vertices: Floats, other_triangles: Ints, tree: AabbTree | None = None
) -> tuple[Ints, Ints]:
    """All sides (e, 2), and pairs (k, 2): index of a side, index of a triangle of the other mesh that it crosses."""
    edges, _ = unique_edges(triangles)
    tree = build_tree(other_vertices, other_triangles) if tree is None else tree
    nobody = np.zeros(0, dtype=np.int32)
    return edges, _pairs(vertices, edges, other_vertices, other_triangles, tree, nobody)


def self_crossing_edges(vertices: Floats, triangles: Ints, identity: Ints | None = None) -> Ints:
    """Sides of a mesh that cross a triangle of the same mesh with which they share no corner, shape (k, 2).

    Args:
        vertices, triangles: (n, 3) [m] and (m, 3).
        identity: equal numbers are one corner, (n,), as when points are to be sewn together; each vertex is its own if
            none is given.
    """
    edges, pairs = self_crossing_pairs(vertices, triangles, identity)
    return np.asarray(edges[np.unique(pairs[:, 0])])


def self_crossing_pairs(vertices: Floats, triangles: Ints, identity: Ints | None = None) -> tuple[Ints, Ints]:
    """All sides (e, 2) of a mesh, and pairs (k, 2): index of a side, index of a triangle that it crosses; see above."""
    edges, _ = unique_edges(triangles)
    number = np.arange(len(vertices)) if identity is None else np.asarray(identity)
    tree = build_tree(vertices, triangles)
    return edges, _pairs(vertices, edges, vertices, triangles, tree, number.astype(np.int32))


def crossed_triangles(vertices: Floats, triangles: Ints, identity: Ints | None = None) -> NDArray[np.bool_]:
    """Which triangles of a mesh are crossed by a side of it with which they share no corner, shape (m,)."""
    crossed = np.zeros(len(triangles), dtype=bool)
    crossed[self_crossing_pairs(vertices, triangles, identity)[1][:, 1]] = True
    return crossed


def _pairs(x: Floats, edges: Ints, other_x: Floats, other_triangles: Ints, tree: AabbTree, number: Ints) -> Ints:
    x, other_x = np.ascontiguousarray(x), np.ascontiguousarray(other_x)
    crossed_room, touched_room = PairRoom(len(other_triangles)), PairRoom(len(other_triangles), columns=4)
    waiting, box = np.zeros(DEPTH, dtype=np.int32), np.zeros((2, 3))
    done = 0
    while len(tree.triangle) > 0 and done < len(edges):
        crossed_room.make_room()
        touched_room.make_room()
        done = _edges_through(
            x, edges, other_x, other_triangles, tree, number, waiting, box, done, crossed_room.pairs,
            crossed_room.count, touched_room.pairs, touched_room.count,
        )  # fmt: skip
    crossed, touched = crossed_room.found, touched_room.found
    if len(touched):
        # Of the sides that end in a triangle those cross that have a partner on the other side of it.
        end = edges[touched[:, 0], touched[:, 2]].astype(np.int64)
        place = end * max(len(other_triangles), 1) + touched[:, 1]
        _, group = np.unique(place, return_inverse=True)
        up = np.bincount(group.ravel(), weights=touched[:, 3] > 0) > 0
        down = np.bincount(group.ravel(), weights=touched[:, 3] < 0) > 0
        crossed = np.concatenate([crossed, touched[(up & down)[group.ravel()], :2]])
    return np.unique(crossed, axis=0) if len(crossed) else crossed


@borrowing_kernel
def _edges_through(
    x: Floats,
    edges: Ints,
    vertices: Floats,
    triangles: Ints,
    tree: AabbTree,
    number: Ints,
    waiting: Ints,
    box: Floats,
    first: int,
    crossed: Ints,
    crossed_found: Ints,
    touched: Ints,
    touched_found: Ints,
) -> int:
    """Pairs (side, triangle) that cross, (k, 2), and rows (side, triangle, which end, sign of the other end) of sides
    that end in a triangle, (j, 4). With a number for each vertex, what shares a corner is left out.

    They are added to crossed and touched, where the numbers of those found, (1,) each, count them. Begins with side
    `first`; waiting (DEPTH,) and box (2, 3) are scratch.

    Returns:
        the side that is next, if there is no room for one that crosses all triangles.
    """
    low, high = box[0], box[1]
    same_mesh = number.shape[0] > 0
    crossed_count, touched_count = crossed_found[0], touched_found[0]
    next_side: int = edges.shape[0]
    for e in range(first, edges.shape[0]):
        room = min(crossed.shape[0] - crossed_count, touched.shape[0] - touched_count)
        if room < triangles.shape[0]:
            next_side = e
            break
        i, j = edges[e, 0], edges[e, 1]
        p, q = x[i], x[j]
        for k in range(3):
            low[k], high[k] = min(p[k], q[k]), max(p[k], q[k])
        waiting[0] = 0
        t, count = next_leaf(tree, low, high, waiting, 1)
        while t >= 0:
            here = t
            t, count = next_leaf(tree, low, high, waiting, count)
            a, b, c = triangles[here, 0], triangles[here, 1], triangles[here, 2]
            if same_mesh:
                shared = False
                for corner in (number[a], number[b], number[c]):
                    shared = shared or corner == number[i] or corner == number[j]
                if shared:
                    continue
            va, vb, vc = vertices[a], vertices[b], vertices[c]
            above = quick_orientation(va, vb, vc, p)
            below = quick_orientation(va, vb, vc, q)
            if above * below > 0:
                continue
            # All of a flat panel lies in one plane: exact signs are worked out only of what may meet in it.
            if above * below == 0 and certainly_apart(p, q, va, vb, vc):
                continue
            if above == 0:
                above = exact_orientation(va, vb, vc, p)
            if below == 0:
                below = exact_orientation(va, vb, vc, q)
            if above == below or not _line_meets(p, q, va, vb, vc):
                continue
            if above != 0 and below != 0:
                crossed[crossed_count, 0] = e
                crossed[crossed_count, 1] = here
                crossed_count += 1
            else:
                touched[touched_count, 0] = e
                touched[touched_count, 1] = here
                touched[touched_count, 2] = 0 if above == 0 else 1
                touched[touched_count, 3] = above + below
                touched_count += 1
    crossed_found[0], touched_found[0] = crossed_count, touched_count
    return next_side


@borrowing_kernel
def segment_crosses(p: Floats, q: Floats, a: Floats, b: Floats, c: Floats) -> bool:
    """Whether p and q lie strictly on different sides of abc and pq passes through it, sides and corners included."""
    if orientation(a, b, c, p) * orientation(a, b, c, q) >= 0:
        return False
    return _line_meets(p, q, a, b, c)


@borrowing_kernel
def _line_meets(p: Floats, q: Floats, a: Floats, b: Floats, c: Floats) -> bool:
    """Whether the line pq, which does not lie in the plane of abc, meets abc, sides and corners included."""
    u, v, w = orientation(p, q, a, b), orientation(p, q, b, c), orientation(p, q, c, a)
    return (u >= 0 and v >= 0 and w >= 0) or (u <= 0 and v <= 0 and w <= 0)
