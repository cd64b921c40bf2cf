"""The matrix of an implicit step, M + h D + h^2 K: what springs, cells and bending elements add to it.

K and D are the derivatives of the forces by place and velocity at the positions at hand. Where a spring is compressed,
the part of its stiffness across it is negative and left out, so that the matrix is positive definite at any h (Choi and
Ko 2002), as it is of a cell's diagonal that the cell pushes; what the forces are is not touched by that, only how fast
Newton's method gets there.

The strain limit is a much stiffer spring beyond it, which the matrix holds as any other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.bending import Bending
from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel
from cloth_core.sparse_cholesky import SparseCholesky, analyse
from cloth_core.springs import Springs
from cloth_core.step import ForceTerms
from cloth_core.strain_limit import StrainLimit, limited_springs
from cloth_core.twist import TWIST_WEIGHTS

__all__ = ["ImplicitMatrix", "assemble", "build_matrix", "limit_forces"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Squared distance [m^2] below which two particles have no direction from one to the other.
_COINCIDENT = 1e-24
# Corners between which a cell adds a block: sides, then diagonals.
_CELL_LINKS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3))
# How many times stiffer a spring is beyond its strain limit: implicit steps take that as it is, without impulses.
_STIFFER = 100.0


class ImplicitMatrix(NamedTuple):
    """Places of all elements in the matrix.

    Attributes:
        links: pairs of particles that anything connects, (l, 2).
        bend, bend_own: what bending, whose stiffness is constant, adds to each link (l,) and particle (n,) [N/m].
        spring_pairs, spring_link: ends and link of each spring, (s, 2) and (s,).
        rest_length, longest, stiffness: of the springs [m, m, N/m], (s,); longest is inf for those without a limit.
        cells: corners in turn of those that resist shear, (q, 4); cell_stiffness: how much [N/m], (q,).
        cell_links: of the sides ab, bc, cd, da and the diagonals ac, bd of each cell, (q, 6).
        factors: of the matrix.
    """

    links: Ints
    bend: Floats
    bend_own: Floats
    spring_pairs: Ints
    spring_link: Ints
    rest_length: Floats
    longest: Floats
    stiffness: Floats
    cells: Ints
    cell_stiffness: Floats
    cell_links: Ints
    factors: SparseCholesky


def build_matrix(
    particles: int,
    springs: Springs,
    limit: StrainLimit,
    bending: Bending,
    trellis: Ints,
    trellis_stiffness: Floats,
) -> ImplicitMatrix:
    """Find the places of all elements; trellis (q, 4): cells that resist shear, trellis_stiffness (q,) [N/m]."""
    own = np.zeros(particles)
    pairs, bends = [springs.pairs], [np.zeros(len(springs))]
    line_weights = np.tile([1.0, -2.0, 1.0], (len(bending.lines), 1))
    for index, weights, stiffness in (
        (bending.lines, line_weights, bending.line_stiffness),
        (bending.hinges, bending.hinge_weights, bending.hinge_stiffness),
        (bending.cells, np.tile(TWIST_WEIGHTS, (len(bending.cells), 1)), bending.twist_stiffness),
    ):
        for a in range(index.shape[1]):
            own += np.bincount(index[:, a], weights=stiffness * weights[:, a] ** 2, minlength=particles)
            for b in range(a):
                pairs.append(index[:, [a, b]])
                bends.append(stiffness * weights[:, a] * weights[:, b])
    sides = [trellis[:, ends] for ends in _CELL_LINKS]
    both = np.sort(np.concatenate([*pairs, *sides]), axis=1).astype(np.int64)
    unbent = len(both) - sum(len(b) for b in bends)
    bends.append(np.zeros(unbent))
    key, link = np.unique(both[:, 0] * particles + both[:, 1], return_inverse=True)
    links = np.stack([key // particles, key % particles], axis=1).astype(np.int32)
    longest = np.full(len(springs), np.inf)
    if len(limit.longest) > 0:
        longest[limited_springs(springs)] = limit.longest
    return ImplicitMatrix(
        links=links,
        bend=np.bincount(link, weights=np.concatenate(bends), minlength=len(key)).astype(np.float64),
        bend_own=own,
        spring_pairs=springs.pairs,
        spring_link=link[: len(springs)].astype(np.int32),
        rest_length=springs.rest_length,
        longest=longest,
        stiffness=springs.stiffness,
        cells=trellis,
        cell_stiffness=trellis_stiffness,
        cell_links=np.ascontiguousarray(link[len(link) - unbent :].reshape(len(sides), -1).T, dtype=np.int32),
        factors=analyse(particles, links),
    )


@kernel
def assemble(matrix: ImplicitMatrix, x: Floats, terms: ForceTerms, h: float) -> None:
    """Write M + h D + h^2 K at positions x (n, 3) [m] into the room of the factors; h [s].

    What is held has a row and a column of the unit matrix.
    """
    factors = matrix.factors
    values = factors.values
    values[:] = 0.0
    inverse_mass = terms.inverse_mass
    scale = h * h + h * terms.bending_damping_time
    for i in range(inverse_mass.shape[0]):
        own = 1.0
        if inverse_mass[i] > 0.0:
            own = terms.mass[i] * (1.0 + h * terms.air_drag) + scale * matrix.bend_own[i]
        _add(values, factors.diagonal[i], factors.diagonal_stride[i], own)
    for k in range(matrix.links.shape[0]):
        i, j = matrix.links[k, 0], matrix.links[k, 1]
        if inverse_mass[i] > 0.0 and inverse_mass[j] > 0.0:
            _add(values, factors.off_diagonal[k], factors.off_diagonal_stride[k], scale * matrix.bend[k])
    for s in range(matrix.spring_link.shape[0]):
        i, j = matrix.spring_pairs[s, 0], matrix.spring_pairs[s, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        if squared < _COINCIDENT:
            continue
        length = np.sqrt(squared)
        across = max(1.0 - matrix.rest_length[s] / length, 0.0)
        along = 1.0 - across
        if length > matrix.longest[s]:
            beyond = 1.0 - matrix.longest[s] / length
            across += _STIFFER * beyond
            along += _STIFFER * (1.0 - beyond)
        along = (along * h * h + terms.spring_damping_time * h) * matrix.stiffness[s] / squared
        _add_pair(matrix, inverse_mass, matrix.spring_link[s], i, j, across * h * h * matrix.stiffness[s], along,
                  dx, dy, dz)  # fmt: skip
    along = 0.5 * (h * h + h * terms.spring_damping_time)
    direction = np.zeros((5, 3))
    for s in range(matrix.cells.shape[0]):
        _add_cell(matrix, inverse_mass, x, s, along * matrix.cell_stiffness[s], 0.5 * h * h * matrix.cell_stiffness[s],
                  direction)  # fmt: skip


@borrowing_kernel
def limit_forces(matrix: ImplicitMatrix, x: Floats, force: Floats) -> None:
    """Add the additional pull of springs beyond their strain limit; x (n, 3) [m], force (3, n) [N]."""
    for s in range(matrix.longest.shape[0]):
        i, j = matrix.spring_pairs[s, 0], matrix.spring_pairs[s, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        longest = matrix.longest[s]
        if squared > longest * longest:
            pull = _STIFFER * matrix.stiffness[s] * (1.0 - longest / np.sqrt(squared))
            for axis, d in ((0, dx), (1, dy), (2, dz)):
                force[axis, i] += pull * d
                force[axis, j] -= pull * d


@borrowing_kernel
def _add_pair(
    matrix: ImplicitMatrix, inverse_mass: Floats, link: int, i: int, j: int,
    across: float, along: float, dx: float, dy: float, dz: float,
) -> None:  # fmt: skip
    """Add the block across 1 + along d d' of an element between i and j, d = (dx, dy, dz)."""
    factors = matrix.factors
    ex, ey, ez = along * dx, along * dy, along * dz
    free = 0
    for k in (i, j):
        if inverse_mass[k] > 0.0:
            free += 1
            at, stride = factors.diagonal[k], factors.diagonal_stride[k]
            _add(factors.values, at, stride, across)
            _add_outer(factors.values, at, stride, ex, ey, ez, dx, dy, dz)
    if free == 2:
        at, stride = factors.off_diagonal[link], factors.off_diagonal_stride[link]
        _add(factors.values, at, stride, -across)
        _add_outer(factors.values, at, stride, -ex, -ey, -ez, dx, dy, dz)


@borrowing_kernel
def _add_cell(
    matrix: ImplicitMatrix, inverse_mass: Floats, x: Floats, s: int, along: float, pull: float, direction: Floats
) -> None:
    """Add along g g' of cell s, g the way in which its corners change the difference of its diagonals, and what pulled
    diagonals resist across them: pull times that difference over their length. direction (5, 3) is scratch.
    """
    factors, corner, links = matrix.factors, matrix.cells[s], matrix.cell_links[s]
    lengths = direction[4]
    for diagonal in range(2):
        i, j = corner[diagonal], corner[diagonal + 2]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        lengths[diagonal] = length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if length * length < _COINCIDENT:
            return
        sign = 1.0 if diagonal == 0 else -1.0
        direction[diagonal + 2, 0], direction[diagonal + 2, 1] = sign * dx / length, sign * dy / length
        direction[diagonal + 2, 2] = sign * dz / length
        for axis in range(3):
            direction[diagonal, axis] = -direction[diagonal + 2, axis]
    for diagonal in range(2):
        difference = lengths[0] - lengths[1] if diagonal == 0 else lengths[1] - lengths[0]
        across = pull * max(difference, 0.0) / lengths[diagonal]
        i, j, d = corner[diagonal], corner[diagonal + 2], direction[diagonal]
        _add_pair(matrix, inverse_mass, links[4 + diagonal], i, j, across, along - across, d[0], d[1], d[2])
    for side in range(4):
        p, q = side, (side + 1) % 4
        i, j = corner[p], corner[q]
        if inverse_mass[i] > 0.0 and inverse_mass[j] > 0.0:
            # The rows of a block belong to the particle that is eliminated later.
            row, column = (direction[p], direction[q]) if factors.place[i] > factors.place[j] else (
                direction[q], direction[p]
            )  # fmt: skip
            at, stride = factors.off_diagonal[links[side]], factors.off_diagonal_stride[links[side]]
            for k in range(3):
                e = along * column[k]
                for axis in range(3):
                    factors.values[at + k * stride + axis] += e * row[axis]


@inlined_kernel
def _add(values: Floats, at: int, stride: int, own: float) -> None:
    """Add own to the diagonal of a block."""
    values[at] += own
    values[at + stride + 1] += own
    values[at + 2 * stride + 2] += own


@inlined_kernel
def _add_outer(
    values: Floats, at: int, stride: int, ex: float, ey: float, ez: float, dx: float, dy: float, dz: float
) -> None:
    """Add e d', which is symmetric, to a block."""
    for column, e in ((at, ex), (at + stride, ey), (at + 2 * stride, ez)):
        values[column] += e * dx
        values[column + 1] += e * dy
        values[column + 2] += e * dz
