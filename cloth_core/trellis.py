"""Shear of a lattice cell as a trellis has it: what resists is the difference of the two diagonals' lengths.

With a spring for each diagonal, as in the paper, a cell has six springs for its six distances and stays plane. The
chords of a fold of curvature c are shorter than its arcs by up to (c h)^2 / 24 at a spacing of h, more across the fold
than along it. A strain along warp and one along weft and a shear, which cost next to nothing at that size, make up for
that in three kinds of chords; sides and two diagonals are four. So cloth that bends along a diagonal has to stretch its
diagonals by (c h)^2 / 32, and what they hold, k (c h)^4 / 512 per area, is more than B c^2 / 2 on all but fine grids:
at 20 mm in a fold of 20 mm radius 7 times as much for cotton poplin, 23 times for silk. With the *difference* of the
diagonals there are three: every fold costs its bending and no more (to that order), whatever its direction.

E = k / 4 ((l1 - L1) - (l2 - L2))^2 with the diagonals' lengths l1, l2. Sheared by an angle, both laws hold the same
energy: G = k. Stretched without shear, the trellis holds none: C11 = k_structural, C12 = 0. A cell is a rectangle, so
that L1 = L2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Garment
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.lanes import (
    LANES,
    add_to,
    fill,
    fused,
    inverse_root,
    last_lane,
    last_lanes,
    load,
    take_from,
    together,
)
from cloth_core.runs import Runs

__all__ = ["add_trellis_stiffness", "trellis_forces", "trellis_rows", "trellis_stiffness"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Squared distance [m^2] below which two particles have no direction from one to the other.
_COINCIDENT = 1e-24


def trellis_stiffness(garment: Garment, shear: float) -> Floats:
    """k [N/m] of each whole cell, (q,), for a shear modulus of `shear` [N/m]."""
    a, b, _, d = garment.quads.T
    width = garment.rest[b, 0] - garment.rest[a, 0]
    height = garment.rest[d, 1] - garment.rest[a, 1]
    return np.asarray(shear * 2.0 * width * height / (width**2 + height**2), dtype=np.float64)


@borrowing_kernel
def trellis_forces(x: Floats, v: Floats, cells: Runs, damping_time: float, force: Floats) -> None:
    """Add the forces of all cells to force; damping acts like a strain of damping_time times its rate.

    Shapes: x, v, force (3, n) [m, m/s, N]; cells of the corners a, b, c, d in turn with the value k [N/m].
    """
    px, py, pz = x[0], x[1], x[2]
    vx, vy, vz = v[0], v[1], v[2]
    fx, fy, fz = force[0], force[1], force[2]
    tau, none = fill(damping_time), fill(0.0)
    for r in range(cells.length.shape[0]):
        n, half = cells.length[r], fill(0.5 * cells.value[r, 0])
        i, j, k, m = cells.first[r, 0], cells.first[r, 1], cells.first[r, 2], cells.first[r, 3]
        in_row = j - i == 1 and k - m == 1
        lx, ly, lz, mx, my, mz = none, none, none, none, none, none
        for block in range(0, n, LANES):
            # The last block ends with the run; what it has in common with the one before is not added again.
            s = min(block, n - LANES)
            fresh = LANES - (block - s)
            a, b, c, d = i + s, j + s, k + s, m + s
            x1, y1, z1 = load(px, c) - load(px, a), load(py, c) - load(py, a), load(pz, c) - load(pz, a)
            x2, y2, z2 = load(px, d) - load(px, b), load(py, d) - load(py, b), load(pz, d) - load(pz, b)
            squared1, squared2 = fused(x1, x1, fused(y1, y1, z1 * z1)), fused(x2, x2, fused(y2, y2, z2 * z2))
            inverse1, inverse2 = inverse_root(squared1, _COINCIDENT), inverse_root(squared2, _COINCIDENT)
            difference = squared1 * inverse1 - squared2 * inverse2
            if damping_time > 0.0:
                u1, v1, w1 = load(vx, c) - load(vx, a), load(vy, c) - load(vy, a), load(vz, c) - load(vz, a)
                u2, v2, w2 = load(vx, d) - load(vx, b), load(vy, d) - load(vy, b), load(vz, d) - load(vz, b)
                rate1 = fused(x1, u1, fused(y1, v1, z1 * w1)) * inverse1
                rate2 = fused(x2, u2, fused(y2, v2, z2 * w2)) * inverse2
                difference = fused(tau, rate1 - rate2, difference)
            pull = half * difference
            pull1, pull2 = pull * inverse1, pull * inverse2
            x1, y1, z1 = pull1 * x1, pull1 * y1, pull1 * z1
            x2, y2, z2 = pull2 * x2, pull2 * y2, pull2 * z2
            if in_row:
                # Each particle gets the force of the cell behind it and that of the one before, as in spring_forces.
                add_to(fx, a, last_lanes(x1 - together(mx, x2, 1), fresh))
                add_to(fy, a, last_lanes(y1 - together(my, y2, 1), fresh))
                add_to(fz, a, last_lanes(z1 - together(mz, z2, 1), fresh))
                add_to(fx, d, last_lanes(x2 - together(lx, x1, 1), fresh))
                add_to(fy, d, last_lanes(y2 - together(ly, y1, 1), fresh))
                add_to(fz, d, last_lanes(z2 - together(lz, z1, 1), fresh))
                lx, ly, lz, mx, my, mz = x1, y1, z1, x2, y2, z2
                continue
            x1, y1, z1 = last_lanes(x1, fresh), last_lanes(y1, fresh), last_lanes(z1, fresh)
            x2, y2, z2 = last_lanes(x2, fresh), last_lanes(y2, fresh), last_lanes(z2, fresh)
            add_to(fx, a, x1)
            add_to(fy, a, y1)
            add_to(fz, a, z1)
            take_from(fx, c, x1)
            take_from(fy, c, y1)
            take_from(fz, c, z1)
            take_from(fx, b, x2)
            take_from(fy, b, y2)
            take_from(fz, b, z2)
            add_to(fx, d, x2)
            add_to(fy, d, y2)
            add_to(fz, d, z2)
        if in_row:
            fx[j + n - 1] -= last_lane(mx, 0)
            fy[j + n - 1] -= last_lane(my, 0)
            fz[j + n - 1] -= last_lane(mz, 0)
            fx[k + n - 1] -= last_lane(lx, 0)
            fy[k + n - 1] -= last_lane(ly, 0)
            fz[k + n - 1] -= last_lane(lz, 0)
    for r in range(cells.rest.shape[0]):
        a, b, c, d = cells.rest[r, 0], cells.rest[r, 1], cells.rest[r, 2], cells.rest[r, 3]
        p1, q1, r1 = px[c] - px[a], py[c] - py[a], pz[c] - pz[a]
        p2, q2, r2 = px[d] - px[b], py[d] - py[b], pz[d] - pz[b]
        length1, length2 = np.sqrt(p1 * p1 + q1 * q1 + r1 * r1), np.sqrt(p2 * p2 + q2 * q2 + r2 * r2)
        over1, over2 = 1.0 / max(length1, 1e-12), 1.0 / max(length2, 1e-12)
        speed1 = (p1 * (vx[c] - vx[a]) + q1 * (vy[c] - vy[a]) + r1 * (vz[c] - vz[a])) * over1
        speed2 = (p2 * (vx[d] - vx[b]) + q2 * (vy[d] - vy[b]) + r2 * (vz[d] - vz[b])) * over2
        one = 0.5 * cells.rest_value[r, 0] * (length1 - length2 + damping_time * (speed1 - speed2))
        p1, q1, r1 = one * over1 * p1, one * over1 * q1, one * over1 * r1
        p2, q2, r2 = one * over2 * p2, one * over2 * q2, one * over2 * r2
        fx[a] += p1
        fy[a] += q1
        fz[a] += r1
        fx[c] -= p1
        fy[c] -= q1
        fz[c] -= r1
        fx[b] -= p2
        fy[b] -= q2
        fz[b] -= r2
        fx[d] += p2
        fy[d] += q2
        fz[d] += r2


@kernel
def trellis_rows(x: Floats, cells: Ints, stiffness: Floats) -> NDArray[np.float32]:
    """The stiffness of each cell at x (n, 3) [m], (q, 8): e e' and, where a diagonal is pulled, c across it.

    Its first three numbers are e at corner c (less that at a), the next three at d (less b) [(N/m)^(1/2)]; the last two
    c of both diagonals [N/m]. What a pushed diagonal takes from the stiffness is left out: the estimate is on the safe
    side. Single precision is a thousand times finer than the estimate made with it.
    """
    rows = np.zeros((cells.shape[0], 8), dtype=np.float32)
    for s in range(cells.shape[0]):
        a, b, c, d = cells[s, 0], cells[s, 1], cells[s, 2], cells[s, 3]
        x1, y1, z1 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        x2, y2, z2 = x[d, 0] - x[b, 0], x[d, 1] - x[b, 1], x[d, 2] - x[b, 2]
        l1, l2 = np.sqrt(x1 * x1 + y1 * y1 + z1 * z1), np.sqrt(x2 * x2 + y2 * y2 + z2 * z2)
        if l1 < 1e-12 or l2 < 1e-12:
            continue
        root = np.sqrt(0.5 * stiffness[s])
        rows[s, 0], rows[s, 1], rows[s, 2] = root * x1 / l1, root * y1 / l1, root * z1 / l1
        rows[s, 3], rows[s, 4], rows[s, 5] = -root * x2 / l2, -root * y2 / l2, -root * z2 / l2
        pull = 0.5 * stiffness[s] * (l1 - l2)
        rows[s, 6], rows[s, 7] = max(pull, 0.0) / l1, max(-pull, 0.0) / l2
    return rows


@borrowing_kernel
def add_trellis_stiffness(
    u: Floats, cells: Ints, rows: NDArray[np.float32], across_weight: float, along_weight: float, out: Floats
) -> None:
    """Add K u of all cells, with weights across the diagonals and along them, where damping acts as well.

    rows (q, 8) as from `trellis_rows`, u and out (n, 3).
    """
    for s in range(cells.shape[0]):
        a, b, c, d = cells[s, 0], cells[s, 1], cells[s, 2], cells[s, 3]
        x1, y1, z1 = u[c, 0] - u[a, 0], u[c, 1] - u[a, 1], u[c, 2] - u[a, 2]
        x2, y2, z2 = u[d, 0] - u[b, 0], u[d, 1] - u[b, 1], u[d, 2] - u[b, 2]
        e = rows[s]
        along = along_weight * (e[0] * x1 + e[1] * y1 + e[2] * z1 + e[3] * x2 + e[4] * y2 + e[5] * z2)
        across1, across2 = across_weight * e[6], across_weight * e[7]
        own1, own2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2], e[3] * e[3] + e[4] * e[4] + e[5] * e[5]
        along1 = along - across1 * (e[0] * x1 + e[1] * y1 + e[2] * z1) / max(own1, 1e-30)
        along2 = along - across2 * (e[3] * x2 + e[4] * y2 + e[5] * z2) / max(own2, 1e-30)
        x1, y1, z1 = along1 * e[0] + across1 * x1, along1 * e[1] + across1 * y1, along1 * e[2] + across1 * z1
        x2, y2, z2 = along2 * e[3] + across2 * x2, along2 * e[4] + across2 * y2, along2 * e[5] + across2 * z2
        out[c, 0] += x1
        out[c, 1] += y1
        out[c, 2] += z1
        out[a, 0] -= x1
        out[a, 1] -= y1
        out[a, 2] -= z1
        out[d, 0] += x2
        out[d, 1] += y2
        out[d, 2] += z2
        out[b, 0] -= x2
        out[b, 1] -= y2
        out[b, 2] -= z2
