"""Lists of pairs that grow inside compiled code: kind, four cloth particles, two body vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import inlined_kernel, kernel

__all__ = ["doubled", "write_pair"]

Ints = NDArray[np.int32]


@inlined_kernel
def write_pair(rows: Ints, at: int, kind: int, p: int, q: int, r: int, s: int, a: int, b: int) -> None:
    """Set one row (7,) of the list."""
    rows[at, 0] = kind
    rows[at, 1] = p
    rows[at, 2] = q
    rows[at, 3] = r
    rows[at, 4] = s
    rows[at, 5] = a
    rows[at, 6] = b


@kernel
def doubled(rows: Ints) -> Ints:
    """Rows with twice the room."""
    longer = np.empty((2 * rows.shape[0], rows.shape[1]), dtype=np.int32)
    longer[: rows.shape[0]] = rows
    return longer
