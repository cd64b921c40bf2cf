"""Contact of cloth with a body: nothing can pass through, at any speed and time step.

*Search* (rarely): the double traversal of the AABB trees finds every vertex-triangle and edge-edge pair within reach,
and from their distances a bound on how far each particle may travel before the next search: less than its distance to
whatever it could hit, so that it cannot have crossed (the displacement bound of offset geometric contact, Chen et al.
2025).

*Response* (each step): a contact holds its parts apart by removing the approaching velocity, with Coulomb friction
bounded by the same impulse (Moreau's time stepping). There is no contact stiffness: the stable time step does not
depend on contact, what rests stays at rest exactly, and nothing is ever pulled towards anything.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree, refit_tree
from cloth_core.body_contact import BodyContact, VertexPlanes, hold_vertices
from cloth_core.kernel import kernel
from cloth_core.mesh_topology import representatives
from cloth_core.pair_contacts import PairContacts, hold_pairs, repeat_impulses

__all__ = ["Contact", "ContactSettings", "ContactState", "keep_within_travel", "resolve_contacts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class ContactState(NamedTuple):
    """What one search found.

    Attributes:
        origin: positions at the search [m], (n, 3).
        travel: how far each particle may move from there [m], (n,).
        planes: cloth vertices against body triangles.
        pairs: everything else.
    """

    origin: Floats
    travel: Floats
    planes: VertexPlanes
    pairs: PairContacts

    @classmethod
    def none(cls) -> ContactState:
        """State of a scene in which nothing can collide."""
        return cls(np.zeros((0, 3)), np.zeros(0), VertexPlanes.of(0, np.zeros((0, 2), np.int32)), PairContacts.none())


class ContactSettings(NamedTuple):
    """Constants of the contact term.

    Attributes:
        active: whether there is anything to collide with.
        body_vertices (b, 3) [m], body_velocity (b, 3) [m/s], body_triangles (t, 3): empty without a body.
        offset: distance of cloth vertices from the body [m].
        friction: Coulomb coefficient; push_speed: fastest way out for what is too near [m/s].
    """

    active: bool
    body_vertices: Floats
    body_velocity: Floats
    body_triangles: Ints
    offset: float
    friction: float
    push_speed: float


class Contact:
    """Search for all contacts of a garment. (Cloth against cloth will be a second search beside the body's.)

    Args:
        triangles: the cloth's, shape (m, 3).
        body: what it meets.
    """

    def __init__(self, triangles: Ints, body: BodyContact) -> None:
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self.body = body
        self._representatives = representatives(self.triangles)
        self._tree: AabbTree | None = None

    def search(self, x: Floats, reach: float | Floats) -> ContactState:
        """Find all pairs that can come into contact while no particle moves farther than its reach.

        Args:
            x: positions [m], shape (n, 3).
            reach: [m], for all particles or for each, shape (n,).
        """
        reach = np.ascontiguousarray(np.broadcast_to(reach, len(x)), dtype=np.float64)
        if self._tree is None:
            self._tree = build_tree(x, self.triangles)
        refit_tree(self._tree, x, self.triangles, self.body.offset + reach)
        planes, rows, distance, travel = self.body.search(x, self.triangles, self._representatives, self._tree, reach)
        pairs = PairContacts.of(
            np.ascontiguousarray(rows[:, 0]),
            np.ascontiguousarray(rows[:, 1:4]),
            np.ascontiguousarray(rows[:, 4:6]),
            np.full(len(rows), self.body.side_offset),
            distance,
        )
        return ContactState(x.copy(), travel, planes, pairs)


@kernel
def keep_within_travel(x: Floats, state: ContactState, moved: Floats) -> bool:
    """Stop every particle at its travel bound; fill moved (n,) [m]; whether any has used most of its bound."""
    spent = False
    for i in range(x.shape[0]):
        dx = x[i, 0] - state.origin[i, 0]
        dy = x[i, 1] - state.origin[i, 1]
        dz = x[i, 2] - state.origin[i, 2]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        bound = state.travel[i]
        if distance > 0.8 * bound:
            spent = True
            if distance > bound:
                share = bound / distance
                x[i, 0] = state.origin[i, 0] + share * dx
                x[i, 1] = state.origin[i, 1] + share * dy
                x[i, 2] = state.origin[i, 2] + share * dz
                distance = bound
        moved[i] = distance
    return spent


@kernel
def resolve_contacts(
    x: Floats, v: Floats, inverse_mass: Floats, state: ContactState, settings: ContactSettings, dt: float, moved: Floats
) -> bool:
    """Hold everything apart after a step, in place; whether a new search is due.

    Shapes: x, v (n, 3) [m, m/s]; inverse_mass (n,) [1/kg]; moved (n,) scratch; dt [s].
    """
    repeat_impulses(x, v, inverse_mass, state.pairs, dt)
    spent = keep_within_travel(x, state, moved)
    hold_vertices(
        x, v, inverse_mass, state.planes, settings.body_vertices, settings.body_velocity, settings.body_triangles,
        settings.offset, settings.friction, settings.push_speed, dt,
    )  # fmt: skip
    hold_pairs(
        x, v, inverse_mass, state.pairs, settings.body_vertices, settings.body_velocity, settings.friction,
        settings.push_speed, dt, moved,
    )  # fmt: skip
    return spent
