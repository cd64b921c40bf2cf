"""The sparse factorisation against NumPy's dense one, on graphs from one particle to a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from apparatus import sheet
from numpy.typing import NDArray

from cloth_core.sparse_cholesky import SparseCholesky, analyse, factorise, solve

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


def _random_matrix(n: int, pairs: Ints, chance: np.random.Generator) -> Floats:
    """A symmetric, diagonally dominant matrix (3 n, 3 n) with symmetric blocks at the pairs and on the diagonal."""
    a = np.zeros((n, 3, n, 3))
    for i, j in pairs:
        block = chance.standard_normal((3, 3))
        a[i, :, j, :] = a[j, :, i, :] = block + block.T
    dominant = np.abs(a).sum(axis=(1, 2, 3)).max() + 1.0
    for i in range(n):
        block = chance.standard_normal((3, 3))
        a[i, :, i, :] = block + block.T + (dominant + 10.0) * np.eye(3)
    return a.reshape(3 * n, 3 * n)


def _write(factors: SparseCholesky, pairs: Ints, matrix: Floats) -> None:
    """Put a matrix where the factors are to be."""
    n = len(factors.place)
    blocks = matrix.reshape(n, 3, n, 3)
    factors.values[:] = 0.0
    for axis in range(3):
        for i in range(n):
            at = factors.diagonal[i] + axis * factors.diagonal_stride[i]
            factors.values[at : at + 3] = blocks[i, :, i, axis]
        for k, (i, j) in enumerate(pairs):
            at = factors.off_diagonal[k] + axis * factors.off_diagonal_stride[k]
            factors.values[at : at + 3] = blocks[i, :, j, axis]


def _solved(factors: SparseCholesky, right: Floats) -> Floats:
    y = np.zeros((len(factors.place), 3))
    y[factors.place] = right
    flat = y.ravel()
    solve(factors, flat)
    return np.asarray(flat.reshape(-1, 3)[factors.place])


def _pairs(kind: str) -> tuple[int, Ints]:
    chance = np.random.default_rng(5)
    if kind == "one particle":
        return 1, np.zeros((0, 2), dtype=np.int32)
    if kind == "no pairs":
        return 7, np.zeros((0, 2), dtype=np.int32)
    if kind == "chain":
        return 40, np.stack([np.arange(39), np.arange(1, 40)], axis=1).astype(np.int32)
    if kind == "all with all":
        return 30, np.stack(np.triu_indices(30, 1), axis=1).astype(np.int32)
    if kind == "mesh":
        triangles = sheet(0.3, 0.4, 0.02).triangles
        sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        return int(triangles.max()) + 1, np.unique(sides, axis=0).astype(np.int32)
    ends = np.sort(chance.integers(0, 80, (160, 2)), axis=1)  # two islands and loops
    ends = ends[ends[:, 0] != ends[:, 1]]
    return 160, np.unique(np.concatenate([ends, ends + 80]), axis=0).astype(np.int32)


@pytest.mark.parametrize("kind", ["one particle", "no pairs", "chain", "all with all", "mesh", "random"])
def test_solution_is_that_of_a_dense_solver(kind: str) -> None:
    n, pairs = _pairs(kind)
    chance = np.random.default_rng(1)
    factors = analyse(n, pairs)
    for _ in range(2):  # the same structure serves for any values
        matrix, right = _random_matrix(n, pairs, chance), chance.standard_normal((n, 3))
        _write(factors, pairs, matrix)
        assert factorise(factors)
        expected = np.linalg.solve(matrix, right.ravel()).reshape(-1, 3)
        np.testing.assert_allclose(_solved(factors, right), expected, rtol=1e-11, atol=1e-13)


def test_ill_conditioned_matrix_is_solved_to_a_small_residual() -> None:
    """As an implicit step of stiff cloth has it: masses next to stiffnesses ten orders of magnitude larger."""
    n, pairs = _pairs("mesh")
    chance = np.random.default_rng(2)
    matrix = 1e-4 * np.eye(3 * n)
    for i, j in pairs:
        way = chance.standard_normal(3)
        block = 1e6 * np.outer(way, way)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign * block
    factors = analyse(n, pairs)
    _write(factors, pairs, matrix)
    assert factorise(factors)
    right = chance.standard_normal((n, 3))
    found = _solved(factors, right).ravel()
    scale = np.abs(matrix).sum(axis=1).max() * np.abs(found).max()
    assert np.abs(matrix @ found - right.ravel()).max() < 1e-14 * scale


@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan, np.inf])
def test_matrix_that_is_not_positive_definite_is_told(bad: float) -> None:
    n, pairs = _pairs("chain")
    matrix = _random_matrix(n, pairs, np.random.default_rng(3))
    matrix[3 * 17 + 1, 3 * 17 + 1] = bad
    factors = analyse(n, pairs)
    _write(factors, pairs, matrix)
    assert not factorise(factors)


def test_a_mesh_fills_in_less_than_half_of_what_a_band_would() -> None:
    n, pairs = _pairs("mesh")
    width = int(np.abs(pairs[:, 1] - pairs[:, 0]).max())
    assert len(analyse(n, pairs).values) < 0.5 * 9 * n * (width + 1)
