"""Equal rows of a table of three columns: vertices at one place, triangles with the same corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel

__all__ = ["first_of_equal"]

Ints = NDArray[np.int32]


@kernel
def first_of_equal(rows: NDArray[np.uint64]) -> Ints:
    """For each row of (n, 3) the first row that is equal to it, shape (n,): by a hash table with open addressing."""
    count = rows.shape[0]
    size = 4
    while size < 2 * count:
        size *= 2
    mask = np.uint64(size - 1)
    table = np.full(size, -1, dtype=np.int32)
    first = np.empty(count, dtype=np.int32)
    for i in range(count):
        key = np.uint64(1469598103934665603)
        for k in range(3):
            key = (key ^ rows[i, k]) * np.uint64(11400714819323198485)
            key ^= key >> np.uint64(29)
        slot = key & mask
        while True:
            other = table[slot]
            if other < 0:
                table[slot] = i
                first[i] = i
                break
            if rows[i, 0] == rows[other, 0] and rows[i, 1] == rows[other, 1] and rows[i, 2] == rows[other, 2]:
                first[i] = other
                break
            slot = (slot + np.uint64(1)) & mask
    return first
