"""How many straight lines between points of a garment pass through the body, with a limit to the work.

A search for a better start asks this for hundreds of places. Only how many lines are blocked matters, not by what: the
first triangle that a line passes through is enough, and so is the number beyond which a place is no better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import DEPTH, AabbTree, next_leaf
from cloth_core.body import Body
from cloth_core.garment import Seam
from cloth_core.intersections import segment_crosses
from cloth_core.kernel import borrowing_kernel

__all__ = ["BlockedLines", "seam_lines"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Lines of each seam that are looked at.
_LINES = 24


class BlockedLines:
    """Counts lines that pass through a body.

    Args:
        body: what they pass through.
        most_tests: exact tests of a line with a triangle that may be made in all; they are what takes time.
    """

    def __init__(self, body: Body, most_tests: int = 2**62) -> None:
        self._body = body
        self._left = most_tests

    @property
    def spent(self) -> bool:
        """Whether no more tests may be made; every line counts as blocked then."""
        return self._left <= 0

    def count(self, x: Floats, lines: Ints, enough: int | None = None) -> int:
        """How many lines between points x (n, 3) [m], pairs (k, 2), pass through the body; at most `enough`."""
        body, most = self._body, len(lines) if enough is None else min(enough, len(lines))
        blocked, tests = _blocked(
            np.ascontiguousarray(x), lines, body.vertices, body.triangles, body.tree, np.zeros(DEPTH, dtype=np.int32),
            np.zeros((2, 3)), most, self._left,
        )  # fmt: skip
        self._left -= tests
        return int(blocked)


def seam_lines(seams: list[Seam]) -> Ints:
    """Some lines between points that are to be sewn together, evenly along each seam, as pairs of particles (k, 2)."""
    rows = [np.zeros((0, 2), dtype=np.int32)]
    for seam in seams:
        which = np.unique(np.linspace(0, len(seam.first) - 1, _LINES).round().astype(int))
        rows.append(np.stack([seam.first[which], seam.second[which]], axis=1))
    lines = np.unique(np.sort(np.concatenate(rows), axis=1), axis=0)
    return np.asarray(lines[lines[:, 0] != lines[:, 1]], dtype=np.int32)


@borrowing_kernel
def _blocked(
    x: Floats,
    lines: Ints,
    vertices: Floats,
    triangles: Ints,
    tree: AabbTree,
    waiting: Ints,
    box: Floats,
    most: int,
    tests_left: int,
) -> tuple[int, int]:
    """Lines that cross a triangle, `most` if there are more or tests run out, and the tests that were made.

    waiting (DEPTH,) and box (2, 3) are scratch.
    """
    blocked, tests = 0, 0
    low, high = box[0], box[1]
    if tree.triangle.shape[0] == 0:
        return 0, 0
    for line in range(lines.shape[0]):
        if blocked >= most:
            break
        p, q = x[lines[line, 0]], x[lines[line, 1]]
        for k in range(3):
            low[k], high[k] = min(p[k], q[k]), max(p[k], q[k])
        waiting[0] = 0
        t, count = next_leaf(tree, low, high, waiting, 1)
        while t >= 0:
            if tests == tests_left:
                return most, tests
            tests += 1
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if segment_crosses(p, q, vertices[a], vertices[b], vertices[c]):
                blocked += 1
                break
            t, count = next_leaf(tree, low, high, waiting, count)
    return blocked, tests
