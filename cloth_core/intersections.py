"""Exact counting: which sides of one mesh cross which triangles of another, and how deep points lie inside a body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree
from cloth_core.kernel import kernel
from cloth_core.mesh_topology import unique_edges

__all__ = ["crossed_triangles", "crossing_edges", "segment_crosses", "self_crossing_edges"]

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
    edges, _ = unique_edges(triangles)
    tree = build_tree(other_vertices, other_triangles) if tree is None else tree
    hit = _edges_through(vertices, edges, other_vertices, other_triangles, tree, np.zeros(0, dtype=np.int32))
    return edges[hit]


def self_crossing_edges(vertices: Floats, triangles: Ints, identity: Ints | None = None) -> Ints:
    """Sides of a mesh that cross a triangle of the same mesh with which they share no corner, shape (k, 2).

    Args:
        vertices, triangles: (n, 3) [m] and (m, 3).
        identity: equal numbers are one corner, (n,); each vertex is its own if none is given.
    """
    edges, _ = unique_edges(triangles)
    identity = np.arange(len(vertices), dtype=np.int32) if identity is None else identity
    hit = _edges_through(vertices, edges, vertices, triangles, build_tree(vertices, triangles), identity)
    return edges[hit]


def crossed_triangles(vertices: Floats, triangles: Ints, identity: Ints) -> NDArray[np.bool_]:
    """Which triangles of a mesh are crossed by a side of it with which they share no corner, shape (m,)."""
    crossing = self_crossing_edges(vertices, triangles, identity)
    return _crossed(vertices, crossing, triangles, identity)


@kernel
def _crossed(x: Floats, edges: Ints, triangles: Ints, identity: Ints) -> NDArray[np.bool_]:
    crossed = np.zeros(triangles.shape[0], dtype=np.bool_)
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            li, lj, la, lb, lc = identity[i], identity[j], identity[a], identity[b], identity[c]
            if li == la or li == lb or li == lc or lj == la or lj == lb or lj == lc:
                continue
            if not crossed[t] and segment_crosses(x[i], x[j], x[a], x[b], x[c]):
                crossed[t] = True
    return crossed


@kernel
def _edges_through(
    x: Floats, edges: Ints, vertices: Floats, triangles: Ints, tree: AabbTree, identity: Ints
) -> NDArray[np.bool_]:
    hit = np.zeros(edges.shape[0], dtype=np.bool_)
    stack = np.zeros(128, dtype=np.int32)
    low, high = np.zeros(3), np.zeros(3)
    for e in range(edges.shape[0]):
        if tree.triangle.shape[0] == 0:
            break
        p, q = x[edges[e, 0]], x[edges[e, 1]]
        for k in range(3):
            low[k], high[k] = min(p[k], q[k]), max(p[k], q[k])
        top = 1
        stack[0] = 0
        while top > 0 and not hit[e]:
            top -= 1
            node = stack[top]
            apart = False
            for k in range(3):
                apart = apart or tree.lower[node, k] > high[k] or low[k] > tree.upper[node, k]
            if apart:
                continue
            t = tree.triangle[node]
            if t < 0:
                stack[top] = tree.right[node]
                stack[top + 1] = node + 1
                top += 2
                continue
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if identity.shape[0] > 0:
                i, j = identity[edges[e, 0]], identity[edges[e, 1]]
                la, lb, lc = identity[a], identity[b], identity[c]
                if i == la or i == lb or i == lc or j == la or j == lb or j == lc:
                    continue
            hit[e] = segment_crosses(p, q, vertices[a], vertices[b], vertices[c])
    return hit


@kernel
def segment_crosses(p: Floats, q: Floats, a: Floats, b: Floats, c: Floats) -> bool:
    """Whether pq passes through abc from one side to the other, by the signs of five tetrahedra's volumes."""
    above, below = _volume(a, b, c, p), _volume(a, b, c, q)
    if (above > 0.0) == (below > 0.0) or above == 0.0 or below == 0.0:
        return False
    u, v, w = _volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)
    # Through a side that two triangles share counts as well: otherwise both would leave it to the other.
    return bool((u >= 0.0 and v >= 0.0 and w >= 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0))


@kernel
def _volume(a: Floats, b: Floats, c: Floats, d: Floats) -> float:
    """Six times the signed volume of the tetrahedron abcd [m^3]."""
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return float(dx * (by * cz - bz * cy) + dy * (bz * cx - bx * cz) + dz * (bx * cy - by * cx))
