"""How far each particle may go until contacts are searched anew, renewed for the few that have used it up.

Every particle may be anywhere within its travel of its own origin: the bound of a pair holds for all places of its
particles within theirs. So one that has used up its travel gets a new origin where it is, and a new travel by the
distances of its pairs, measured between the origins of their particles. Where another particle of a pair could go too
far for that, its travel is cut short, and where it is too far already it is renewed as well.

On a sphere or a shoulder it is one particle at a time, the one that slides fastest, that uses up its travel; a narrow
phase would measure the pairs of all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.axis_layout import particle_rows
from cloth_core.body_contact import arm
from cloth_core.closest_points import away_from_triangle, point_triangle
from cloth_core.contact_state import ContactState, Renewal
from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel, zero
from cloth_core.near_planes import NEAR, forget_planes, put_plane, room_of_pair, room_towards, side_of_pair
from cloth_core.pair_contacts import BODY_SIDE, BODY_VERTEX, COUNTS_FROM, list_pair, measure_pair, nearer_by

__all__ = [
    "BODY_TRAVEL",
    "CLOTH_TRAVEL",
    "NO_TRAVEL",
    "SPENT",
    "enough_of_radius",
    "pairs_of_particles",
    "renew_spent",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Share of the distance between two parts that each may travel between two narrow phases; the body stands still.
BODY_TRAVEL = 0.9
CLOTH_TRAVEL = 0.45
# A shorter way than this is none [m]: rounding must not decide on which side of a surface a particle ends up.
NO_TRAVEL = 1e-9
# A new search is due when any particle has used this share of its way.
SPENT = 0.65
# What must be left of it for a narrow phase to make do with the candidates that there are: this share of what a
# particle wants to go, so that the bound slows nothing down; but no less than this much [m] and no more than this share
# of the largest radius.
_ENOUGH_OF_REACH = 0.1
_ENOUGH = 0.001
_ENOUGH_OF_RADIUS = 0.5
# Of all particles this share at most is renewed at once, or this many: for more, a narrow phase is cheaper.
_FEW, _FEW_OF_FEW = 0.1, 8


@kernel
def pairs_of_particles(particles: Ints, count: int) -> tuple[Ints, Ints]:
    """Which pairs each of `count` particles belongs to, from the particles of each pair (s, 4), -1 for none.

    Returns:
        start (count + 1,) and entries: those of particle i are entries[start[i] : start[i + 1]].
    """
    start = np.zeros(count + 2, dtype=np.int32)
    for s in range(particles.shape[0]):
        for k in range(4):
            if particles[s, k] >= 0:
                start[particles[s, k] + 2] += 1
    for i in range(count):
        start[i + 2] += start[i + 1]
    entries = np.empty(start[count + 1], dtype=np.int32)
    for s in range(particles.shape[0]):
        for k in range(4):
            i = particles[s, k]
            if i >= 0:
                entries[start[i + 1]] = s
                start[i + 1] += 1
    return start[: count + 1], entries


@borrowing_kernel
def enough_of_radius(left: float, wanted: float, radius: float) -> bool:
    """Whether what is left of a particle's radius [m] will do for a while, `radius` being the largest one."""
    enough = min(max(_ENOUGH_OF_REACH * wanted, _ENOUGH), _ENOUGH_OF_RADIUS * radius)
    return bool(left >= min(min(wanted, radius), enough))


@borrowing_kernel
def renew_spent(
    x: Floats, v: Floats, state: ContactState, body_x: Floats, body_triangles: Ints, moved: Floats, dt: float
) -> bool:
    """New origins and travels for the particles that have used up theirs; False if all contacts must be searched.

    Shapes: x, v (n, 3) [m, m/s]; moved (n,), squared ways from the origins [m^2], is set to 0 for those renewed; body_x
    (b, 3) [m], body_triangles (t, 3); dt: step [s]. After a failure all of moved is infinite.
    """
    if state.renewal.allowed and _all_renewed(x, v, state, body_x, body_triangles, moved, dt):
        return True
    # Whatever of it has been done is good for nothing: nobody may take the way of any particle for granted.
    moved[:] = np.inf
    return False


@borrowing_kernel
def _all_renewed(
    x: Floats, v: Floats, state: ContactState, body_x: Floats, body_triangles: Ints, moved: Floats, dt: float
) -> bool:
    renewal = state.renewal
    most = min(max(int(_FEW * x.shape[0]), _FEW_OF_FEW), x.shape[0])
    renewal.turn[0] += 1
    count = zero()
    for i in range(x.shape[0]):
        if moved[i] > (SPENT * state.travel[i]) ** 2:
            if count >= most:
                return False
            renewal.waiting[count] = i
            count += 1
    for k in range(state.near.number[0]):
        if state.near.used[k] and not _waits(state.near.particle[k], renewal.waiting, -1, count):
            if count >= most:
                return False
            renewal.waiting[count] = state.near.particle[k]
            count += 1
    done = zero()
    while done < count:
        count = _renew(renewal.waiting[done], done, count, x, v, state, body_x, body_triangles, moved, dt)
        done += 1
        if count < 0 or count > most:
            return False
    return True


@borrowing_kernel
def _renew(
    p: int,
    at: int,
    count: int,
    x: Floats,
    v: Floats,
    state: ContactState,
    body_x: Floats,
    body_triangles: Ints,
    moved: Floats,
    dt: float,
) -> int:
    """Renew particle p, number `at` of `count` that wait; how many wait then, -1 if all contacts must be searched."""
    renewal, planes, pairs = state.renewal, state.planes, state.pairs
    speed = np.sqrt(v[p, 0] ** 2 + v[p, 1] ** 2 + v[p, 2] ** 2)
    wanted = max(renewal.steps * dt * speed, renewal.least_reach)
    dx, dy, dz = x[p, 0] - renewal.broad_x[p, 0], x[p, 1] - renewal.broad_x[p, 1], x[p, 2] - renewal.broad_x[p, 2]
    way = np.sqrt(dx * dx + dy * dy + dz * dz) + renewal.way_of_body
    left = renewal.radii[p] - way
    if not enough_of_radius(left, wanted, renewal.radius):
        return -1
    # What is near nothing lengthens no list by how far it may go.
    alone = planes.start[p] == planes.start[p + 1] and renewal.start[p] == renewal.start[p + 1]
    granted = left if alone else min(wanted, left)
    travel = granted / BODY_TRAVEL
    forget_planes(state.near, p)
    if planes.start[p] < planes.start[p + 1]:
        arm(planes, p)
    for entry in range(planes.start[p], planes.start[p + 1]):
        if planes.distance[entry] - way >= travel:
            continue
        t = planes.body_triangle[entry]
        a, b, c = body_triangles[t, 0], body_triangles[t, 1], body_triangles[t, 2]
        squared, wa, wb, wc = point_triangle(x[p], body_x[a], body_x[b], body_x[c])
        distance = np.sqrt(squared)
        room = room_towards(distance, distance) if distance < NEAR else -1.0
        if room < 0.0:
            travel = min(travel, distance)
            continue
        nx, ny, nz = away_from_triangle(x[p], body_x[a], body_x[b], body_x[c], wa, wb, wc, distance)
        if not put_plane(state.near, p, nx, ny, nz, room):
            return -1
    travel = min(BODY_TRAVEL * travel, granted)
    for axis in range(3):
        state.origin[axis, p] = x[p, axis]
    renewal.way[p] = way
    state.travel[p] = granted
    moved[p] = 0.0
    renewal.renewed[p] = renewal.turn[0]
    closest = renewal.closest
    origin = particle_rows(state.origin, x.shape[0])
    for entry in range(renewal.start[p], renewal.start[p + 1]):
        s = renewal.entries[entry]
        needed = COUNTS_FROM * pairs.offset[s] + nearer_by(pairs.kind, pairs.particles, s, state.travel)
        distance = pairs.distance[s] - nearer_by(pairs.kind, pairs.particles, s, renewal.way)
        if distance < needed:
            distance = np.sqrt(measure_pair(origin, pairs, s, body_x, closest))
        if distance < needed and renewal.place[s] < 0:
            renewal.place[s] = pairs.listed_count[0]
            pairs.listed_count[0] += 1
        if renewal.place[s] >= 0:
            list_pair(pairs, renewal.place[s], s, distance)
        if distance >= needed:
            continue
        if distance < NEAR:
            # A plane between both parts stands for where all of their particles are now.
            all_here = True
            for k in range(4):
                q = pairs.particles[s, k]
                if q >= 0 and renewal.renewed[q] != renewal.turn[0]:
                    all_here = False
                    if not _waits(q, renewal.waiting, at, count):
                        if count == renewal.waiting.shape[0]:
                            return -1
                        renewal.waiting[count] = q
                        count += 1
            if not all_here:
                continue
            room = room_of_pair(origin, pairs, s, body_x, closest, distance)
            if room >= 0.0:
                for k in range(4):
                    q = pairs.particles[s, k]
                    sign = side_of_pair(pairs.kind[s], k) / distance
                    if q >= 0 and not put_plane(
                        state.near, q, sign * closest[0], sign * closest[1], sign * closest[2], room
                    ):
                        return -1
                continue
        kind = pairs.kind[s]
        bound = (BODY_TRAVEL if kind == BODY_SIDE or kind == BODY_VERTEX else CLOTH_TRAVEL) * distance
        travel = min(travel, bound)
        for k in range(4):
            q = pairs.particles[s, k]
            if q < 0 or q == p or state.travel[q] <= bound:
                continue
            if moved[q] <= (SPENT * bound) ** 2:
                if not _may_fly(bound, q, v, renewal, dt):
                    return -1
                state.travel[q] = bound
            elif not _waits(q, renewal.waiting, at, count):
                if count == renewal.waiting.shape[0]:
                    return -1
                renewal.waiting[count] = q
                count += 1
    if not _may_fly(travel, p, v, renewal, dt):
        return -1
    state.travel[p] = travel
    return count


@inlined_kernel
def _may_fly(travel: float, i: int, v: Floats, renewal: Renewal, dt: float) -> bool:
    """Whether what is left of a travel [m] when it counts as not yet spent will do for a step of particle i."""
    squared = v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1] + v[i, 2] * v[i, 2]
    room = max((1.0 - SPENT) * travel, renewal.least_room)
    return bool(room * room >= dt * dt * squared)


@inlined_kernel
def _waits(q: int, waiting: Ints, at: int, count: int) -> bool:
    """Whether particle q is among those that are still to be renewed, after number `at` of `count`."""
    for k in range(at + 1, count):
        if waiting[k] == q:
            return True
    return False
