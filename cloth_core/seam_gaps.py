"""Open seams in the eyes of self contact: which points have met, and the gaps between, which keep cloth out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Garment, Seam, merged_numbers
from cloth_core.intersections import self_crossing_pairs
from cloth_core.mesh_topology import point_neighbours
from cloth_core.pair_contacts import CLOTH_SIDE, CLOTH_VERTEX

__all__ = ["ClosingSeams", "seam_gap_triangles"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]


class ClosingSeams:
    """Which points of a garment's open seams count as one by now; what has met stays together.

    Points whose surroundings cross each other at the start, where nothing could keep them apart, have met as well.

    Args:
        garment: at its start.
        triangles: its triangles, in the numbering of its particles, (m, 3).
        distance: at which points meet [m].

    Attributes:
        triangles: as given.
        gaps: triangles that fill the seams, (k, 3).
        gap_seam: number of the seam that each of them fills, (k,).
        number: of the point that each particle counts as, (n,).
        neighbours: of these points, see `point_neighbours`.
    """

    def __init__(self, garment: Garment, triangles: Ints, distance: float) -> None:
        self.triangles = triangles
        filled = [seam_gap_triangles((seam,)) for seam in garment.seams]
        self.gaps = np.concatenate(filled)
        self.gap_seam = np.repeat(np.arange(len(filled)), [len(gaps) for gaps in filled])
        self._distance = distance
        self._first = np.concatenate([seam.first for seam in garment.seams])
        self._second = np.concatenate([seam.second for seam in garment.seams])
        self.number = np.arange(garment.particle_count, dtype=np.int32)
        self._met = self._near(garment.start)
        self._renumber()
        edges, pairs = self_crossing_pairs(garment.start, triangles, self.number)
        sewn = garment.merged_indices
        ends, corners = sewn[edges[pairs[:, 0]]], sewn[triangles[pairs[:, 1]]]
        shared = ends[(ends[:, :, None] == corners[:, None]).any(axis=2)]
        if len(shared):
            self._met |= np.isin(sewn[self._first], shared)
            self._renumber()

    def look(self, x: Floats) -> None:
        """Let those meet that are near each other at x (n, 3) [m]."""
        near = self._near(x)
        if (near & ~self._met).any():
            self._met |= near
            self._renumber()

    def number_at(self, x: Floats) -> Ints:
        """What `number` would be after a look at x (n, 3) [m]."""
        return self._numbers(self._met | self._near(x))

    def free_gaps(self, x: Floats, touching: Ints) -> Bools:
        """Which of the gaps have nothing to do with cloth at x (n, 3) [m]: what is crossed cannot be kept apart, (k,).

        touching: pairs of contact that are nearer than they are kept, rows (s, 7) of kind and particles.
        """
        cloth, gaps = self.triangles, self.gaps
        edges, pairs = self_crossing_pairs(x, np.concatenate([cloth, gaps]), self.number)
        side, triangle = _keys(edges[pairs[:, 0]], len(x)), pairs[:, 1]
        cloth_sides = _side_keys(cloth, len(x)).ravel()
        of_cloth, through_cloth = np.isin(side, cloth_sides), triangle < len(cloth)
        bad = np.zeros(len(gaps), dtype=np.bool_)
        bad[triangle[of_cloth & ~through_cloth] - len(cloth)] = True
        one, other = (_keys(touching[touching[:, 0] == CLOTH_SIDE, k : k + 2], len(x)) for k in (1, 3))
        near = np.isin(one, cloth_sides) != np.isin(other, cloth_sides)
        bad_sides = np.concatenate([side[~of_cloth & through_cloth], one[near], other[near]])
        bad |= np.isin(_side_keys(gaps, len(x)), bad_sides[~np.isin(bad_sides, cloth_sides)]).any(axis=1)
        bad |= np.isin(_keys(gaps, len(x)), _keys(touching[touching[:, 0] == CLOTH_VERTEX, 2:5], len(x)))
        return np.asarray(~bad)

    def _near(self, x: Floats) -> Bools:
        return np.asarray(np.linalg.norm(x[self._first] - x[self._second], axis=1) < self._distance)

    def _numbers(self, met: Bools) -> Ints:
        return merged_numbers(len(self.number), (Seam("", self._first[met], self._second[met]),))

    def _renumber(self) -> None:
        self.number = self._numbers(self._met)
        self.neighbours = point_neighbours(self.number[self.triangles])


def seam_gap_triangles(seams: Sequence[Seam]) -> Ints:
    """Triangles that fill the gap between the two edges of each open seam, in the unsewn numbering, shape (k, 3)."""
    parts = [np.zeros((0, 3), dtype=np.int32)]
    for seam in seams:
        a, b, c, d = seam.first[:-1], seam.first[1:], seam.second[1:], seam.second[:-1]
        parts += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    triangles = np.concatenate(parts)
    p, q, r = triangles.T
    return np.asarray(triangles[(p != q) & (q != r) & (r != p)], dtype=np.int32)


def _side_keys(triangles: Ints, count: int) -> NDArray[np.int64]:
    """Keys of the three sides of each triangle, (m, 3)."""
    return np.stack([_keys(triangles[:, [k, (k + 1) % 3]], count) for k in range(3)], axis=1)


def _keys(corners: Ints, count: int) -> NDArray[np.int64]:
    """One number for each set of corners, (k, 2) or (k, 3), of a mesh with so many vertices."""
    key = np.zeros(len(corners), dtype=np.int64)
    for column in np.sort(corners, axis=1).T:
        key = key * count + column
    return key
