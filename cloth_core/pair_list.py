"""Lists of pairs that compiled code writes and Python makes room for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import inlined_kernel

__all__ = ["PairRoom", "write_pair"]

Ints = NDArray[np.int32]

_ROOM = 16_384


@inlined_kernel
def write_pair(rows: Ints, at: int, kind: int, p: int, q: int, r: int, s: int, a: int, b: int) -> None:
    """Set one row (7,) of the list: kind, four cloth particles, two body vertices."""
    rows[at, 0] = kind
    rows[at, 1] = p
    rows[at, 2] = q
    rows[at, 3] = r
    rows[at, 4] = s
    rows[at, 5] = a
    rows[at, 6] = b


class PairRoom:
    """Room for rows that a kernel finds, which writes them as long as there is room for so many more.

    Args:
        at_once: how many it may find before it asks.
        columns: numbers in each.

    Attributes:
        pairs: the room, (any, columns); count: how many have been found, (1,).
    """

    def __init__(self, at_once: int, columns: int = 2) -> None:
        self._at_once = at_once
        self.pairs = np.empty((_ROOM, columns), dtype=np.int32)
        self.count = np.zeros(1, dtype=np.int32)

    def make_room(self) -> None:
        """More, if there is not enough for so many."""
        needed = self.count[0] + self._at_once
        if needed > len(self.pairs):
            longer = np.empty((max(2 * len(self.pairs), needed), self.pairs.shape[1]), dtype=np.int32)
            longer[: self.count[0]] = self.found
            self.pairs = longer

    @property
    def found(self) -> Ints:
        """Those that there are, (count, columns)."""
        return self.pairs[: self.count[0]]
