"""True bending stiffness [N m]: what keeps cloth from crumpling into its grid.

The paper's bending springs have no stiffness at all in the flat state (their energy grows with the fourth power of the
angle) and their effect vanishes as the grid is refined. This term does not: three particles in line resist by
k |x- - 2 x0 + x+|^2 / 2 with k = B * width / spacing^3, cells against being twisted (`cloth_core.twist`), and two
triangles outside the grid (and across seams) by the quadratic hinge energy of Bergou et al. 2006. All these forces are
linear in the positions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment, renumbered
from cloth_core.kernel import borrowing_kernel
from cloth_core.lanes import LANES, add_to, fill, fused, last_lane, last_lanes, load, take_from, together
from cloth_core.runs import Runs, find_runs
from cloth_core.twist import twist_stiffness

__all__ = ["Bending", "bending_forces", "build_bending", "hinges"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Bending:
    """Linear bending elements of a garment: energy = stiffness |sum weights_i x_i|^2 / 2.

    Attributes:
        lines: triples in line, shape (l, 3), with weights (1, -2, 1).
        line_stiffness: [N/m], shape (l,).
        hinges: two triangles' shared side and opposite corners, shape (h, 4).
        hinge_weights: shape (h, 4), dimensionless.
        hinge_stiffness: [N/m], shape (h,).
        cells: corners of whole cells in turn, shape (q, 4), with weights (1, -1, 1, -1).
        twist_stiffness: [N/m], shape (q,).
    """

    lines: Ints
    line_stiffness: Floats
    hinges: Ints
    hinge_weights: Floats
    hinge_stiffness: Floats
    cells: Ints = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int32))
    twist_stiffness: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.lines) + len(self.hinges) + len(self.cells)

    def line_runs(self) -> Runs:
        """The triples in line as runs with the value k [N/m]."""
        return find_runs(self.lines, self.line_stiffness[:, None])

    def twist_runs(self) -> Runs:
        """The cells as runs with the value k [N/m]."""
        return find_runs(self.cells, self.twist_stiffness[:, None])


def hinges(triangles: Ints) -> tuple[Ints, Ints]:
    """Pairs of triangles with a common side.

    Returns:
        the particles (side start, side end, corner of the first, corner of the second), shape (h, 4), and the two
        triangles, shape (h, 2). Sides with one triangle or more than two have no hinge.
    """
    count = len(triangles)
    start = triangles.reshape(-1)
    end = triangles[:, [1, 2, 0]].reshape(-1)
    corner = triangles[:, [2, 0, 1]].reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((np.arange(3 * count), high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    single = np.ones(len(same), dtype=bool)
    if len(same) > 1:  # a side that three triangles share is left alone
        single[1:] &= ~same[:-1]
        single[:-1] &= ~same[1:]
    k = np.flatnonzero(same & single)
    one, two = order[k], order[k + 1]
    hinge = np.stack([start[one], end[one], corner[one], corner[two]], axis=1).astype(np.int32)
    return hinge, np.stack([one // 3, two // 3], axis=1).astype(np.int32)


def build_bending(garment: Garment, fabric: Fabric, number: Ints) -> Bending:
    """Bending elements between the particles `number[i]` (sewn ones when seams are merged), shape of number (n,)."""
    rest = garment.rest
    lines, stiffness = [], []
    for triples, along in ((garment.rows, 0), (garment.columns, 1)):
        if len(triples) == 0:
            continue
        spacing = (rest[triples[:, 2], along] - rest[triples[:, 0], along]) / 2.0
        width = _node_areas(garment)[triples[:, 1]] / spacing
        lines.append(triples)
        stiffness.append(fabric.bending * width / spacing**3)
    line_index = np.concatenate(lines) if lines else np.zeros((0, 3), dtype=np.int32)
    line_stiffness = np.concatenate(stiffness) if stiffness else np.zeros(0)

    hinge, sides = hinges(renumbered(garment.triangles, number))
    same_panel = garment.panel_of_triangle[sides[:, 0]] == garment.panel_of_triangle[sides[:, 1]]
    in_grid = garment.in_quad[sides].all(axis=1) & same_panel
    hinge, sides = hinge[~in_grid], sides[~in_grid]
    weights, hinge_stiffness = _hinge_elements(garment, hinge, sides, number, fabric.bending)
    return Bending(
        lines=renumbered(line_index, number),
        line_stiffness=line_stiffness,
        hinges=hinge,
        hinge_weights=weights,
        hinge_stiffness=hinge_stiffness,
        cells=renumbered(garment.quads, number),
        twist_stiffness=twist_stiffness(garment, fabric.bending),
    )


def _node_areas(garment: Garment) -> Floats:
    """Area of whole cells around each particle [m^2], shape (n,): a quarter of each cell."""
    a, b, _, d = garment.quads.T
    cell = (garment.rest[b, 0] - garment.rest[a, 0]) * (garment.rest[d, 1] - garment.rest[a, 1])
    weights = np.repeat(cell / 4.0, 4)
    return np.bincount(garment.quads.ravel(), weights=weights, minlength=len(garment.rest)).astype(np.float64)


def _hinge_elements(garment: Garment, hinge: Ints, sides: Ints, number: Ints, bending: float) -> tuple[Floats, Floats]:
    """Weights and stiffness of the quadratic hinge energy B |K x|^2 / (2 (A0 + A1)) (weights: Bergou et al. 2006).

    |K x| is side length times angle, so this is B |e| angle^2 / (h1 + h2), right for a strip of right-angled triangles
    bent along a row (only one side in three bends there) and for equilateral ones (Seung and Nelson 1988).

    Each triangle is laid out in its own panel's rest shape: across a seam the two sides may differ in length.
    """
    cot = np.zeros((len(hinge), 4))  # at side start and end in triangle 0, then in triangle 1
    area = np.zeros(len(hinge))
    for side in range(2):
        corners = garment.triangles[sides[:, side]]
        sewn = number[corners]
        place = [np.argmax(sewn == hinge[:, k][:, None], axis=1) for k in (0, 1, 2 + side)]
        p, q, r = (garment.rest[corners[np.arange(len(hinge)), at]] for at in place)
        twice = np.abs((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0])
        area += twice / 2.0
        cot[:, 2 * side] = ((q - p) * (r - p)).sum(1) / twice
        cot[:, 2 * side + 1] = ((p - q) * (r - q)).sum(1) / twice
    at_start, at_end = cot[:, 0] + cot[:, 2], cot[:, 1] + cot[:, 3]
    weights = np.stack([at_end, at_start, -(cot[:, 0] + cot[:, 1]), -(cot[:, 2] + cot[:, 3])], axis=1)
    return weights, bending / area


@borrowing_kernel
def bending_forces(x: Floats, lines: Runs, hinge: Ints, weights: Floats, stiffness: Floats, force: Floats) -> None:
    """Add -k w_i sum_j w_j x_j to every particle of every bending element.

    Shapes: x, force (3, n) [m, N]; lines with the value k [N/m] and the weights (1, -2, 1); hinge, weights (h, 4);
    stiffness k (h,) [N/m]. The force is linear in x: with x + tau v in its place it includes a damping of time tau.
    """
    minus_two, two, none = fill(-2.0), fill(2.0), fill(0.0)
    for axis in range(3):
        y, f = x[axis], force[axis]
        for r in range(lines.length.shape[0]):
            n, stiff = lines.length[r], fill(lines.value[r, 0])
            i, j, k = lines.first[r, 0], lines.first[r, 1], lines.first[r, 2]
            if j - i == 1 and k - i == 2:
                # Along a row each particle gets the forces of three triples at once, as in spring_forces.
                before = none
                for block in range(0, n, LANES):
                    s = min(block, n - LANES)
                    one = stiff * fused(minus_two, load(y, j + s), load(y, i + s) + load(y, k + s))
                    if block - s == 1:  # as in spring_forces
                        before = together(none, before, 1)
                    change = fused(two, together(before, one, 1), none - together(before, one, 2)) - one
                    add_to(f, i + s, last_lanes(change, LANES - (block - s)))
                    before = one
                f[j + n - 1] += 2.0 * last_lane(before, 0) - last_lane(before, 1)
                f[k + n - 1] -= last_lane(before, 0)
                continue
            for block in range(0, n, LANES):
                s = min(block, n - LANES)
                one = stiff * fused(minus_two, load(y, j + s), load(y, i + s) + load(y, k + s))
                if s < block:
                    one = last_lanes(one, LANES - (block - s))
                take_from(f, i + s, one)
                add_to(f, j + s, two * one)
                take_from(f, k + s, one)
        for s in range(lines.rest.shape[0]):
            i, j, k = lines.rest[s, 0], lines.rest[s, 1], lines.rest[s, 2]
            bend = lines.rest_value[s, 0] * (y[i] - 2.0 * y[j] + y[k])
            f[i] -= bend
            f[j] += 2.0 * bend
            f[k] -= bend
    x0, x1, x2 = x[0], x[1], x[2]
    f0, f1, f2 = force[0], force[1], force[2]
    for s in range(hinge.shape[0]):
        # Unsigned: no index counts from the end of its row.
        a, b, c, d = np.uintp(hinge[s, 0]), np.uintp(hinge[s, 1]), np.uintp(hinge[s, 2]), np.uintp(hinge[s, 3])
        wa, wb, wc, wd = weights[s, 0], weights[s, 1], weights[s, 2], weights[s, 3]
        k0 = stiffness[s] * (wa * x0[a] + wb * x0[b] + wc * x0[c] + wd * x0[d])
        k1 = stiffness[s] * (wa * x1[a] + wb * x1[b] + wc * x1[c] + wd * x1[d])
        k2 = stiffness[s] * (wa * x2[a] + wb * x2[b] + wc * x2[c] + wd * x2[d])
        f0[a] -= wa * k0
        f0[b] -= wb * k0
        f0[c] -= wc * k0
        f0[d] -= wd * k0
        f1[a] -= wa * k1
        f1[b] -= wb * k1
        f1[c] -= wc * k1
        f1[d] -= wd * k1
        f2[a] -= wa * k2
        f2[b] -= wb * k2
        f2[c] -= wc * k2
        f2[d] -= wd * k2
