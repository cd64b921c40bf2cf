"""Broad phase: all pairs that can come into contact while no particle goes farther than its radius from its place.

Each particle has a place and a radius: what moves fast gets a large one and what hardly moves a small one, so that all
are used up at about the same time. Pairs are searched anew when a particle has used up most of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree, refit_tree
from cloth_core.body_contact import BodyContact, VertexPlanes
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.mesh_topology import representatives
from cloth_core.pair_contacts import PairContacts
from cloth_core.self_contact import SelfContact
from cloth_core.travel_renewal import enough_of_radius, pairs_of_particles

__all__ = ["BroadPhase"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# How far a particle may go that does not move at all [m].
_LEAST_RADIUS = 0.002
# The radius becomes this much larger from one search to the next while they find fewer pairs than this for each
# particle, up to so many times, and smaller again when they find more than that.
_WIDEN, _WIDEST = 1.5, 4.0
_FEW_PAIRS, _MANY_PAIRS = 0.25, 1.0
# What is next to something fast will soon be fast itself: over so many triangles.
_AHEAD = 2


class BroadPhase:
    """The pairs of a garment that can come into contact for a while, kept as long as they will do.

    Args:
        triangles: the cloth's, shape (m, 3).
        body: what it meets, or None.
        cloth: contact with itself, or None where that cannot happen.
        radius: how far particles may move at most between two searches [m].
        farthest: the same for those that have nothing near them but what is left out of the search [m].

    Attributes:
        x: place of each particle [m], (n, 3); radii: how far from there it may go [m], (n,).
        planes, pairs: what was found: vertices near triangles of the body, and everything else.
        start, entries: the pairs of particle i are entries[start[i] : start[i + 1]].
        alone: particles that are near nothing, (n,).
        searches: how many there were.
    """

    def __init__(
        self, triangles: Ints, body: BodyContact | None, cloth: SelfContact | None, radius: float, farthest: float
    ) -> None:
        self.triangles = triangles
        self.body = body
        self.cloth = cloth
        self.radius = radius
        self.farthest = farthest
        self.searches = 0
        self._representatives = representatives(triangles)
        self._tree: AabbTree | None = None
        self._body_x: Floats | None = None
        self._wider = 1.0
        self.forget()
        self.pairs = PairContacts.none()

    def forget(self) -> None:
        """Let everything be searched the next time."""
        self.x = np.zeros((0, 3))
        self.radii = np.zeros(0)

    def at(self, x: Floats, wanted: Floats) -> tuple[bool, Floats, Floats, float]:
        """Search what has to be searched at x (n, 3) [m], where particles want to go so far from there [m], (n,).

        Returns:
            whether anything was searched; how far each particle is from its place, with how far the body has moved
            since, and what is left of its radius, (n,) [m]; how far the body has moved [m].
        """
        if len(self.x) == len(x):
            way_of_body = self._way_of_body()
            short, moved, left = _left_of_radius(x, self.x, self.radii, way_of_body, wanted, self.radius)
            if not short:
                return False, moved, left, way_of_body
        self._search(x, wanted)
        return True, np.zeros(len(x)), self.radii, 0.0

    def _search(self, x: Floats, wanted: Floats) -> None:
        self.searches += 1
        # In proportion to how fast each moves, so that all are used up at about the same time.
        least = min(_LEAST_RADIUS, self.radius)
        radius = min(self._wider * self.radius, max(self.farthest, self.radius))
        largest = radius if self.cloth is None else self.cloth.largest_radii(x, radius, self.farthest)
        if self.cloth is None:  # beside contact of cloth with cloth the lists grow by what the searches save
            wanted = _largest_around(wanted, self.triangles, _AHEAD)
        self.radii = np.asarray(least + (largest - least) * (wanted / wanted.max()))
        self.x = x.copy()
        self.planes = VertexPlanes.none(len(x))
        parts: list[tuple[Ints, Floats, Floats]] = []
        if self.body is not None:
            if self._tree is None:
                self._tree = build_tree(x, self.triangles)
            refit_tree(self._tree, x, self.triangles, self.body.offset + self.radii)
            self.planes, of_body, offset, distance = self.body.candidates(
                x, self.triangles, self._representatives, self._tree, self.radii
            )
            parts.append((of_body, offset, distance))
            self._body_x = self.body.body.vertices
        if self.cloth is not None:
            parts.append(self.cloth.candidates(x, self.radii))
        pairs = PairContacts.none()
        if parts:
            rows, offset, distance = (np.concatenate(column) for column in zip(*parts, strict=True))
            pairs = PairContacts.of(rows, offset, distance)
        self.start, self.entries = pairs_of_particles(pairs.particles, len(x))
        # What is near nothing lengthens no list by how far it may go.
        self.alone = (np.diff(self.planes.start) == 0) & (np.diff(self.start) == 0)
        pairs.remember(self.pairs, self.start, self.entries)
        self.pairs = pairs
        found = len(pairs.kind)
        if found < _FEW_PAIRS * len(x):
            self._wider = min(self._wider * _WIDEN, _WIDEST)
        elif found > _MANY_PAIRS * len(x):
            self._wider = max(self._wider / _WIDEN, 1.0)

    def _way_of_body(self) -> float:
        """Farthest that any vertex of the body has moved since the search [m]."""
        if self.body is None or self._body_x is None or self.body.body.vertices is self._body_x:
            return 0.0
        return _farthest_way(self._body_x, self.body.body.vertices)


@borrowing_kernel
def _farthest_way(before: Floats, now: Floats) -> float:
    """Largest distance between rows of (b, 3) [m]."""
    largest = 0.0
    for i in range(now.shape[0]):
        dx, dy, dz = now[i, 0] - before[i, 0], now[i, 1] - before[i, 1], now[i, 2] - before[i, 2]
        largest = max(largest, dx * dx + dy * dy + dz * dz)
    return float(np.sqrt(largest))


@kernel
def _left_of_radius(
    x: Floats, place: Floats, radii: Floats, way_of_body: float, wanted: Floats, radius: float
) -> tuple[bool, Floats, Floats]:
    """Whether any particle has too little left of its radius [m]; how far each has moved from its place.

    Shapes: x, place (n, 3), radii, wanted (n,) [m]; radius is the largest one. Returns also moved and left (n,) [m].
    """
    moved, left = np.empty_like(radii), np.empty_like(radii)
    short = 0
    for i in range(radii.shape[0]):
        dx, dy, dz = x[i, 0] - place[i, 0], x[i, 1] - place[i, 1], x[i, 2] - place[i, 2]
        moved[i] = np.sqrt(dx * dx + dy * dy + dz * dz) + way_of_body
        left[i] = radii[i] - moved[i]
        short += not enough_of_radius(left[i], wanted[i], radius)
    return short > 0, moved, left


@kernel
def _largest_around(values: Floats, triangles: Ints, rings: int) -> Floats:
    """For each particle the largest value (n,) within so many triangles (m, 3) of it, (n,)."""
    for _ in range(rings):
        grown = values.copy()
        for t in range(triangles.shape[0]):
            largest = max(values[triangles[t, 0]], max(values[triangles[t, 1]], values[triangles[t, 2]]))
            for k in range(3):
                grown[triangles[t, k]] = max(grown[triangles[t, k]], largest)
        values = grown
    return values
