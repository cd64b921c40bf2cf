"""Contact of cloth with a body and with itself: nothing can pass through, at any speed and time step.

*Broad phase* (rarely): traversals of the AABB trees find every vertex-triangle and edge-edge pair that can come into
contact while no particle moves farther than its radius (`cloth_core.broad_phase`). It is repeated when one has
used up most of its own.

*Narrow phase* (more often): the distances of those candidates, and from them a bound on how far each particle may
travel before the next narrow phase: less than its share of the distance to whatever it could hit, so that nothing can
have crossed (the displacement bound of offset geometric contact, Chen et al. 2025). The few that use up their way
before the others get a new one by themselves (`cloth_core.travel_renewal`).

*Response* (each step): a contact holds its parts apart by removing the approaching velocity, with Coulomb friction
bounded by the same impulse (Moreau's time stepping). There is no contact stiffness: the stable time step does not
depend on contact, what rests stays at rest exactly, and nothing is ever pulled towards anything.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.axis_layout import particle_rows
from cloth_core.body_contact import BodyContact, VertexPlanes, arm, carry_planes, hold_vertices, vertex_body_gaps
from cloth_core.broad_phase import BroadPhase
from cloth_core.closest_points import away_from_triangle, point_triangle
from cloth_core.contact_state import ContactSettings, ContactState, Renewal
from cloth_core.kernel import borrowing_kernel, kernel, zero
from cloth_core.near_planes import (
    NEAR,
    NearPlanes,
    add_plane,
    keep_on_own_side,
    room_of_pair,
    room_towards,
    side_of_pair,
)
from cloth_core.pair_contacts import (
    BODY_SIDE,
    BODY_VERTEX,
    COUNTS_FROM,
    PairContacts,
    hold_pairs,
    list_pair,
    measure_pair,
    nearer_by,
    repeat_impulses,
)
from cloth_core.self_contact import SelfContact
from cloth_core.travel_renewal import BODY_TRAVEL, CLOTH_TRAVEL, NO_TRAVEL, SPENT

__all__ = ["Contact", "carry_body", "keep_within_travel", "resolve_contacts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# How far the fastest particle may move between two broad phases, if nobody says otherwise [m].
_RADIUS = 0.006
_NO_BODY = np.zeros((0, 3))


class Contact:
    """Search for all contacts of a garment.

    Args:
        triangles: the cloth's, shape (m, 3).
        body: what it meets, or None.
        cloth: contact with itself, or None where that cannot happen.
        radius: how far particles may move at most between two broad phases [m].
        farthest: the same for those that have nothing near them but what is left out of the search [m].

    Attributes:
        broad: pairs that can come into contact for a while.
        narrow_phases: how many there were.
    """

    def __init__(
        self,
        triangles: Ints,
        body: BodyContact | None,
        cloth: SelfContact | None = None,
        radius: float = _RADIUS,
        farthest: float | None = None,
    ) -> None:
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self.body = body
        self.cloth = cloth
        self.broad = BroadPhase(self.triangles, body, cloth, radius, radius if farthest is None else farthest)
        self.narrow_phases = 0
        self._searched_body_x = _NO_BODY
        self._renewal = Renewal.none()

    def search(self, x: Floats, reach: float | Floats) -> ContactState:
        """Find all pairs that can come into contact, and how far each particle may go until the next search.

        Args:
            x: positions [m], shape (n, 3).
            reach: how far particles want to go [m], above 0, for all or for each, shape (n,); at most the radius is
                granted, and all of it to what is near nothing.

        Returns:
            what was found; its renewal is not allowed until whoever runs the steps says how particles want to go.
        """
        wanted = np.array(np.broadcast_to(reach, len(x)), dtype=np.float64)
        broad = self.broad
        searched, moved, left, way_of_body = broad.at(x, wanted)
        planes, pairs = broad.planes, broad.pairs
        if searched:
            self._renewal = Renewal.none()._replace(
                broad_x=broad.x, radii=broad.radii, radius=broad.radius, start=broad.start, entries=broad.entries,
                place=np.empty(len(pairs.kind), dtype=np.int32), waiting=np.empty(len(x), dtype=np.int32),
                closest=np.zeros(3), turn=np.zeros(1, dtype=np.int32), renewed=np.zeros(len(x), dtype=np.int32),
            )  # fmt: skip
        granted = np.where(broad.alone, left, np.minimum(wanted, left))
        body_x = self.body.body.vertices if self.body is not None else _NO_BODY
        body_triangles = self.body.body.triangles if self.body is not None else np.zeros((0, 3), dtype=np.int32)
        origin = np.ascontiguousarray(x.T)
        travel, near = _narrow_phase(
            origin, planes, pairs, body_x, body_triangles, moved, granted, self._renewal.place,
            self.body.offset if self.body is not None else 0.0,
        )  # fmt: skip
        self.narrow_phases += 1
        if body_x is not self._searched_body_x:
            planes.plane_count[:] = -1
            self._searched_body_x = body_x
        renewal = self._renewal._replace(way=moved, way_of_body=way_of_body)
        return ContactState(origin, travel, planes, pairs, NearPlanes.of(near), renewal)

    def forget(self) -> None:
        """Let the next search be one with a broad phase."""
        self.broad.forget()


@kernel
def _narrow_phase(
    origin: Floats,
    planes: VertexPlanes,
    pairs: PairContacts,
    body_x: Floats,
    body_triangles: Ints,
    moved: Floats,
    reach: Floats,
    place: Ints,
    offset: float,
) -> tuple[Floats, Floats]:
    """List the pairs that can come into contact within reach (n,) [m]; place (s,) says where each is listed, or -1.

    origin (3, n): positions [m]. Particles that can come as near to the body as offset [m] are armed. moved (n,): way
    of each particle since the broad phase [m]. A pair that is farther apart than what both sides may travel does not
    bound anybody.

    Returns:
        how far each particle may go [m], (n,); particle, normal and room of the planes of what nearly touches, (k, 5).
    """
    travel = np.maximum(reach / BODY_TRAVEL, reach + 1.1 * offset)
    x = particle_rows(origin, reach.shape[0])
    near = np.empty((16, 5))
    near_count = zero()
    vertex_body_gaps(x, planes, body_x, body_triangles, moved, travel, travel)
    planes.is_armed[:] = False
    planes.armed_count[0] = 0
    for i in range(travel.shape[0]):
        if travel[i] - min(BODY_TRAVEL * travel[i], reach[i]) < COUNTS_FROM * offset:
            arm(planes, i)
        if travel[i] < NEAR:
            travel[i], near, near_count = _near_body(i, x, planes, body_x, body_triangles, reach[i], near, near_count)
        travel[i] = min(BODY_TRAVEL * travel[i], reach[i])
    closest = np.zeros(3)
    count = 0
    for pair in range(pairs.kind.shape[0]):
        s: int = np.int32(pair)  # type: ignore[assignment]  # as lists of pairs have them
        kind = pairs.kind[s]
        way, span = nearer_by(pairs.kind, pairs.particles, s, moved), nearer_by(pairs.kind, pairs.particles, s, reach)
        needed = COUNTS_FROM * pairs.offset[s] + span
        distance = pairs.distance[s] - way
        if distance < needed:
            distance = np.sqrt(measure_pair(x, pairs, s, body_x, closest))
        if distance >= needed:
            pairs.impulse[s] = 0.0
            pairs.friction[s] = 0.0
            place[s] = -1
            continue
        place[s] = count
        list_pair(pairs, count, s, distance)
        count += 1
        if distance < NEAR:
            room = room_of_pair(x, pairs, s, body_x, closest, distance)
            if room >= 0.0:
                for k in range(4):
                    i = pairs.particles[s, k]
                    if i >= 0:
                        sign = side_of_pair(kind, k) / distance
                        near = add_plane(
                            near, near_count, int(i), sign * closest[0], sign * closest[1], sign * closest[2], room
                        )
                        near_count += 1
                continue
        bound = (BODY_TRAVEL if kind == BODY_SIDE or kind == BODY_VERTEX else CLOTH_TRAVEL) * distance
        for k in range(4):
            i = pairs.particles[s, k]
            if i >= 0:
                travel[i] = min(travel[i], bound)
    pairs.listed_count[0] = count
    for i in range(travel.shape[0]):
        if travel[i] < NO_TRAVEL:
            travel[i] = 0.0
    return travel, near[:near_count]


@kernel
def _near_body(
    i: int,
    x: Floats,
    planes: VertexPlanes,
    body_x: Floats,
    body_triangles: Ints,
    farthest: float,
    near: Floats,
    count: int,
) -> tuple[float, Floats, int]:
    """Distance [m] of particle i from what is not near of the body, and planes of what is, appended to near."""
    gap = farthest / BODY_TRAVEL
    for entry in range(planes.start[i], planes.start[i + 1]):
        t = planes.body_triangle[entry]
        a, b, c = body_triangles[t, 0], body_triangles[t, 1], body_triangles[t, 2]
        squared, u, w, z = point_triangle(x[i], body_x[a], body_x[b], body_x[c])
        distance = np.sqrt(squared)
        room = room_towards(distance, distance) if distance < NEAR else -1.0
        if room < 0.0:
            gap = min(gap, distance)
            continue
        nx, ny, nz = away_from_triangle(x[i], body_x[a], body_x[b], body_x[c], u, w, z, distance)
        near = add_plane(near, count, i, nx, ny, nz, room)
        count += 1
    return gap, near, count


@borrowing_kernel
def keep_within_travel(x: Floats, v: Floats, state: ContactState, moved: Floats) -> bool:
    """Stop every particle at its bound; fill moved (n,) with squared ways [m^2]; whether any has used most of its way.

    A particle that is stopped loses its speed away from its origin, x and v (3, at least n) [m, m/s]: otherwise
    whatever drives it there would go on adding to a velocity that shows nowhere.
    """
    travel = state.travel
    px, py, pz = x[0], x[1], x[2]
    ox, oy, oz = state.origin[0], state.origin[1], state.origin[2]
    spent = 0
    for i in range(travel.shape[0]):  # this much and no more, so that it is done to eight particles at once
        dx, dy, dz = px[i] - ox[i], py[i] - oy[i], pz[i] - oz[i]
        way = dx * dx + dy * dy + dz * dz
        moved[i] = way
        most = SPENT * travel[i]
        spent += way > most * most
    if spent > 0:
        for i in range(travel.shape[0]):
            bound = travel[i]
            if moved[i] > bound * bound:
                share = bound / np.sqrt(moved[i])
                dx, dy, dz = px[i] - ox[i], py[i] - oy[i], pz[i] - oz[i]
                px[i] = ox[i] + share * dx
                py[i] = oy[i] + share * dy
                pz[i] = oz[i] + share * dz
                outward = (dx * v[0, i] + dy * v[1, i] + dz * v[2, i]) / moved[i]
                if outward > 0.0:
                    v[0, i] -= outward * dx
                    v[1, i] -= outward * dy
                    v[2, i] -= outward * dz
                moved[i] = bound * bound
    count = travel.shape[0]
    return keep_on_own_side(
        particle_rows(x, count), particle_rows(v, count), particle_rows(state.origin, count), state.near
    ) or (spent > 0)


@borrowing_kernel
def resolve_contacts(
    x: Floats, v: Floats, inverse_mass: Floats, state: ContactState, settings: ContactSettings, dt: float, moved: Floats
) -> bool:
    """Hold everything apart after a step, in place; whether any particle has used most of its way.

    Shapes: x, v (3, at least n) [m, m/s]; inverse_mass (n,) [1/kg]; moved (n,) [m^2] is written; dt [s].
    """
    count = inverse_mass.shape[0]
    rows_x, rows_v = particle_rows(x, count), particle_rows(v, count)
    repeat_impulses(rows_x, rows_v, inverse_mass, state.pairs, dt)
    spent = keep_within_travel(x, v, state, moved)
    hold_vertices(
        rows_x, rows_v, inverse_mass, state.planes, settings.body_vertices, settings.body_velocity,
        settings.body_triangles, settings.body_way, settings.offset, settings.friction, settings.push_speed, dt,
    )  # fmt: skip
    hold_pairs(
        rows_x, rows_v, inverse_mass, state.pairs, settings.body_vertices, settings.body_velocity, settings.body_way,
        settings.friction, settings.push_speed, dt, moved,
    )  # fmt: skip
    return spent


@borrowing_kernel
def carry_body(state: ContactState, settings: ContactSettings, dt: float) -> None:
    """Take the body, and the planes at which it holds particles, on by the way of a step of dt [s]."""
    for i in range(settings.body_vertices.shape[0]):
        for axis in range(3):
            settings.body_vertices[i, axis] += dt * settings.body_velocity[i, axis]
    carry_planes(state.planes, dt)
