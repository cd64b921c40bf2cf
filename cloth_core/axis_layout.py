"""Points as rows of particles, (n, 3), and as rows of axes, (3, n or more)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel

__all__ = ["by_axis", "by_particle", "particle_rows"]

Floats = NDArray[np.float64]


@borrowing_kernel
def by_axis(rows: Floats, columns: Floats) -> None:
    """Copy (n, 3) to (3, at least n)."""
    first, second, third = columns[0], columns[1], columns[2]
    for i in range(rows.shape[0]):
        first[i] = rows[i, 0]
        second[i] = rows[i, 1]
        third[i] = rows[i, 2]


@borrowing_kernel
def by_particle(columns: Floats, rows: Floats) -> None:
    """Copy (3, at least n) to (n, 3)."""
    first, second, third = columns[0], columns[1], columns[2]
    for i in range(rows.shape[0]):
        rows[i, 0] = first[i]
        rows[i, 1] = second[i]
        rows[i, 2] = third[i]


@inlined_kernel
def particle_rows(columns: Floats, count: int) -> Floats:
    """A view, (count, 3), of the first particles of (3, at least count)."""
    return columns[:, :count].T
