"""Step 2 of the paper: structural, shear and bending springs, and step 3: their forces by Hooke's law.

Inside a panel the springs are those of the regular grid. In the band at the outline there is no grid neighbour: there
they follow the sides of the triangles, with the stiffness that an area of cloth next to a side contributes (Van Gelder
1998, k = E * area / length^2), and the opposite corners of two triangles for bending.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.kernel import borrowing_kernel
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
from cloth_core.runs import Runs, find_runs
from cloth_core.trellis import trellis_stiffness

__all__ = ["SpringFamily", "Springs", "build_springs", "spring_forces", "spring_strains"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Squared distance [m^2] below which two particles have no direction from one to the other.
_COINCIDENT = 1e-24
# No spring between lattice and outline is softened to less than this share.
_LEAST_SHARE = 0.05


class SpringFamily(IntEnum):
    """The paper's three families."""

    STRUCTURAL = 0
    SHEAR = 1
    BENDING = 2


@dataclass(frozen=True)
class Springs:
    """All springs of a garment.

    Attributes:
        pairs: particle indices, shape (s, 2), lower index first, sorted.
        rest_length: L0 [m], shape (s,).
        stiffness: k [N/m], shape (s,).
        family: SpringFamily of each, shape (s,).
    """

    pairs: Ints
    rest_length: Floats
    stiffness: Floats
    family: Ints

    def __len__(self) -> int:
        return len(self.pairs)

    def renumbered(self, number: Ints) -> Springs:
        """The springs between renumbered (sewn) particles; parallel springs are combined exactly.

        Two springs between the same particles act as one: k = k1 + k2, L0 = (k1 L1 + k2 L2) / k.
        """
        return _combined(np.asarray(number[self.pairs], dtype=np.int32), self.rest_length, self.stiffness, self.family)

    def runs(self, soft_stiffness: Floats) -> MixedRuns:
        """The springs as runs whose stiffness is a mixture of soft_stiffness (s,) [N/m] and their own, without those
        that have none.
        """
        acts = (soft_stiffness > 0.0) | (self.stiffness > 0.0)
        values = np.stack([self.rest_length, soft_stiffness, self.stiffness], axis=1)
        return MixedRuns(find_runs(self.pairs[acts], values[acts]))


@dataclass(frozen=True)
class MixedRuns:
    """Runs with the values (L0 [m], soft k [N/m], k [N/m])."""

    all: Runs

    def mixed(self, softness: float) -> Runs:
        """The runs with the values (L0, soft k + softness * (k - soft k))."""
        first, length, value, rest, rest_value = self.all
        return Runs(first, length, _mixture(value, softness), rest, _mixture(rest_value, softness))


def _mixture(value: Floats, softness: float) -> Floats:
    soft, full = value[:, 1], value[:, 2]
    stiffness = full if softness == 1.0 else soft + softness * (full - soft)
    return np.ascontiguousarray(np.stack([value[:, 0], stiffness], axis=1))


def build_springs(garment: Garment, fabric: Fabric) -> Springs:
    """Connect springs to particles and record their rest lengths, for the panels before they are sewn.

    Structural and shear stiffness [N/m] of the grid do not depend on the spacing: a square cell has one structural
    spring per side (half of it from each cell) and both diagonals, which makes the membrane stiffness
    C11 = k_structural + k_shear and C12 = G = k_shear. Springs on the outline have half a cell and half the stiffness.

    Diagonals have the stiffness of the fabric's `shear_spring`; none if it resists shear as a trellis alone. They are
    listed all the same: their strain is what a report says of shear.
    """
    rest = garment.rest
    a, b, c, d = garment.quads.T
    width = rest[b, 0] - rest[a, 0]
    height = rest[d, 1] - rest[a, 1]
    shear = fabric.shear + fabric.shear_spring
    diagonal = trellis_stiffness(garment, shear)
    pairs = [
        np.stack([a, b], 1),
        np.stack([d, c], 1),
        np.stack([a, d], 1),
        np.stack([b, c], 1),
        np.stack([a, c], 1),
        np.stack([b, d], 1),
    ]
    weft, warp = fabric.structural_weft * height / width / 2.0, fabric.structural_warp * width / height / 2.0
    stiffness = [weft, weft, warp, warp, diagonal, diagonal]
    family = [np.full(len(a), f, dtype=np.int8) for f in (0, 0, 0, 0, 1, 1)]

    band = garment.triangles[~garment.in_quad]
    area = garment.areas[~garment.in_quad]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        side = rest[band[:, j]] - rest[band[:, i]]
        squared = (side**2).sum(axis=1)
        along_weft = side[:, 0] ** 2 / squared
        # cos^2 and sin^2 of twice the angle to the weft: 1 and 0 on the grid lines, 0 and 1 on the diagonals.
        diagonality = 4.0 * along_weft * (1.0 - along_weft)
        structural = fabric.structural_weft * along_weft + fabric.structural_warp * (1.0 - along_weft)
        pairs.append(band[:, [i, j]])
        # One diagonal of a triangulated cell stands for the two of the grid; its area is half of its length squared.
        stiffness.append(area / squared * (structural * (1.0 - diagonality) + 4.0 * shear * diagonality))
        family.append(np.where(diagonality > 0.5, SpringFamily.SHEAR, SpringFamily.STRUCTURAL).astype(np.int8))

    if fabric.bending_spring > 0.0:
        straight = np.concatenate([garment.rows[:, [0, 2]], garment.columns[:, [0, 2]]])
        opposite = _opposite_corners(garment)
        for extra in (straight, opposite):
            pairs.append(extra)
            stiffness.append(np.full(len(extra), fabric.bending_spring))
            family.append(np.full(len(extra), SpringFamily.BENDING, dtype=np.int8))

    all_pairs = np.concatenate(pairs).astype(np.int32, copy=False)
    all_stiffness, all_families = np.concatenate(stiffness), np.concatenate(family)
    del pairs, stiffness, family  # this is where a model takes most memory
    length = np.linalg.norm(rest[all_pairs[:, 0]] - rest[all_pairs[:, 1]], axis=1)
    # In the order in which they were put together: lattice, band, bending.
    lattice, band_end = 6 * len(garment.quads), 6 * len(garment.quads) + 3 * len(band)
    all_stiffness[lattice:band_end] *= _band_shares(garment, all_pairs[:band_end], all_stiffness[:band_end], lattice)
    if fabric.shear > 0.0:
        all_stiffness[4 * len(garment.quads) : lattice] *= fabric.shear_spring / shear
    return _combined(all_pairs, length, all_stiffness, all_families)


def _band_shares(garment: Garment, pairs: Ints, stiffness: Floats, lattice: int) -> Floats:
    """Share of its stiffness that each spring of the band between lattice and outline keeps, (s - lattice,).

    Some particles there are light and some springs short: with all of their stiffness a few of them would swing twice
    as fast as any other and set the time step for all. So the band's springs are softened until no particle, held by
    its neighbours, is stiffer for its mass than one of the lattice. A tension that stretches the lattice by 1 % then
    moves the outline by hundredths of a cell; the finer the mesh, the less.

    Args:
        garment: the garment.
        pairs, stiffness: structural and shear springs, (s, 2) and (s,) [N/m]; the first `lattice` of them are the
            lattice's.
    """
    held_by_lattice = _stiffest(garment, pairs[:lattice], stiffness[:lattice])
    held_by_band = _stiffest(garment, pairs[lattice:], stiffness[lattice:])
    area = garment.particle_areas
    # The corner of a lattice is stiffer for its mass than its inside, by its one diagonal.
    whole = np.bincount(garment.quads.ravel(), minlength=len(area)) > 0
    whole &= held_by_band == 0.0
    if whole.any():
        most = float((held_by_lattice[whole] / area[whole]).max())
    else:  # there is nothing but band: like equilateral triangles of the spacing
        most = float(np.median(held_by_band / area))
    room = most * area - held_by_lattice
    share = np.divide(room, held_by_band, out=np.ones_like(room), where=(room < held_by_band) & (held_by_band > 0.0))
    share = np.maximum(share, _LEAST_SHARE)
    return np.asarray(share[pairs[lattice:]].min(axis=1))


def _stiffest(garment: Garment, pairs: Ints, stiffness: Floats) -> Floats:
    """Largest stiffness [N/m] in any direction of the rest shape with which springs hold each particle, (n,)."""
    way = garment.rest[pairs[:, 1]] - garment.rest[pairs[:, 0]]
    along = stiffness / (way**2).sum(axis=1)
    xx, xy, yy = (
        np.bincount(pairs.ravel(), weights=np.repeat(along * part, 2), minlength=garment.particle_count)
        for part in (way[:, 0] ** 2, way[:, 0] * way[:, 1], way[:, 1] ** 2)
    )
    return np.asarray(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))


def _opposite_corners(garment: Garment) -> Ints:
    """Opposite corners of each two triangles of a panel of which at least one is no half of a cell, shape (k, 2)."""
    from cloth_core.bending import hinges

    hinge, sides = hinges(garment.triangles)
    in_band = ~garment.in_quad[sides].all(axis=1)
    return np.asarray(hinge[in_band][:, 2:], dtype=np.int32)


def _combined(pairs: Ints, length: Floats, stiffness: Floats, family: NDArray[np.integer]) -> Springs:
    # Sorted by the lower particle, then by the other one; a bending spring stays one, whatever it lies beside.
    count = int(pairs.max(initial=0)) + 1
    key = pairs.min(axis=1).astype(np.int64)
    key *= count
    key += pairs.max(axis=1)
    key *= 2
    key += np.asarray(family) == SpringFamily.BENDING
    key, inverse = np.unique(key, return_inverse=True)
    k = np.bincount(inverse, weights=stiffness, minlength=len(key)).astype(np.float64)
    weighted = np.bincount(inverse, weights=stiffness * length, minlength=len(key))
    plain = np.bincount(inverse, weights=length, minlength=len(key)) / np.bincount(inverse, minlength=len(key))
    with np.errstate(invalid="ignore", divide="ignore"):
        rest_length = np.where(k > 0.0, weighted / k, plain)
    kind = np.zeros(len(key), dtype=np.int32)
    np.maximum.at(kind, inverse, np.asarray(family, dtype=np.int32))
    ends = np.stack(np.divmod(key // 2, count), axis=1)
    return Springs(np.ascontiguousarray(ends, dtype=np.int32), rest_length, k, kind)


@borrowing_kernel
def spring_forces(x: Floats, v: Floats, springs: Runs, damping_time: float, force: Floats) -> None:
    """Add F = k (1 - L0 / |d|) d and the damping k tau (dv . d / |d|) d / |d| to both ends (paper, section III).

    Shapes: x, v, force (3, n) [m, m/s, N]; springs with the values (L0 [m], k [N/m]); damping_time tau [s].
    Coincident ends have no direction and exert nothing.
    """
    px, py, pz = x[0], x[1], x[2]
    vx, vy, vz = v[0], v[1], v[2]
    fx, fy, fz = force[0], force[1], force[2]
    one, tau, none = fill(1.0), fill(damping_time), fill(0.0)
    for r in range(springs.length.shape[0]):
        i, j, n = springs.first[r, 0], springs.first[r, 1], springs.length[r]
        minus_rest_length, stiffness = fill(-springs.value[r, 0]), fill(springs.value[r, 1])
        # What has just been stored is slow to load again at a place shifted by less than a register.
        in_row = 1 <= j - i <= 2
        lx, ly, lz = none, none, none
        for block in range(0, n, LANES):
            # The last block ends with the run; what it has in common with the one before is not added again.
            s = min(block, n - LANES)
            a, b = i + s, j + s
            dx, dy, dz = load(px, b) - load(px, a), load(py, b) - load(py, a), load(pz, b) - load(pz, a)
            inverse = inverse_root(fused(dx, dx, fused(dy, dy, dz * dz)), _COINCIDENT)
            stretch = fused(minus_rest_length, inverse, one)
            if damping_time > 0.0:
                du, dv, dw = load(vx, b) - load(vx, a), load(vy, b) - load(vy, a), load(vz, b) - load(vz, a)
                rate = fused(dx, du, fused(dy, dv, dz * dw))
                stretch = fused(tau * rate * inverse, inverse, stretch)
            factor = stiffness * stretch
            if in_row:
                # Along a row each particle gets the force of the spring behind it and that of the one before.
                dx, dy, dz = factor * dx, factor * dy, factor * dz
                fresh = LANES - (block - s)
                if j - i == 1:
                    bx, by, bz = together(lx, dx, 1), together(ly, dy, 1), together(lz, dz, 1)
                else:
                    if block - s == 1:  # what has been done ends with the first lane, not before it
                        lx, ly, lz = together(none, lx, 1), together(none, ly, 1), together(none, lz, 1)
                    bx, by, bz = together(lx, dx, 2), together(ly, dy, 2), together(lz, dz, 2)
                add_to(fx, a, last_lanes(dx - bx, fresh))
                add_to(fy, a, last_lanes(dy - by, fresh))
                add_to(fz, a, last_lanes(dz - bz, fresh))
                lx, ly, lz = dx, dy, dz
                continue
            if s < block:
                factor = last_lanes(factor, LANES - (block - s))
            dx, dy, dz = factor * dx, factor * dy, factor * dz
            add_to(fx, a, dx)
            add_to(fy, a, dy)
            add_to(fz, a, dz)
            take_from(fx, b, dx)
            take_from(fy, b, dy)
            take_from(fz, b, dz)
        for back in range(j - i if in_row else 0):
            fx[j + n - 1 - back] -= last_lane(lx, back)
            fy[j + n - 1 - back] -= last_lane(ly, back)
            fz[j + n - 1 - back] -= last_lane(lz, back)
    for s in range(springs.rest.shape[0]):
        i, j = np.uintp(springs.rest[s, 0]), np.uintp(springs.rest[s, 1])
        dx, dy, dz = px[j] - px[i], py[j] - py[i], pz[j] - pz[i]
        rate = dx * (vx[j] - vx[i]) + dy * (vy[j] - vy[i]) + dz * (vz[j] - vz[i])
        inverse = 1.0 / np.sqrt(max(dx * dx + dy * dy + dz * dz, _COINCIDENT))
        stretch = 1.0 - springs.rest_value[s, 0] * inverse + damping_time * rate * inverse * inverse
        factor = springs.rest_value[s, 1] * stretch
        dx, dy, dz = factor * dx, factor * dy, factor * dz
        fx[i] += dx
        fy[i] += dy
        fz[i] += dz
        fx[j] -= dx
        fy[j] -= dy
        fz[j] -= dz


def spring_strains(x: Floats, springs: Springs) -> Floats:
    """(L - L0) / L0 of each spring, shape (s,); positions x (n, 3) [m]."""
    length = np.linalg.norm(x[springs.pairs[:, 0]] - x[springs.pairs[:, 1]], axis=1)
    return np.asarray((length - springs.rest_length) / np.maximum(springs.rest_length, 1e-12), dtype=np.float64)
