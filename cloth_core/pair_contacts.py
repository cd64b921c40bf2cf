"""Contacts between two parts of which at least one has several particles: impulses that only push.

Such contacts share particles, so that one pass over them does not settle them. They are swept a few times a step, and
each step starts from the impulses of the last one: resting contacts need the same impulse in every step, so they settle
from step to step, and cloth at rest stays at rest.

The vector between the closest points of a pair is sum_k weight_k x_k (cloth) minus the body's point, with weights of
both signs: so one set of formulas serves cloth on a body and cloth on cloth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.closest_points import point_triangle, segment_segment
from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel

__all__ = [
    "BODY_SIDE",
    "BODY_VERTEX",
    "CLOTH_SIDE",
    "CLOTH_VERTEX",
    "COUNTS_FROM",
    "PUSH_TIME",
    "PairContacts",
    "hold_pairs",
    "list_pair",
    "measure_pair",
    "nearer_by",
    "repeat_impulses",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Kinds of pairs, and what their four particles are.
BODY_SIDE = 0  # two of a cloth side; body: two vertices of a body side
BODY_VERTEX = 1  # three corners of a cloth triangle; body: one vertex
CLOTH_VERTEX = 2  # a cloth vertex, and three corners of a cloth triangle
CLOTH_SIDE = 3  # two of a cloth side, and two of another one

# A pair counts from this many offsets on: one that rests at the offset must not come and go with rounding.
COUNTS_FROM = 1.02
_SWEEPS = 4
# Time in which cloth that is too near comes out, to 1/e [s].
PUSH_TIME = 0.01
# Where there is no room for all, as in a fold at a point where seams meet, pairs that are too near push each other to
# and fro for ever. For each second in which a pair gets nowhere it takes so much longer, up to the second number [s].
_TIRES, _TIRED = 4.0, 1.0


class PairContacts(NamedTuple):
    """Candidates of a broad phase, s pairs; those near enough to be looked at in each step; those in contact.

    Attributes:
        kind: one of the kinds above, (s,).
        particles: cloth particles, -1 where there is none, (s, 4).
        body: body vertices, -1 where there is none, (s, 2).
        offset: distance at which the two are held apart [m], (s,).
        distance: at the broad phase [m], (s,).
        weight: of each particle in the vector between the closest points, (s, 4); for two sides of cloth and body the
            third entry is where the body's closest point lies between its two vertices.
        normal: unit vector towards the first part (from body to cloth), (s, 3).
        gap: distance to the offset before the step [m], (s,).
        impulse: what the contact gave in the last step along the normal [N s], (s,).
        friction: the same across the normal [N s], (s, 3).
        stuck: by how much more slowly the pair comes out than others, because it did not get anywhere [s], (s,).
        listed: pairs that can come into contact before the next search; the first listed_count[0] count, (s,).
        listed_distance: their distances at the search [m], (s,).
        listed_particles: their particles, one of them again where there is none, (s, 4).
        listed_room: a pair need not be measured while no particle of it has gone farther than this, squared [m^2];
            below 0: it must be, (s,).
        active: pairs in contact; the first active_count[0] count, (s,).
    """

    kind: Ints
    particles: Ints
    body: Ints
    offset: Floats
    distance: Floats
    weight: Floats
    normal: Floats
    gap: Floats
    impulse: Floats
    friction: Floats
    stuck: Floats
    listed: Ints
    listed_distance: Floats
    listed_particles: Ints
    listed_room: Floats
    listed_count: Ints
    active: Ints
    active_count: Ints

    @classmethod
    def of(cls, rows: Ints, offset: Floats, distance: Floats) -> PairContacts:
        """Candidates, none of them in contact yet: rows (s, 7) of kind, four particles, two body vertices."""
        count = len(rows)
        return cls(
            kind=np.ascontiguousarray(rows[:, 0]),
            particles=np.ascontiguousarray(rows[:, 1:5]),
            body=np.ascontiguousarray(rows[:, 5:7]),
            offset=offset,
            distance=distance,
            weight=np.zeros((count, 4)),
            normal=np.zeros((count, 3)),
            gap=np.zeros(count),
            impulse=np.zeros(count),
            friction=np.zeros((count, 3)),
            stuck=np.zeros(count),
            listed=np.zeros(count, dtype=np.int32),
            listed_distance=np.zeros(count),
            listed_particles=np.zeros((count, 4), dtype=np.int32),
            listed_room=np.zeros(count),
            listed_count=np.zeros(1, dtype=np.int32),
            active=np.zeros(count, dtype=np.int32),
            active_count=np.zeros(1, dtype=np.int32),
        )

    @classmethod
    def none(cls) -> PairContacts:
        """No pairs."""
        return cls.of(np.zeros((0, 7), dtype=np.int32), np.zeros(0), np.zeros(0))

    def remember(self, before: PairContacts, start: Ints, entries: Ints) -> None:
        """Take over the impulses of the pairs in contact of an earlier list, so that the next step starts from them.

        start, entries: the pairs of particle i are entries[start[i] : start[i + 1]].
        """
        old = before.active[: before.active_count[0]]
        place = _places(before, self, start, entries)
        new, old = place[place >= 0], old[place >= 0]
        for mine, theirs in (
            (self.weight, before.weight),
            (self.normal, before.normal),
            (self.impulse, before.impulse),
            (self.friction, before.friction),
            (self.gap, before.gap),
            (self.stuck, before.stuck),
        ):
            mine[new] = theirs[old]
        self.active[: len(new)] = new
        self.active_count[0] = len(new)


@kernel
def _places(before: PairContacts, after: PairContacts, start: Ints, entries: Ints) -> Ints:
    """Where each pair in contact of one list stands in another one, -1 if it does not, (active_count,)."""
    place = np.full(before.active_count[0], -1, dtype=np.int32)
    for row in range(place.shape[0]):
        s = before.active[row]
        i = before.particles[s, 0]
        for entry in range(start[i], start[i + 1]):
            t = entries[entry]
            same = before.kind[s] == after.kind[t]
            for k in range(4):
                same = same and before.particles[s, k] == after.particles[t, k]
            for k in range(2):
                same = same and before.body[s, k] == after.body[t, k]
            if same:
                place[row] = t
                break
    return place


@borrowing_kernel
def repeat_impulses(x: Floats, v: Floats, inverse_mass: Floats, pairs: PairContacts, dt: float) -> None:
    """Give each contact what it needed in the last step; x, v (n, 3), inverse_mass (n,), dt [s]."""
    for entry in range(pairs.active_count[0]):
        _apply_kept(x, v, inverse_mass, pairs, pairs.active[entry], 1.0, dt)


@borrowing_kernel
def list_pair(pairs: PairContacts, entry: int, s: int, distance: float) -> None:
    """Let pair s, so far apart at the search [m], be one that is looked at in each step."""
    pairs.listed[entry] = s
    pairs.listed_distance[entry] = distance
    pairs.listed_room[entry] = -1.0  # the next step finds out
    for k in range(4):
        i = pairs.particles[s, k]
        pairs.listed_particles[entry, k] = i if i >= 0 else pairs.particles[s, 0]


@inlined_kernel
def _room(pairs: PairContacts, entry: int, s: int) -> float:
    """What listed_room is for a listed pair that gives no impulse, where the body stands still [m^2]."""
    room = pairs.listed_distance[entry] - COUNTS_FROM * pairs.offset[s]
    if pairs.kind[s] == CLOTH_VERTEX or pairs.kind[s] == CLOTH_SIDE:
        room *= 0.5
    # A little less, so that rounding decides nothing.
    return (1.0 - 1e-9) * room * room if room > 0.0 else -1.0


@kernel
def hold_pairs(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    pairs: PairContacts,
    body_x: Floats,
    body_v: Floats,
    body_way: float,
    friction: float,
    push_speed: float,
    dt: float,
    moved: Floats,
) -> None:
    """Hold all pairs apart after a step, in place.

    Shapes: x, v (n, 3) [m, m/s]; inverse_mass (n,); body_x, body_v (b, 3) [m, m/s]; moved (n,), way of each particle
    since the search [m], and body_way, that of the body at most; friction is Coulomb's coefficient; push_speed [m/s]
    bounds how fast what is too near leaves.
    """
    count = _find_active(x, v, inverse_mass, pairs, body_x, body_v, body_way, dt, moved, np.empty(3))
    if count == 0:
        return
    # What the sweeps need of each contact, side by side; a particle that is not there is one of no weight.
    ends = np.empty((count, 4), dtype=np.intp)
    weight, share = np.empty((count, 4)), np.empty((count, 4))
    given = np.empty((count, 4))
    body_part = np.empty((count, 3))
    stiff = np.empty(count)
    kept = 0
    for entry in range(count):
        s = pairs.active[entry]
        compliance = _compliance(inverse_mass, pairs, s)
        if compliance <= 0.0:
            continue
        pairs.active[kept], pairs.active[entry] = s, pairs.active[kept]
        for k in range(4):
            i = pairs.particles[s, k]
            ends[kept, k] = max(i, 0)
            weight[kept, k] = pairs.weight[s, k] if i >= 0 else 0.0
            share[kept, k] = pairs.weight[s, k] * inverse_mass[i] if i >= 0 else 0.0
        body_part[kept, 0], body_part[kept, 1], body_part[kept, 2] = _body_velocity(body_v, pairs, s)
        given[kept, 0] = pairs.impulse[s]
        for axis in range(3):
            given[kept, 1 + axis] = pairs.friction[s, axis]
        stiff[kept] = 1.0 / compliance
        kept += 1
    for _ in range(_SWEEPS):
        changed = False
        for r in range(kept):
            s = pairs.active[r]
            i, j, k, m = ends[r, 0], ends[r, 1], ends[r, 2], ends[r, 3]
            wi, wj, wk, wm = weight[r, 0], weight[r, 1], weight[r, 2], weight[r, 3]
            vx = wi * v[i, 0] + wj * v[j, 0] + wk * v[k, 0] + wm * v[m, 0] - body_part[r, 0]
            vy = wi * v[i, 1] + wj * v[j, 1] + wk * v[k, 1] + wm * v[m, 1] - body_part[r, 1]
            vz = wi * v[i, 2] + wj * v[j, 2] + wk * v[k, 2] + wm * v[m, 2] - body_part[r, 2]
            nx, ny, nz = pairs.normal[s, 0], pairs.normal[s, 1], pairs.normal[s, 2]
            approach = vx * nx + vy * ny + vz * nz
            # A gap that was still open may close within the step, no more.
            wanted = -max(pairs.gap[s], 0.0) / dt
            before = pairs.impulse[s]
            now = max(before + (wanted - approach) * stiff[r], 0.0)
            if before == 0.0 and now == 0.0:
                continue
            pairs.impulse[s] = now
            fx, fy, fz = pairs.friction[s, 0], pairs.friction[s, 1], pairs.friction[s, 2]
            tx = fx - (vx - approach * nx) * stiff[r]
            ty = fy - (vy - approach * ny) * stiff[r]
            tz = fz - (vz - approach * nz) * stiff[r]
            squared = tx * tx + ty * ty + tz * tz
            limit = friction * now
            if squared > limit * limit:
                scale = limit / np.sqrt(squared)
                tx, ty, tz = scale * tx, scale * ty, scale * tz
            pairs.friction[s, 0], pairs.friction[s, 1], pairs.friction[s, 2] = tx, ty, tz
            px = (now - before) * nx + tx - fx
            py = (now - before) * ny + ty - fy
            pz = (now - before) * nz + tz - fz
            changed = True
            wi, wj, wk, wm = share[r, 0], share[r, 1], share[r, 2], share[r, 3]
            v[i, 0] += wi * px
            v[i, 1] += wi * py
            v[i, 2] += wi * pz
            v[j, 0] += wj * px
            v[j, 1] += wj * py
            v[j, 2] += wj * pz
            v[k, 0] += wk * px
            v[k, 1] += wk * py
            v[k, 2] += wk * pz
            v[m, 0] += wm * px
            v[m, 1] += wm * py
            v[m, 2] += wm * pz
        if not changed:
            break
    # The places follow once, by all that was given, and what is too near goes a little apart.
    for r in range(kept):
        s = pairs.active[r]
        way = dt * (pairs.impulse[s] - given[r, 0])
        if pairs.gap[s] < 0.0:
            way += min(push_speed, -pairs.gap[s] / (PUSH_TIME + pairs.stuck[s])) * dt * stiff[r]
        wx = way * pairs.normal[s, 0] + dt * (pairs.friction[s, 0] - given[r, 1])
        wy = way * pairs.normal[s, 1] + dt * (pairs.friction[s, 1] - given[r, 2])
        wz = way * pairs.normal[s, 2] + dt * (pairs.friction[s, 2] - given[r, 3])
        if wx == 0.0 and wy == 0.0 and wz == 0.0:
            continue
        for k in range(4):
            i, part = ends[r, k], share[r, k]
            x[i, 0] += part * wx
            x[i, 1] += part * wy
            x[i, 2] += part * wz


@borrowing_kernel
def _find_active(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    pairs: PairContacts,
    body_x: Floats,
    body_v: Floats,
    body_way: float,
    dt: float,
    moved: Floats,
    closest: Floats,
) -> int:
    """Measure the pairs that can have come near; list those in contact, with weights, normal and gap.

    closest (3,) is scratch.
    """
    count = 0
    for entry in range(pairs.listed_count[0]):
        if body_way == 0.0 and _within_room(pairs.listed_particles, entry, moved, pairs.listed_room[entry]):
            continue
        s = pairs.listed[entry]
        size = pairs.impulse[s]
        if size > 0.0:  # it was given on trust at the beginning of the step, where the parts touched in the last one
            _apply_kept(x, v, inverse_mass, pairs, s, -1.0, dt)
        # Nothing can have come nearer than by the way that its particles, and the body, went since the search.
        reach = COUNTS_FROM * pairs.offset[s]
        squared = np.inf
        if pairs.listed_distance[entry] - reach - body_way <= _way(pairs, s, moved):
            squared = measure_pair(x, pairs, s, body_x, closest)
        if squared >= reach * reach or squared < 1e-24:
            pairs.impulse[s] = pairs.gap[s] = 0.0
            for axis in range(3):
                pairs.friction[s, axis] = 0.0
            pairs.listed_room[entry] = _room(pairs, entry, s)
            continue
        pairs.listed_room[entry] = -1.0
        distance = np.sqrt(squared)
        for axis in range(3):
            pairs.normal[s, axis] = closest[axis] / distance
        vx, vy, vz = _relative_velocity(v, body_v, pairs, s)
        approach = vx * pairs.normal[s, 0] + vy * pairs.normal[s, 1] + vz * pairs.normal[s, 2]
        before, pairs.gap[s] = pairs.gap[s], distance - pairs.offset[s] - dt * approach
        # Of the way out that it was to take it has taken less than a half: something else holds it there.
        left = before * (1.0 - 0.5 * dt / (PUSH_TIME + pairs.stuck[s]))
        if before < 0.0 and pairs.gap[s] < min(left, (1.0 - COUNTS_FROM) * pairs.offset[s]):
            pairs.stuck[s] = min(pairs.stuck[s] + _TIRES * dt, _TIRED)
        else:
            pairs.stuck[s] = max(pairs.stuck[s] - dt, 0.0)
        if size > 0.0:  # and it is given again where they touch now
            _apply_kept(x, v, inverse_mass, pairs, s, 1.0, dt)
        pairs.active[count] = s
        count += 1
    pairs.active_count[0] = count
    return count


@inlined_kernel
def _within_room(particles: Ints, entry: int, moved: Floats, room: float) -> bool:
    """Whether none of the particles in a row (4,) has gone farther than that; squared ways (n,) [m^2]."""
    return bool(
        (moved[particles[entry, 0]] <= room)
        & (moved[particles[entry, 1]] <= room)
        & (moved[particles[entry, 2]] <= room)
        & (moved[particles[entry, 3]] <= room)
    )


@borrowing_kernel
def _way(pairs: PairContacts, s: int, moved: Floats) -> float:
    """How much nearer the parts of pair s can have come, from squared ways (n,) [m^2]."""
    kind = pairs.kind[s]
    p, q, a, b = pairs.particles[s, 0], pairs.particles[s, 1], pairs.particles[s, 2], pairs.particles[s, 3]
    if kind == BODY_SIDE:
        return float(np.sqrt(max(moved[p], moved[q])))
    if kind == BODY_VERTEX:
        return float(np.sqrt(max(moved[p], max(moved[q], moved[a]))))
    if kind == CLOTH_VERTEX:
        return float(np.sqrt(moved[p]) + np.sqrt(max(moved[q], max(moved[a], moved[b]))))
    return float(np.sqrt(max(moved[p], moved[q])) + np.sqrt(max(moved[a], moved[b])))


@inlined_kernel
def nearer_by(kinds: Ints, particles: Ints, s: int, length: Floats) -> float:
    """How much nearer the parts of pair s come at most when each particle moves by its length (n,) [m]."""
    kind = kinds[s]
    p, q, a, b = particles[s, 0], particles[s, 1], particles[s, 2], particles[s, 3]
    if kind == BODY_SIDE:
        most = max(length[p], length[q])
    elif kind == BODY_VERTEX:
        most = max(length[p], max(length[q], length[a]))
    elif kind == CLOTH_VERTEX:
        most = length[p] + max(length[q], max(length[a], length[b]))
    else:
        most = max(length[p], length[q]) + max(length[a], length[b])
    return float(most)


@borrowing_kernel
def measure_pair(x: Floats, pairs: PairContacts, s: int, body_x: Floats, closest: Floats) -> float:
    """Squared distance of pair s [m^2]; sets its weights and the vector between its closest points, closest (3,)."""
    kind = pairs.kind[s]
    p, q, a, b = pairs.particles[s, 0], pairs.particles[s, 1], pairs.particles[s, 2], pairs.particles[s, 3]
    if kind == CLOTH_SIDE:
        squared, w0, w1 = segment_segment(x[p], x[q], x[a], x[b])
        pairs.weight[s, 0], pairs.weight[s, 1] = 1.0 - w0, w0
        pairs.weight[s, 2], pairs.weight[s, 3] = w1 - 1.0, -w1
    elif kind == CLOTH_VERTEX:
        squared, w0, w1, w2 = point_triangle(x[p], x[q], x[a], x[b])
        pairs.weight[s, 0], pairs.weight[s, 1], pairs.weight[s, 2], pairs.weight[s, 3] = 1.0, -w0, -w1, -w2
    elif kind == BODY_SIDE:
        c, d = pairs.body[s, 0], pairs.body[s, 1]
        squared, w0, w1 = segment_segment(x[p], x[q], body_x[c], body_x[d])
        pairs.weight[s, 0], pairs.weight[s, 1], pairs.weight[s, 2] = 1.0 - w0, w0, w1
        for axis in range(3):
            closest[axis] = -(1.0 - w1) * body_x[c, axis] - w1 * body_x[d, axis]
    else:
        c = pairs.body[s, 0]
        squared, w0, w1, w2 = point_triangle(body_x[c], x[p], x[q], x[a])
        pairs.weight[s, 0], pairs.weight[s, 1], pairs.weight[s, 2] = w0, w1, w2
        for axis in range(3):
            closest[axis] = -body_x[c, axis]
    if kind == CLOTH_SIDE or kind == CLOTH_VERTEX:
        for axis in range(3):
            closest[axis] = pairs.weight[s, 2] * x[a, axis] + pairs.weight[s, 3] * x[b, axis]
    elif kind == BODY_VERTEX:
        for axis in range(3):
            closest[axis] += pairs.weight[s, 2] * x[a, axis]
    for axis in range(3):
        closest[axis] += pairs.weight[s, 0] * x[p, axis] + pairs.weight[s, 1] * x[q, axis]
    return float(squared)


@borrowing_kernel
def _compliance(inverse_mass: Floats, pairs: PairContacts, s: int) -> float:
    """Relative velocity that a unit impulse gives [1/kg]."""
    compliance = 0.0
    for k in range(4):
        if pairs.particles[s, k] >= 0:
            compliance += pairs.weight[s, k] * pairs.weight[s, k] * inverse_mass[pairs.particles[s, k]]
    return compliance


@borrowing_kernel
def _relative_velocity(v: Floats, body_v: Floats, pairs: PairContacts, s: int) -> tuple[float, float, float]:
    """Velocity of the first part's closest point relative to the other's [m/s]."""
    vx, vy, vz = 0.0, 0.0, 0.0
    for k in range(4):
        i = pairs.particles[s, k]
        if i >= 0:
            weight = pairs.weight[s, k]
            vx += weight * v[i, 0]
            vy += weight * v[i, 1]
            vz += weight * v[i, 2]
    bx, by, bz = _body_velocity(body_v, pairs, s)
    return vx - bx, vy - by, vz - bz


@borrowing_kernel
def _body_velocity(body_v: Floats, pairs: PairContacts, s: int) -> tuple[float, float, float]:
    """Velocity of the body's closest point [m/s], 0 where the other part is cloth."""
    c, d = pairs.body[s, 0], pairs.body[s, 1]
    if c < 0:
        return 0.0, 0.0, 0.0
    if d < 0:
        return body_v[c, 0], body_v[c, 1], body_v[c, 2]
    along = pairs.weight[s, 2]
    rest = 1.0 - along
    return (
        rest * body_v[c, 0] + along * body_v[d, 0],
        rest * body_v[c, 1] + along * body_v[d, 1],
        rest * body_v[c, 2] + along * body_v[d, 2],
    )


@borrowing_kernel
def _apply_kept(
    x: Floats, v: Floats, inverse_mass: Floats, pairs: PairContacts, s: int, share: float, dt: float
) -> None:
    """Apply a share of the impulse that pair s gave in the last step, along and across its normal."""
    size = share * pairs.impulse[s]
    _apply(
        x, v, inverse_mass, pairs, s,
        size * pairs.normal[s, 0] + share * pairs.friction[s, 0],
        size * pairs.normal[s, 1] + share * pairs.friction[s, 1],
        size * pairs.normal[s, 2] + share * pairs.friction[s, 2],
        dt,
    )  # fmt: skip


@borrowing_kernel
def _apply(
    x: Floats, v: Floats, inverse_mass: Floats, pairs: PairContacts, s: int, px: float, py: float, pz: float, dt: float
) -> None:
    """Apply an impulse [N s] at the closest points of pair s."""
    for k in range(4):
        i = pairs.particles[s, k]
        if i < 0:
            continue
        share = pairs.weight[s, k] * inverse_mass[i]
        v[i, 0] += share * px
        v[i, 1] += share * py
        v[i, 2] += share * pz
        x[i, 0] += share * px * dt
        x[i, 1] += share * py * dt
        x[i, 2] += share * pz * dt
