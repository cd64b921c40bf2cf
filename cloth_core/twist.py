"""Twist: the part of true bending that the lines of a lattice do not feel.

A plate of stiffness B that bends the same way in all directions holds B / 2 (kxx^2 + kyy^2 + 2 kxy^2) per area. The
triples of particles along rows and columns have the first two; the twist of a cell, kxy = (xa - xb + xc - xd) / (w h)
with its corners a, b, c, d in turn, is the third. Without it cloth would bend along a diagonal with half of its
stiffness. The force is linear in the positions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Garment
from cloth_core.kernel import borrowing_kernel
from cloth_core.lanes import LANES, add_to, fill, last_lane, last_lanes, load, take_from, together
from cloth_core.runs import Runs

__all__ = ["TWIST_WEIGHTS", "twist_forces", "twist_stiffness"]

Floats = NDArray[np.float64]

TWIST_WEIGHTS = (1.0, -1.0, 1.0, -1.0)


def twist_stiffness(garment: Garment, bending: float) -> Floats:
    """k = 2 B / (w h) [N/m] of each whole cell, (q,): energy k |xa - xb + xc - xd|^2 / 2; bending: B [N m]."""
    a, b, _, d = garment.quads.T
    width = garment.rest[b, 0] - garment.rest[a, 0]
    height = garment.rest[d, 1] - garment.rest[a, 1]
    return np.asarray(2.0 * bending / (width * height), dtype=np.float64)


@borrowing_kernel
def twist_forces(x: Floats, cells: Runs, force: Floats) -> None:
    """Add -k w_i (xa - xb + xc - xd) to the corners i of every cell.

    Shapes: x, force (3, n) [m, N]; cells with the value k [N/m].
    """
    none = fill(0.0)
    for axis in range(3):
        y, f = x[axis], force[axis]
        for r in range(cells.length.shape[0]):
            n, stiff = cells.length[r], fill(cells.value[r, 0])
            a, b, c, d = cells.first[r, 0], cells.first[r, 1], cells.first[r, 2], cells.first[r, 3]
            in_row = b - a == 1 and c - d == 1
            before = none
            for block in range(0, n, LANES):
                # The last block ends with the run; what it has in common with the one before is not added again.
                s = min(block, n - LANES)
                pull = stiff * (load(y, a + s) - load(y, b + s) + load(y, c + s) - load(y, d + s))
                fresh = LANES - (block - s)
                if in_row:
                    # Each particle gets the force of the cell behind it and that of the one before.
                    change = last_lanes(together(before, pull, 1) - pull, fresh)
                    add_to(f, a + s, change)
                    take_from(f, d + s, change)
                    before = pull
                    continue
                pull = last_lanes(pull, fresh)
                take_from(f, a + s, pull)
                add_to(f, b + s, pull)
                take_from(f, c + s, pull)
                add_to(f, d + s, pull)
            if in_row:
                f[b + n - 1] += last_lane(before, 0)
                f[c + n - 1] -= last_lane(before, 0)
        for s in range(cells.rest.shape[0]):
            a, b, c, d = cells.rest[s, 0], cells.rest[s, 1], cells.rest[s, 2], cells.rest[s, 3]
            one = cells.rest_value[s, 0] * (y[a] - y[b] + y[c] - y[d])
            f[a] -= one
            f[b] += one
            f[c] -= one
            f[d] += one
