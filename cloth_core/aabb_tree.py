"""Axis-aligned bounding box trees of triangle meshes (step 6 of the paper).

A tree over t triangles is an array of 2 t - 1 nodes in depth-first order: the left child of node i is i + 1, the right
one `right[i]`; a leaf holds one triangle. The body's tree is built once; the garment's is built once and *refitted*
(same nodes, new boxes) whenever the cloth has moved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel, zero

__all__ = ["DEPTH", "AabbTree", "boxes_overlap", "build_tree", "next_leaf", "overlapping_pairs", "refit_tree"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class AabbTree(NamedTuple):
    """Nodes in depth-first order.

    Attributes:
        lower, upper: corners of the boxes [m], shape (2 t - 1, 3).
        right: index of the right child, shape (2 t - 1,); 0 for a leaf.
        triangle: the leaf's triangle, -1 for an inner node, shape (2 t - 1,).
    """

    lower: Floats
    upper: Floats
    right: Ints
    triangle: Ints


def build_tree(vertices: Floats, triangles: Ints) -> AabbTree:
    """Build a balanced tree: every node is split at the median of its longest side.

    Args:
        vertices: positions [m], shape (n, 3).
        triangles: corner indices, shape (t, 3), t may be 0.
    """
    centres = vertices[triangles].mean(axis=1) if len(triangles) else np.zeros((0, 3))
    right, leaf = _split(np.ascontiguousarray(centres))
    tree = AabbTree(np.zeros((len(leaf), 3)), np.zeros((len(leaf), 3)), right, leaf)
    refit_tree(tree, np.ascontiguousarray(vertices), triangles, 0.0)
    return tree


@borrowing_kernel
def _select(order: Ints, key: Floats, first: int, last: int, middle: int) -> None:
    """Partially sort order[first:last] by (key, index) so that position `middle` holds what sorting would put there."""
    low, high = first, last - 1
    while low < high:
        pivot = order[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while key[order[i]] < key[pivot] or (key[order[i]] == key[pivot] and order[i] < pivot):
                i += 1
            while key[order[j]] > key[pivot] or (key[order[j]] == key[pivot] and order[j] > pivot):
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@kernel
def _split(centres: Floats) -> tuple[Ints, Ints]:
    count = centres.shape[0]
    nodes = max(2 * count - 1, 0)
    right = np.zeros(nodes, dtype=np.int32)
    leaf = np.full(nodes, -1, dtype=np.int32)
    order = np.arange(count).astype(np.int32)
    keys = np.ascontiguousarray(centres.T)
    stack = [(0, 0, count)]
    while count > 0 and len(stack) > 0:
        node, first, last = stack.pop()
        if last - first == 1:
            leaf[node] = order[first]
            continue
        longest, axis = -1.0, 0
        for k in range(3):
            low, high = np.inf, -np.inf
            for i in range(first, last):
                low = min(low, keys[k, order[i]])
                high = max(high, keys[k, order[i]])
            if high - low > longest:
                longest, axis = high - low, k
        middle = (first + last) // 2
        _select(order, keys[axis], first, last, middle)
        right[node] = node + 2 * (middle - first)
        stack.append((right[node], middle, last))
        stack.append((node + 1, first, middle))
    return right, leaf


def refit_tree(tree: AabbTree, vertices: Floats, triangles: Ints, margin: float | Floats) -> None:
    """Recompute all boxes, enlarged on every side.

    Args:
        tree: changed in place.
        vertices: positions [m], shape (n, 3).
        triangles: corner indices, shape (t, 3).
        margin: how far a box reaches beyond its corners [m], for all of them or for each vertex, shape (n,).
    """
    _refit(tree, vertices, triangles, np.array(np.broadcast_to(margin, len(vertices)), dtype=np.float64))


@borrowing_kernel
def _refit(tree: AabbTree, vertices: Floats, triangles: Ints, margin: Floats) -> None:
    for node in range(tree.triangle.shape[0] - 1, -1, -1):
        t = tree.triangle[node]
        for k in range(3):
            if t >= 0:
                low, high = np.inf, -np.inf
                for corner in range(3):
                    i = triangles[t, corner]
                    low = min(low, vertices[i, k] - margin[i])
                    high = max(high, vertices[i, k] + margin[i])
                tree.lower[node, k] = low
                tree.upper[node, k] = high
            else:
                left, right = node + 1, tree.right[node]
                tree.lower[node, k] = min(tree.lower[left, k], tree.lower[right, k])
                tree.upper[node, k] = max(tree.upper[left, k], tree.upper[right, k])


@inlined_kernel
def boxes_overlap(one: AabbTree, i: int, other: AabbTree, j: int) -> bool:
    """Whether box i of one tree and box j of the other have a point in common; in one go, without a branch."""
    return bool(
        (one.lower[i, 0] <= other.upper[j, 0])
        & (other.lower[j, 0] <= one.upper[i, 0])
        & (one.lower[i, 1] <= other.upper[j, 1])
        & (other.lower[j, 1] <= one.upper[i, 1])
        & (one.lower[i, 2] <= other.upper[j, 2])
        & (other.lower[j, 2] <= one.upper[i, 2])
    )


# Room for the nodes that wait in a descent: trees are balanced, 22 levels hold two million triangles, and a level adds
# one entry.
DEPTH = 128


@inlined_kernel
def next_leaf(tree: AabbTree, low: Floats, high: Floats, waiting: Ints, count: int) -> tuple[int, int]:
    """Descend to the next triangle whose box overlaps that of low, high (3,), -1 if there is none.

    The nodes that wait are waiting[:count], with room for DEPTH; a descent begins with the root, 0, alone. Returns also
    how many wait then.
    """
    found = -1
    while found < 0 and count > 0:
        count -= 1
        node = waiting[count]
        apart = False
        for k in range(3):
            apart = apart or tree.lower[node, k] > high[k] or low[k] > tree.upper[node, k]
        if apart:
            continue
        found = tree.triangle[node]
        if found < 0:
            waiting[count] = tree.right[node]
            waiting[count + 1] = node + 1
            count += 2
    return found, count


def overlapping_pairs(body: AabbTree, cloth: AabbTree, pairs: Ints, most: int = 2**62) -> int:
    """Double traversal: all (cloth triangle, body triangle) whose boxes overlap, in a fixed order.

    The body's root is held against the cloth's tree; a branch ends where boxes are disjoint; at a cloth leaf the body's
    tree is descended. At most len(pairs) are written to pairs (p, 2); the number found is returned. The search ends at
    more than `most`.
    """
    if len(body.triangle) == 0 or len(cloth.triangle) == 0:
        return 0
    return int(_overlapping_pairs(body, cloth, np.zeros((2 * DEPTH, 2), dtype=np.int32), pairs, most))


@borrowing_kernel
def _overlapping_pairs(body: AabbTree, cloth: AabbTree, stack: Ints, pairs: Ints, most: int) -> int:
    """As `overlapping_pairs`, of trees that have leaves; stack: room for the pairs of nodes that wait."""
    found = zero()
    top = 1
    while top > 0 and found <= most:
        top -= 1
        c, b = stack[top, 0], stack[top, 1]
        if not boxes_overlap(cloth, c, body, b):
            continue
        cloth_leaf, body_leaf = cloth.triangle[c] >= 0, body.triangle[b] >= 0
        if cloth_leaf and body_leaf:
            if found < pairs.shape[0]:
                pairs[found, 0] = cloth.triangle[c]
                pairs[found, 1] = body.triangle[b]
            found += 1
            continue
        descend_cloth = body_leaf
        if not cloth_leaf and not body_leaf:  # the larger box first: fewer pairs than one tree down to its leaves
            cloth_size = 0.0
            body_size = 0.0
            for k in range(3):
                cloth_size = max(cloth_size, cloth.upper[c, k] - cloth.lower[c, k])
                body_size = max(body_size, body.upper[b, k] - body.lower[b, k])
            descend_cloth = cloth_size >= body_size
        if descend_cloth:
            stack[top, 0], stack[top, 1] = cloth.right[c], b
            stack[top + 1, 0], stack[top + 1, 1] = c + 1, b
        else:
            stack[top, 0], stack[top, 1] = c, body.right[b]
            stack[top + 1, 0], stack[top + 1, 1] = c, b + 1
        top += 2
    return found
