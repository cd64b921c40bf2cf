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
from cloth_core.kernel import kernel
from cloth_core.unique_rows import unique_rows

__all__ = ["SpringFamily", "Springs", "build_springs", "spring_forces", "spring_strains"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


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


def build_springs(garment: Garment, fabric: Fabric) -> Springs:
    """Connect springs to particles and record their rest lengths, for the panels before they are sewn.

    Structural and shear stiffness [N/m] of the grid do not depend on the spacing: a square cell has one structural
    spring per side (half of it from each cell) and both diagonals, which makes the membrane stiffness
    C11 = k_structural + k_shear and C12 = G = k_shear. Springs on the outline have half a cell and half the stiffness.
    """
    rest = garment.rest
    a, b, c, d = garment.quads.T
    width = rest[b, 0] - rest[a, 0]
    height = rest[d, 1] - rest[a, 1]
    diagonal = fabric.shear * 2.0 * width * height / (width**2 + height**2)
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
    family = [np.full(len(a), f) for f in (0, 0, 0, 0, 1, 1)]

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
        stiffness.append(area / squared * (structural * (1.0 - diagonality) + 4.0 * fabric.shear * diagonality))
        family.append(np.where(diagonality > 0.5, SpringFamily.SHEAR, SpringFamily.STRUCTURAL))

    if fabric.bending_spring > 0.0:
        straight = np.concatenate([garment.rows[:, [0, 2]], garment.columns[:, [0, 2]]])
        opposite = _opposite_corners(garment)
        for extra in (straight, opposite):
            pairs.append(extra)
            stiffness.append(np.full(len(extra), fabric.bending_spring))
            family.append(np.full(len(extra), SpringFamily.BENDING))

    all_pairs = np.concatenate(pairs).astype(np.int32)
    length = np.linalg.norm(rest[all_pairs[:, 0]] - rest[all_pairs[:, 1]], axis=1)
    return _combined(all_pairs, length, np.concatenate(stiffness), np.concatenate(family))


def _opposite_corners(garment: Garment) -> Ints:
    """Opposite corners of each two triangles of a panel of which at least one is no half of a cell, shape (k, 2)."""
    from cloth_core.bending import hinges

    hinge, sides = hinges(garment.triangles)
    in_band = ~garment.in_quad[sides].all(axis=1)
    return np.asarray(hinge[in_band][:, 2:], dtype=np.int32)


def _combined(pairs: Ints, length: Floats, stiffness: Floats, family: NDArray[np.integer]) -> Springs:
    ordered = np.sort(pairs, axis=1)
    bending = np.asarray(family) == SpringFamily.BENDING  # a bending spring stays one, whatever it lies beside
    key, _, inverse, _ = unique_rows(np.column_stack([ordered, bending]))
    k = np.bincount(inverse, weights=stiffness, minlength=len(key)).astype(np.float64)
    weighted = np.bincount(inverse, weights=stiffness * length, minlength=len(key))
    plain = np.bincount(inverse, weights=length, minlength=len(key)) / np.bincount(inverse, minlength=len(key))
    with np.errstate(invalid="ignore", divide="ignore"):
        rest_length = np.where(k > 0.0, weighted / k, plain)
    kind = np.zeros(len(key), dtype=np.int32)
    np.maximum.at(kind, inverse, np.asarray(family, dtype=np.int32))
    return Springs(np.ascontiguousarray(key[:, :2], dtype=np.int32), rest_length, k, kind)


@kernel
def spring_forces(
    x: Floats, v: Floats, pairs: Ints, rest_length: Floats, stiffness: Floats, damping_time: float, force: Floats
) -> None:
    """Add F = k (1 - L0 / |d|) d and the damping k tau (dv . d / |d|) d / |d| to both ends (paper, section III).

    Shapes: x, v, force (n, 3) [m, m/s, N]; pairs (s, 2); rest_length, stiffness (s,); damping_time tau [s].
    Coincident ends have no direction and exert nothing.
    """
    for s in range(pairs.shape[0]):
        i, j = pairs[s, 0], pairs[s, 1]
        dx = x[j, 0] - x[i, 0]
        dy = x[j, 1] - x[i, 1]
        dz = x[j, 2] - x[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        if squared < 1e-24:
            continue
        rate = dx * (v[j, 0] - v[i, 0]) + dy * (v[j, 1] - v[i, 1]) + dz * (v[j, 2] - v[i, 2])
        factor = stiffness[s] * (1.0 - rest_length[s] / np.sqrt(squared) + damping_time * rate / squared)
        fx, fy, fz = factor * dx, factor * dy, factor * dz
        force[i, 0] += fx
        force[i, 1] += fy
        force[i, 2] += fz
        force[j, 0] -= fx
        force[j, 1] -= fy
        force[j, 2] -= fz


def spring_strains(x: Floats, springs: Springs) -> Floats:
    """(L - L0) / L0 of each spring, shape (s,); positions x (n, 3) [m]."""
    length = np.linalg.norm(x[springs.pairs[:, 0]] - x[springs.pairs[:, 1]], axis=1)
    return np.asarray((length - springs.rest_length) / np.maximum(springs.rest_length, 1e-12), dtype=np.float64)
