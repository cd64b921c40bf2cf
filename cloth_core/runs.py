"""Runs: elements of the grid that lie side by side, so that the processor can work on several of them at once.

Inside a panel the particles of a row of the lattice are numbered one after the other. The springs from each particle
of a row to its right neighbour, say, are then pairs (i, i + 1), (i + 1, i + 2), ... of one stiffness and one rest
length: a *run*, described by its first element and its length, whose positions lie in memory one after the other. What
is left over, mostly at outlines and seams, stays a list.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.lanes import LANES

__all__ = ["Runs", "find_runs"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Shorter runs do not fill a register; kernels rely on it.
_SHORTEST = LANES
# Values that differ by less than rounding in the rest shape's coordinates are equal.
_SAME = 1e-9


class Runs(NamedTuple):
    """Elements of k particles with some values each.

    Attributes:
        first: particles of the first element of each run, shape (r, k); those of its element number e are first + e.
        length: number of elements of each run, shape (r,).
        value: the values that all elements of a run have, shape (r, m).
        rest: particles of the elements that are in no run, shape (s, k).
        rest_value: their values, shape (s, m).
    """

    first: Ints
    length: Ints
    value: Floats
    rest: Ints
    rest_value: Floats


def find_runs(particles: Ints, values: Floats) -> Runs:
    """Sort elements into runs and the rest.

    Args:
        particles: of each element, shape (n, k).
        values: of each element, shape (n, m).
    """
    count, width = particles.shape
    if count == 0:
        none = np.zeros((0, width), dtype=np.int32)
        no_value = np.zeros((0, values.shape[1]))
        return Runs(none, np.zeros(0, dtype=np.int32), no_value, none, no_value)
    offsets = particles[:, 1:] - particles[:, :1]
    order = np.lexsort((particles[:, 0], *offsets.T[::-1]))
    index, value, offset = particles[order], values[order], offsets[order]
    goes_on = (
        (index[1:, 0] == index[:-1, 0] + 1)
        & (offset[1:] == offset[:-1]).all(axis=1)
        & (np.abs(value[1:] - value[:-1]) <= _SAME * np.abs(value[:-1])).all(axis=1)
    )
    start = np.flatnonzero(np.concatenate([[True], ~goes_on]))
    length = np.diff(np.append(start, count))
    long = length >= _SHORTEST
    in_run = np.repeat(long, length)
    return Runs(
        first=np.ascontiguousarray(index[start[long]], dtype=np.int32),
        length=length[long].astype(np.int32),
        value=np.ascontiguousarray(value[start[long]], dtype=np.float64),
        rest=np.ascontiguousarray(index[~in_run], dtype=np.int32),
        rest_value=np.ascontiguousarray(value[~in_run], dtype=np.float64),
    )
