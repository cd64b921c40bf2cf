"""The part of a body's AABB tree that cloth can reach; triangles elsewhere are not in it.

For a branch of the body's tree that lies out of reach stands one leaf without a triangle, whose box is empty. All else
is as it was, so that a search finds the same pairs in the same order as in the whole tree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree
from cloth_core.kernel import kernel

__all__ = ["ReachableTree"]

Floats = NDArray[np.float64]

# The tree is cut to what lies this close to the cloth [m], and anew when the cloth has left that region, or needs so
# much less of it on any side.
_ROOM = 0.1
_TOO_MUCH = 3.0 * _ROOM


class ReachableTree:
    """Cuts a body's tree to where the cloth is, as rarely as that will do.

    Attributes:
        tree: what was searched last; None before.
    """

    def __init__(self) -> None:
        self.tree: AabbTree | None = None
        self._whole: AabbTree | None = None
        self._lower, self._upper = np.zeros(3), np.zeros(3)

    def of(self, whole: AabbTree, lower: Floats, upper: Floats) -> AabbTree:
        """A tree with all triangles of `whole` whose boxes meet that between the corners lower and upper (3,) [m].

        One that comes for the first time is not cut: that of a body on its way comes only once.
        """
        if self.tree is None or self._whole is not whole:
            self.tree = self._whole = whole
        elif self.tree is whole or not self._fits(lower, upper):
            self._lower, self._upper = lower - _ROOM, upper + _ROOM
            self.tree = _cut(whole, self._lower, self._upper)
        return self.tree

    def _fits(self, lower: Floats, upper: Floats) -> bool:
        room = (*(lower - self._lower).tolist(), *(self._upper - upper).tolist())
        return bool(min(room) >= 0.0 and max(room) <= _TOO_MUCH)


@kernel
def _cut(tree: AabbTree, lower: Floats, upper: Floats) -> AabbTree:
    """The branches of a tree that meet the box between lower and upper (3,) [m]."""
    nodes = tree.triangle.shape[0]
    kept = AabbTree(
        np.full((nodes, 3), np.inf),
        np.full((nodes, 3), -np.inf),
        np.zeros(nodes, np.int32),
        np.full(nodes, -1, np.int32),
    )
    # Nodes that wait, each with the node whose right child it is, -1 if it is a left one.
    waiting = [(0, -1)]
    count = 0
    while nodes > 0 and len(waiting) > 0:
        node, parent = waiting.pop()
        new = count
        count += 1
        if parent >= 0:
            kept.right[parent] = new
        apart = False
        for k in range(3):
            apart = apart or tree.lower[node, k] > upper[k] or lower[k] > tree.upper[node, k]
        if apart:
            continue
        kept.lower[new], kept.upper[new] = tree.lower[node], tree.upper[node]
        kept.triangle[new] = tree.triangle[node]
        if tree.triangle[node] < 0:
            waiting.append((tree.right[node], new))
            waiting.append((node + 1, -1))
    return AabbTree(
        kept.lower[:count].copy(), kept.upper[:count].copy(), kept.right[:count].copy(), kept.triangle[:count].copy()
    )
