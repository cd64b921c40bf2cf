"""Stiffness and damping of an assembled model, as what they make of a displacement; for the stable time step.

All terms in one compiled function: an estimate takes dozens of products, of which each is about as short as a call from
Python.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.axis_layout import by_axis
from cloth_core.bending import bending_forces
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.step import ForceTerms
from cloth_core.trellis import add_trellis_stiffness
from cloth_core.twist import twist_forces

__all__ = ["StiffnessProduct", "StiffnessTerms", "spring_rows"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class StiffnessTerms(NamedTuple):
    """What a model's forces are at the present positions as stiffness; what it does not have is empty.

    Attributes:
        pairs, spring_rows: springs that act, (s, 2) and (s, 4) as from `spring_rows`.
        cells, cell_rows: shear, (q, 4) and (q, 8) as from `trellis_rows`.
        forces: all that is linear in positions and velocities as it is, and the damping times.
    """

    pairs: Ints
    spring_rows: NDArray[np.float32]
    cells: Ints
    cell_rows: NDArray[np.float32]
    forces: ForceTerms


class StiffnessProduct:
    """Stiffness K [N/m] and damping C [N s/m] of a model's terms, times a displacement.

    Args:
        terms: of the model.
        particles: how many there are.
    """

    def __init__(self, terms: StiffnessTerms, particles: int) -> None:
        self._terms = terms
        # All products use the same room.
        self._total = np.empty((particles, 3))
        self._axes, self._bends = np.empty((2, 3, particles))

    def __call__(self, u: Floats, k: float, c: float) -> Floats:
        """k K u + c C u for a displacement u (n, 3); the next product takes its place."""
        _weighted_product(self._terms, u, k, c, self._axes, self._bends, self._total)
        return self._total


@borrowing_kernel
def _weighted_product(
    terms: StiffnessTerms, u: Floats, k: float, c: float, axes: Floats, bends: Floats, total: Floats
) -> None:
    """k K u + c C u, written to total (n, 3); axes and bends (3, n) are scratch."""
    forces, seam = terms.forces, terms.forces.seam
    total[:] = 0.0
    bends[:] = 0.0
    along_weight = k + c * forces.spring_damping_time
    _add_spring_stiffness(u, terms.pairs, terms.spring_rows, k, along_weight, total)
    add_trellis_stiffness(u, terms.cells, terms.cell_rows, k, along_weight, total)
    by_axis(u, axes)
    bending_forces(axes, forces.lines, forces.hinges, forces.hinge_weights, forces.hinge_stiffness, bends)
    twist_forces(axes, forces.twists, bends)
    weight = k + c * forces.bending_damping_time
    for i in range(u.shape[0]):
        for axis in range(3):
            total[i, axis] -= weight * bends[axis, i]
    for s in range(seam.pairs.shape[0]):
        # The graph's Laplacian: an upper bound for a pull in any direction.
        i, j = seam.pairs[s, 0], seam.pairs[s, 1]
        pull = k * seam.stiffness + c * seam.damping[s]
        for axis in range(3):
            difference = pull * (u[j, axis] - u[i, axis])
            total[i, axis] -= difference
            total[j, axis] += difference
    if forces.air_drag > 0.0:
        for i in range(u.shape[0]):
            drag = c * forces.air_drag * forces.mass[i]
            for axis in range(3):
                total[i, axis] += drag * u[i, axis]


@kernel
def spring_rows(x: Floats, pairs: Ints, rest_length: Floats, stiffness: Floats) -> NDArray[np.float32]:
    """The stiffness of each spring at x across it, c [N/m], and along it, e e', with e (3) [(N/m)^(1/2)], shape (s, 4).

    Along it that is k, across it k (1 - L0 / L) where it is stretched. Single precision is a thousand times finer than
    the estimate made with it, and takes half the room.
    """
    rows = np.zeros((pairs.shape[0], 4), dtype=np.float32)
    for s in range(pairs.shape[0]):
        i, j = pairs[s, 0], pairs[s, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        if squared < 1e-24:
            continue
        rows[s, 0] = stiffness[s] * max(1.0 - rest_length[s] / np.sqrt(squared), 0.0)
        along = np.sqrt(stiffness[s] / squared)
        rows[s, 1], rows[s, 2], rows[s, 3] = along * dx, along * dy, along * dz
    return rows


@borrowing_kernel
def _add_spring_stiffness(
    u: Floats, pairs: Ints, rows: NDArray[np.float32], across_weight: float, along_weight: float, out: Floats
) -> None:
    """Add K u of all springs, with weights across them and along them, where damping acts as well.

    rows (s, 4) as from `spring_rows`, u and out (n, 3).
    """
    for s in range(pairs.shape[0]):
        i, j = pairs[s, 0], pairs[s, 1]
        ux, uy, uz = u[j, 0] - u[i, 0], u[j, 1] - u[i, 1], u[j, 2] - u[i, 2]
        across, ex, ey, ez = across_weight * rows[s, 0], rows[s, 1], rows[s, 2], rows[s, 3]
        own = max(ex * ex + ey * ey + ez * ez, 1e-30)
        along = (along_weight - across / own) * (ex * ux + ey * uy + ez * uz)
        fx, fy, fz = across * ux + along * ex, across * uy + along * ey, across * uz + along * ez
        out[i, 0] -= fx
        out[i, 1] -= fy
        out[i, 2] -= fz
        out[j, 0] += fx
        out[j, 1] += fy
        out[j, 2] += fz
