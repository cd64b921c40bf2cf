"""Cholesky factors of sparse matrices with a block of 3 x 3 for each pair of particles, made once and refilled often.

What a mesh connects does not change while it moves: the order of elimination and the places of all factors are found
once (George and Liu 1981), and each new matrix costs only arithmetic. Neighbouring columns with the same rows make a
supernode, a dense panel, so that nearly all of the work is products of dense blocks (Ng and Peyton 1993, left-looking);
these run on eight numbers at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel
from cloth_core.lanes import LANES, fill, fused, load, store, take_from

__all__ = ["SparseCholesky", "analyse", "factorise", "solve"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Particles in one supernode: its own columns are eliminated one after the other, everything else block by block.
_WIDEST = 8
# Share of a panel that may be zeros for the sake of a wider supernode, and entries that are never too many.
_ZEROS = 0.25
_FEW = 24
# Rows that one pass of a product of blocks works on.
_ROWS = 3 * LANES


class SparseCholesky(NamedTuple):
    """Symbolic factors of a matrix over n particles, and room for their values.

    Particles are eliminated in the order of their place. Supernode s has the particles at places first[s] to
    first[s + 1] - 1, w of them, and a panel of 3 w columns, one after the other in `values`, each of them stride[s]
    long: first the rows of its own particles, then those of the particles `below`.

    Attributes:
        place: of each particle, (n,).
        first, start, stride: of each supernode, (k + 1,), (k,), (k,); start is where its panel begins in `values`.
        below, below_start: places of the particles below, one supernode after the other, and where these begin.
        update, update_start: for each supernode the earlier ones that change it, with the entries [from, to) of `below`
            that are its own particles, (u, 3).
        target, target_start: for each update the rows in the panel changed to which below[from:] belong.
        diagonal, diagonal_stride: where in `values` each particle's own block begins, and the way to its next column,
            (n,).
        off_diagonal, off_diagonal_stride: the same for each pair of particles that was given, (p,); the block's rows
            are those of the particle that is eliminated later.
        values: the panels.
        scratch: room for the product of two blocks.
    """

    place: Ints
    first: Ints
    start: NDArray[np.int64]
    stride: Ints
    below: Ints
    below_start: Ints
    update: Ints
    update_start: Ints
    target: Ints
    target_start: Ints
    diagonal: NDArray[np.int64]
    diagonal_stride: Ints
    off_diagonal: NDArray[np.int64]
    off_diagonal_stride: Ints
    values: Floats
    scratch: Floats


def analyse(particles: int, pairs: Ints) -> SparseCholesky:
    """Find the order and the structure of the factors of a symmetric matrix.

    Args:
        particles: n.
        pairs: particles between which there may be a block, (p, 2); each pair once.
    """
    order = _minimum_degree(particles, pairs)
    structure, order = _structure(particles, pairs, order)
    place = np.empty(particles, dtype=np.int32)
    place[order] = np.arange(particles, dtype=np.int32)

    first = _supernodes(structure)
    width = np.diff(first)
    owner = np.repeat(np.arange(len(width)), width)
    below = [structure[last] for last in first[1:] - 1]
    count = np.array([len(b) for b in below])
    # Whole registers are stored, up to seven numbers beyond the end of a column.
    stride = -(-(3 * (width + count) + LANES - 1) // LANES) * LANES
    start = np.concatenate([[0], np.cumsum(3 * width * stride)])

    rows = [np.concatenate([np.arange(first[s], first[s + 1]), below[s]]) for s in range(len(width))]
    updates: list[list[tuple[int, int, int]]] = [[] for _ in width]
    for s, b in enumerate(below):
        ends = np.flatnonzero(np.diff(owner[b])) + 1
        for low, high in zip([0, *ends], [*ends, len(b)], strict=True):
            if high > low:
                updates[owner[b[low]]].append((s, int(low), int(high)))
    target = [
        np.searchsorted(rows[s], below[k][low:]) * 3 for s, changed in enumerate(updates) for k, low, _ in changed
    ]
    largest = max((3 * (high - low) * (3 * (count[k] - low) + _ROWS) for u in updates for k, low, high in u), default=0)

    def entry(column: NDArray[np.integer], row: NDArray[np.integer]) -> NDArray[np.int64]:
        """Where the block of two places lies."""
        s = owner[column]
        at = np.array([np.searchsorted(rows[k], r) for k, r in zip(s, row, strict=True)], dtype=np.int64)
        return np.asarray(start[s] + 3 * (column - first[s]) * stride[s] + 3 * at, dtype=np.int64)

    ends = np.sort(place[pairs], axis=1) if len(pairs) else np.zeros((0, 2), dtype=np.int32)
    return SparseCholesky(
        place=place,
        first=first.astype(np.int32),
        start=start[:-1].astype(np.int64),
        stride=stride.astype(np.int32),
        below=_joined(below),
        below_start=_starts(below),
        update=np.array([u for changed in updates for u in changed], dtype=np.int32).reshape(-1, 3),
        update_start=_starts(updates),
        target=_joined(target),
        target_start=_starts(target),
        diagonal=entry(place, place),
        diagonal_stride=stride[owner[place]].astype(np.int32),
        off_diagonal=entry(ends[:, 0], ends[:, 1]),
        off_diagonal_stride=stride[owner[ends[:, 0]]].astype(np.int32),
        values=np.zeros(int(start[-1]) + _ROWS),
        scratch=np.zeros(max(int(largest), 3 * int(count.max(initial=0))) + _ROWS),
    )


def _joined(parts: list[NDArray[np.int64]]) -> Ints:
    return np.concatenate([*parts, np.zeros(0)]).astype(np.int32)


def _starts(parts: list[NDArray[np.int64]] | list[list[tuple[int, int, int]]]) -> Ints:
    return np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int32)


def _minimum_degree(particles: int, pairs: Ints) -> NDArray[np.int64]:
    """Particles in an order in which few blocks fill in: SuperLU's multiple minimum degree (Liu 1985)."""
    from scipy.sparse import coo_matrix, eye
    from scipy.sparse.linalg import splu

    i, j = pairs.T
    graph = coo_matrix((np.ones(len(pairs)), (i, j)), shape=(particles, particles))
    dominant = (graph + graph.T + (2.0 * len(pairs) + 1.0) * eye(particles)).tocsc()
    found = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.argsort(found.perm_c).astype(np.int64)


def _structure(
    particles: int, pairs: Ints, order: NDArray[np.int64]
) -> tuple[list[NDArray[np.int64]], NDArray[np.int64]]:
    """Places below the diagonal in each column of the factor; and the order, changed so that children precede parents.

    A column has the rows of the matrix and of all columns whose first row it is, its children in the elimination tree.
    """
    place = np.empty(particles, dtype=np.int64)
    place[order] = np.arange(particles)
    ends = np.sort(place[pairs], axis=1)
    rows: list[set[int]] = [set() for _ in range(particles)]
    for low, high in ends.tolist():
        rows[low].add(high)
    children: list[list[int]] = [[] for _ in range(particles)]
    roots: list[int] = []
    for j in range(particles):
        for child in children[j]:
            rows[j] |= rows[child]
        rows[j].discard(j)
        (children[min(rows[j])] if rows[j] else roots).append(j)
    post: list[int] = []
    waiting = [(root, False) for root in reversed(roots)]
    while waiting:
        j, done = waiting.pop()
        if done:
            post.append(j)
        else:
            waiting.append((j, True))
            # The largest child comes last: with its parent it makes the wider supernode.
            waiting += [(c, False) for c in sorted(children[j], key=lambda c: (-len(rows[c]), c))]
    moved = np.empty(particles, dtype=np.int64)
    moved[post] = np.arange(particles)
    structure = [np.sort(moved[np.fromiter(rows[j], np.int64, len(rows[j]))]) for j in post]
    return structure, np.asarray(order[post])


def _supernodes(structure: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """First places of the supernodes, and the number of places."""
    first = [0]
    exact = 0
    for j in range(1, len(structure) + 1):
        exact += 1 + len(structure[j - 1])
        if j < len(structure):
            w = j + 1 - first[-1]
            stored = w * len(structure[j]) + w * (w + 1) // 2
            zeros = stored - exact - 1 - len(structure[j])
            follows = len(structure[j - 1]) > 0 and structure[j - 1][0] == j
            if follows and w <= _WIDEST and (zeros <= _FEW or zeros <= _ZEROS * stored):
                continue
        first.append(j)
        exact = 0
    return np.array(first, dtype=np.int64)


@borrowing_kernel
def factorise(system: SparseCholesky) -> bool:
    """Turn the matrix in `values` into its factor L, A = L L', in place; False if A is not positive definite."""
    for s in range(system.stride.shape[0]):
        for u in range(system.update_start[s], system.update_start[s + 1]):
            _update(system, s, u)
        width = 3 * (system.first[s + 1] - system.first[s])
        height = width + 3 * (system.below_start[s + 1] - system.below_start[s])
        if not _eliminate(system.values, system.start[s], system.stride[s], width, height):
            return False
    return True


@borrowing_kernel
def _eliminate(values: Floats, start: int, stride: int, width: int, height: int) -> bool:
    """Cholesky of one panel: its own columns, and the rows below divided by them."""
    for c in range(width):
        column = start + c * stride
        pivot = values[column + c]
        if not 0.0 < pivot < np.inf:
            return False
        root = np.sqrt(pivot)
        for r in range(c, height):
            values[column + r] /= root
        for other in range(c + 1, width):
            changed = start + other * stride
            factor = fill(values[column + other])
            for r in range(other, height, LANES):
                take_from(values, changed + r, factor * load(values, column + r))
    return True


@borrowing_kernel
def _update(system: SparseCholesky, s: int, u: int) -> None:
    """Take from panel s what an earlier supernode contributes: the product of two blocks of its rows."""
    k, low, high = system.update[u, 0], system.update[u, 1], system.update[u, 2]
    values, product = system.values, system.scratch
    width = system.first[k + 1] - system.first[k]
    stride = system.stride[k]
    begin = system.start[k] + 3 * (width + low)
    count = system.below_start[k + 1] - system.below_start[k] - low
    room = 3 * count + _ROWS
    for j in range(high - low):
        for r in range(3 * j, 3 * count, _ROWS):
            _product(values, begin + 3 * j, begin + r, stride, 3 * width, product, 3 * j * room + r, room)
    target = system.target_start[u]
    into_start, into_stride = system.start[s], system.stride[s]
    for j in range(high - low):
        for axis in range(3):
            column = into_start + (system.target[target + j] + axis) * into_stride
            source = (3 * j + axis) * room
            for i in range(j, count):
                at = column + system.target[target + i]
                values[at] -= product[source + 3 * i]
                values[at + 1] -= product[source + 3 * i + 1]
                values[at + 2] -= product[source + 3 * i + 2]


@inlined_kernel
def _product(
    values: Floats, left: int, right: int, stride: int, columns: int, product: Floats, at: int, room: int
) -> None:
    """Products of 3 rows at `left` with 24 at `right`, summed over the columns, to three rows of `product`."""
    zero = fill(0.0)
    a0, a1, a2, b0, b1, b2, c0, c1, c2 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for c in range(columns):
        shift = c * stride
        x, y, z = load(values, right + shift), load(values, right + shift + 8), load(values, right + shift + 16)
        one, two, three = (
            fill(values[left + shift]), fill(values[left + shift + 1]), fill(values[left + shift + 2]),
        )  # fmt: skip
        a0, a1, a2 = fused(one, x, a0), fused(one, y, a1), fused(one, z, a2)
        b0, b1, b2 = fused(two, x, b0), fused(two, y, b1), fused(two, z, b2)
        c0, c1, c2 = fused(three, x, c0), fused(three, y, c1), fused(three, z, c2)
    store(product, at, a0)
    store(product, at + 8, a1)
    store(product, at + 16, a2)
    store(product, at + room, b0)
    store(product, at + room + 8, b1)
    store(product, at + room + 16, b2)
    store(product, at + 2 * room, c0)
    store(product, at + 2 * room + 8, c1)
    store(product, at + 2 * room + 16, c2)


@kernel
def solve(system: SparseCholesky, y: Floats) -> None:
    """Solve L L' x = y in place; y (3 n,), three numbers for each place."""
    values, part = system.values, system.scratch
    supernodes = system.stride.shape[0]
    for s in range(supernodes):
        start, stride = system.start[s], system.stride[s]
        own, width = 3 * system.first[s], 3 * (system.first[s + 1] - system.first[s])
        first, last = system.below_start[s], system.below_start[s + 1]
        for c in range(width):
            column = start + c * stride
            y[own + c] /= values[column + c]
            for r in range(c + 1, width):
                y[own + r] -= values[column + r] * y[own + c]
        for r in range(0, 3 * (last - first), LANES):
            total = fill(0.0)
            for c in range(width):
                total = fused(load(values, start + c * stride + width + r), fill(y[own + c]), total)
            store(part, r, total)
        for b in range(first, last):
            at, entry = 3 * system.below[b], 3 * (b - first)
            y[at] -= part[entry]
            y[at + 1] -= part[entry + 1]
            y[at + 2] -= part[entry + 2]
    eight = np.zeros(LANES)
    for s in range(supernodes - 1, -1, -1):
        start, stride = system.start[s], system.stride[s]
        own, width = 3 * system.first[s], 3 * (system.first[s + 1] - system.first[s])
        first, last = system.below_start[s], system.below_start[s + 1]
        height = 3 * (last - first)
        for b in range(first, last):
            at, entry = 3 * system.below[b], 3 * (b - first)
            part[entry], part[entry + 1], part[entry + 2] = y[at], y[at + 1], y[at + 2]
        for r in range(height, height + LANES):
            part[r] = 0.0
        for c in range(width - 1, -1, -1):
            column = start + c * stride
            total = fill(0.0)
            for r in range(0, height, LANES):
                total = fused(load(values, column + width + r), load(part, r), total)
            store(eight, 0, total)
            rest = y[own + c] - eight.sum()
            for r in range(c + 1, width):
                rest -= values[column + r] * y[own + r]
            y[own + c] = rest / values[column + c]
