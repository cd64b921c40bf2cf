"""What a search for contacts finds and the steps go by: arrays for the compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.body_contact import VertexPlanes
from cloth_core.near_planes import NearPlanes
from cloth_core.pair_contacts import PairContacts

__all__ = ["ContactSettings", "ContactState", "Renewal"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class Renewal(NamedTuple):
    """What a renewal needs to know of the last broad phase, and of how particles want to go.

    Attributes:
        broad_x: positions at the broad phase [m], (n, 3); radii: how far each may move from there [m], (n,).
        radius: the largest of them [m].
        way: of each particle's origin from broad_x, that of the body included [m], (n,); way_of_body: since then [m].
        start, entries: the pairs of particle i are entries[start[i] : start[i + 1]].
        place: of each pair in the list of those that count, -1 for the others, (s,).
        waiting: room for the particles that are to be renewed, (n,); closest: for a vector, (3,).
        turn: number of the present renewal, (1,); renewed: of that in which each particle was renewed last, (n,).
        steps, least_reach: a particle wants to go as far as in so many steps, but at least so far [m].
        least_room: a particle whose speed takes it farther than this in a step needs shorter steps [m].
        allowed: whether single particles may be renewed.
    """

    broad_x: Floats
    radii: Floats
    radius: float
    way: Floats
    way_of_body: float
    start: Ints
    entries: Ints
    place: Ints
    waiting: Ints
    closest: Floats
    turn: Ints
    renewed: Ints
    steps: float
    least_reach: float
    least_room: float
    allowed: bool

    @classmethod
    def none(cls) -> Renewal:
        """For a scene in which nothing can collide."""
        floats, ints = np.zeros(0), np.zeros(0, dtype=np.int32)
        return cls(
            np.zeros((0, 3)), floats, 0.0, floats, 0.0, ints, ints, ints, ints, floats, ints, ints, 0.0, 0.0, 0.0, False
        )


class ContactState(NamedTuple):
    """What one narrow phase found.

    Attributes:
        origin: positions at the narrow phase [m], (3, n).
        travel: how far each particle may move from there [m], (n,).
        planes: cloth vertices against body triangles.
        pairs: everything else.
        near: what bounds the direction of particles that nearly touch something.
        renewal: what it takes to renew origin and travel of single particles.
    """

    origin: Floats
    travel: Floats
    planes: VertexPlanes
    pairs: PairContacts
    near: NearPlanes
    renewal: Renewal

    @classmethod
    def none(cls) -> ContactState:
        """State of a scene in which nothing can collide."""
        return cls(
            np.zeros((3, 0)), np.zeros(0), VertexPlanes.none(0), PairContacts.none(), NearPlanes.none(), Renewal.none()
        )


class ContactSettings(NamedTuple):
    """Constants of the contact term.

    Attributes:
        active: whether there is anything to collide with.
        body_vertices (b, 3) [m], body_velocity (b, 3) [m/s], body_triangles (t, 3): empty without a body.
        body_way: how far a vertex of the body may go in steps that are done at once [m]; 0 while it stands, and then
            body_vertices are never written to.
        offset: distance of cloth vertices from the body [m].
        friction: Coulomb coefficient; push_speed: fastest way out for what is too near [m/s].
    """

    active: bool
    body_vertices: Floats
    body_velocity: Floats
    body_triangles: Ints
    body_way: float
    offset: float
    friction: float
    push_speed: float
