"""Lists of pairs that grow inside compiled code: kind, three cloth particles, two body vertices; and their distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel

__all__ = ["doubled", "with_room", "write_pair"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@kernel
def write_pair(rows: Ints, at: int, kind: int, p: int, q: int, r: int, a: int, b: int) -> None:
    """Set one row (6,) of the list."""
    rows[at, 0] = kind
    rows[at, 1] = p
    rows[at, 2] = q
    rows[at, 3] = r
    rows[at, 4] = a
    rows[at, 5] = b


@kernel
def with_room(rows: Ints, distance: Floats, count: int) -> tuple[Ints, Floats]:
    """Rows and distances with place for one more entry than count."""
    if count < rows.shape[0]:
        return rows, distance
    longer = np.empty(2 * count)
    for i in range(count):
        longer[i] = distance[i]
    return doubled(rows), longer


@kernel
def doubled(rows: Ints) -> Ints:
    """Rows with twice the room."""
    longer = np.empty((2 * rows.shape[0], rows.shape[1]), dtype=np.int32)
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            longer[i, k] = rows[i, k]
    return longer
