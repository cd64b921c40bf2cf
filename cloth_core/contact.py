"""Contact of cloth with a body: nothing can pass through, at any speed and time step.

*Search* (rarely): the double traversal of the AABB trees finds every vertex-triangle, triangle-vertex and edge-edge
pair within reach, and from their distances a bound on how far each particle may travel before the next search: less
than its distance to the body, so that it cannot have crossed (the displacement bound of offset geometric contact, Chen
et al. 2025; the body stands still, so the cloth may use nearly the whole gap).

*Response* (each step): a contact holds its particle at the offset by removing the approaching velocity, with Coulomb
friction bounded by the same impulse (Moreau's time stepping). There is no contact stiffness: the stable time step does
not depend on contact, a particle at rest stays at rest exactly, and nothing is ever pulled towards the body.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree, overlapping_pairs, refit_tree
from cloth_core.body import Body
from cloth_core.closest_points import point_triangle, segment_segment
from cloth_core.intersections import crossing_edges
from cloth_core.kernel import inlined_kernel, kernel
from cloth_core.mesh_topology import Representatives, representatives

__all__ = ["BodyContact", "ContactPairs", "keep_within_travel", "no_contact_pairs", "resolve_contacts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Share of the distance to the body that a particle may travel between two searches.
_TRAVEL = 0.9
# Sides and body corners are held off at this share of the vertices' offset: they only act where vertices cannot.
_SIDE_OFFSET_SHARE = 0.5
# A side contact counts from this many offsets on: one that rests at the offset must not come and go with rounding.
_SIDE_REACH = 1.02
# A vertex's contact planes are renewed when it has moved by this share of the offset.
_RENEWAL_SHARE = 0.05
_MOST_PLANES = 3
# Time in which cloth that is too near comes out, to 1/e [s].
_PUSH_TIME = 0.01
# Passes over contacts that share a particle.
_SWEEPS = 4


class ContactPairs(NamedTuple):
    """What one search found, and the contact planes that are derived from it while the cloth moves.

    Attributes:
        origin: positions at the search [m], (n, 3).
        travel: how far each particle may move from there [m], (n,).
        vertex_start: first entry of each particle in vertex_triangle, (n + 1,).
        vertex_triangle: body triangles within reach of each particle.
        sides: pairs of which neither part is a cloth vertex, (s, 5): three cloth particles and two body vertices. Cloth
            side against body side: the third particle is -1. Cloth triangle against body vertex: the last is -1.
        side_distance: their distance at the search [m], (s,).
        side_weight: where the closest point lies between the three particles, (s, 3).
        side_normal: unit normal from body to cloth, (s, 3).
        side_gap: distance to the offset before the step [m], (s,).
        side_impulse: what the contact gave in the last step along the normal, (s,) [N s], and
        side_friction: across it, (s, 3) [N s]; the next step starts from them.
        side_active: which entries are in contact; the first side_active_count[0] count, (s,).
        plane_count: contact planes of each particle, (n,); -1 before they are first computed.
        plane_normal: unit normals pointing away from the body, (n, 3, 3).
        plane_gap: distance to the offset surface at plane_at [m], (n, 3).
        plane_at: where the planes were computed [m], (n, 3).
    """

    origin: Floats
    travel: Floats
    vertex_start: Ints
    vertex_triangle: Ints
    sides: Ints
    side_distance: Floats
    side_weight: Floats
    side_normal: Floats
    side_gap: Floats
    side_impulse: Floats
    side_friction: Floats
    side_active: Ints
    side_active_count: Ints
    plane_count: Ints
    plane_normal: Floats
    plane_gap: Floats
    plane_at: Floats


class BodyContact:
    """Search for contacts between a garment's triangles and a body.

    Args:
        body: the obstacle.
        triangles: the cloth's, shape (m, 3); particles that are in none of them are not searched for.
        particle_count: n.
        offset: distance at which the cloth is held from the body [m].
    """

    def __init__(self, body: Body, triangles: Ints, particle_count: int, offset: float) -> None:
        self.body = body
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self.offset = offset
        self.side_offset = _SIDE_OFFSET_SHARE * offset
        self.searches = 0
        self._cloth = representatives(self.triangles)
        self._count = particle_count
        self._tree: AabbTree | None = None
        self._leaf_pairs = np.zeros((max(4 * len(triangles), 1024), 2), dtype=np.int32)

    def search(self, x: Floats, reach: float) -> ContactPairs:
        """Find all pairs that can come into contact while no particle moves more than reach [m] from x (n, 3)."""
        self.searches += 1
        if self._tree is None:
            self._tree = build_tree(x, self.triangles)
        query = self.offset + reach
        refit_tree(self._tree, x, self.triangles, query)
        found = overlapping_pairs(self.body.tree, self._tree, self._leaf_pairs)
        if found > len(self._leaf_pairs):
            self._leaf_pairs = np.zeros((found + found // 4, 2), dtype=np.int32)
            found = overlapping_pairs(self.body.tree, self._tree, self._leaf_pairs)
        vertex_pairs, sides, side_distance, gap = _narrow_phase(
            x, self.triangles, self._cloth, self.body.vertices, self.body.triangles, self.body.representatives,
            self._leaf_pairs[:found], query, self.side_offset + reach,
        )  # fmt: skip
        order = np.argsort(vertex_pairs[:, 0], kind="stable")
        start = np.searchsorted(vertex_pairs[order, 0], np.arange(self._count + 1)).astype(np.int32)
        return ContactPairs(
            origin=x.copy(),
            travel=np.minimum(_TRAVEL * gap, reach),
            vertex_start=start,
            vertex_triangle=np.ascontiguousarray(vertex_pairs[order, 1]),
            sides=sides,
            side_distance=side_distance,
            side_weight=np.zeros((len(sides), 3)),
            side_normal=np.zeros((len(sides), 3)),
            side_gap=np.zeros(len(sides)),
            side_impulse=np.zeros(len(sides)),
            side_friction=np.zeros((len(sides), 3)),
            side_active=np.zeros(len(sides), dtype=np.int32),
            side_active_count=np.zeros(1, dtype=np.int32),
            plane_count=np.full(self._count, -1, dtype=np.int32),
            plane_normal=np.zeros((self._count, _MOST_PLANES, 3)),
            plane_gap=np.zeros((self._count, _MOST_PLANES)),
            plane_at=np.zeros((self._count, 3)),
        )

    def crosses(self, x: Floats) -> bool:
        """Whether a side of the cloth at x (n, 3) [m] passes through the body or one of the body through the cloth."""
        body = self.body
        return bool(
            len(crossing_edges(x, self.triangles, body.vertices, body.triangles, body.tree))
            or len(crossing_edges(body.vertices, body.triangles, x, self.triangles))
        )


def no_contact_pairs() -> ContactPairs:
    """Pairs of a scene in which nothing can collide."""
    return ContactPairs(
        np.zeros((0, 3)), np.zeros(0), np.zeros(1, dtype=np.int32), np.zeros(0, dtype=np.int32),
        np.zeros((0, 5), dtype=np.int32), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0),
        np.zeros((0, 3)), np.zeros(0, dtype=np.int32), np.zeros(1, dtype=np.int32),
        np.zeros(0, dtype=np.int32), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3)),
    )  # fmt: skip


@kernel
def _narrow_phase(
    x: Floats,
    triangles: Ints,
    cloth: Representatives,
    body_x: Floats,
    body_triangles: Ints,
    body: Representatives,
    leaf_pairs: Ints,
    vertex_reach: float,
    side_reach: float,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Distances of all vertex-triangle, edge-edge and triangle-vertex pairs of the leaf pairs that are within reach.

    The last value is each particle's smallest distance [m], over all pairs that its triangles and sides are in; inf
    where there is none.
    """
    gap = np.full(x.shape[0], np.inf)
    vertex_pairs = np.empty((4096, 2), dtype=np.int32)
    sides = np.empty((4096, 5), dtype=np.int32)
    side_distance = np.empty(4096)
    vertex_count, side_count = 0, 0
    vertex_limit = vertex_reach * vertex_reach
    side_limit = side_reach * side_reach
    for pair in range(leaf_pairs.shape[0]):
        ct, bt = leaf_pairs[pair, 0], leaf_pairs[pair, 1]
        b0, b1, b2 = body_triangles[bt, 0], body_triangles[bt, 1], body_triangles[bt, 2]
        c0, c1, c2 = triangles[ct, 0], triangles[ct, 1], triangles[ct, 2]
        for k in range(3):
            if cloth.owns_vertex[ct, k]:
                i = triangles[ct, k]
                squared = point_triangle(x[i], body_x[b0], body_x[b1], body_x[b2])[0]
                if squared < vertex_limit:
                    gap[i] = min(gap[i], np.sqrt(squared))
                    if vertex_count == vertex_pairs.shape[0]:
                        vertex_pairs = _doubled(vertex_pairs)
                    vertex_pairs[vertex_count, 0] = i
                    vertex_pairs[vertex_count, 1] = bt
                    vertex_count += 1
            if body.owns_vertex[bt, k]:
                j = body_triangles[bt, k]
                squared = point_triangle(body_x[j], x[c0], x[c1], x[c2])[0]
                if squared < side_limit:
                    distance = np.sqrt(squared)
                    for c in (c0, c1, c2):
                        gap[c] = min(gap[c], distance)
                    sides, side_distance = _with_room(sides, side_distance, side_count)
                    for corner in range(3):
                        sides[side_count, corner] = triangles[ct, corner]
                    sides[side_count, 3] = j
                    sides[side_count, 4] = -1
                    side_distance[side_count] = distance
                    side_count += 1
            if cloth.owns_edge[ct, k]:
                p, q = triangles[ct, k], triangles[ct, (k + 1) % 3]
                for m in range(3):
                    if not body.owns_edge[bt, m]:
                        continue
                    a, b = body_triangles[bt, m], body_triangles[bt, (m + 1) % 3]
                    apart = False
                    for axis in range(3):
                        apart = apart or (
                            min(x[p, axis], x[q, axis]) - side_reach > max(body_x[a, axis], body_x[b, axis])
                            or min(body_x[a, axis], body_x[b, axis]) - side_reach > max(x[p, axis], x[q, axis])
                        )
                    if apart:
                        continue
                    squared = segment_segment(x[p], x[q], body_x[a], body_x[b])[0]
                    if squared < side_limit:
                        distance = np.sqrt(squared)
                        gap[p] = min(gap[p], distance)
                        gap[q] = min(gap[q], distance)
                        sides, side_distance = _with_room(sides, side_distance, side_count)
                        sides[side_count, 0] = p
                        sides[side_count, 1] = q
                        sides[side_count, 2] = -1
                        sides[side_count, 3] = a
                        sides[side_count, 4] = b
                        side_distance[side_count] = distance
                        side_count += 1
    return vertex_pairs[:vertex_count].copy(), sides[:side_count].copy(), side_distance[:side_count].copy(), gap


@kernel
def _with_room(sides: Ints, distance: Floats, count: int) -> tuple[Ints, Floats]:
    if count < sides.shape[0]:
        return sides, distance
    longer = np.empty(2 * count)
    for i in range(count):
        longer[i] = distance[i]
    return _doubled(sides), longer


@kernel
def _doubled(rows: Ints) -> Ints:
    longer = np.empty((2 * rows.shape[0], rows.shape[1]), dtype=np.int32)
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            longer[i, k] = rows[i, k]
    return longer


@kernel
def keep_within_travel(x: Floats, pairs: ContactPairs, moved: Floats) -> bool:
    """Stop every particle at its travel bound; fill moved (n,) [m]; whether any has used most of its bound."""
    spent = False
    for i in range(x.shape[0]):
        dx = x[i, 0] - pairs.origin[i, 0]
        dy = x[i, 1] - pairs.origin[i, 1]
        dz = x[i, 2] - pairs.origin[i, 2]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        bound = pairs.travel[i]
        if distance > 0.8 * bound:
            spent = True
            if distance > bound:
                share = bound / distance
                x[i, 0] = pairs.origin[i, 0] + share * dx
                x[i, 1] = pairs.origin[i, 1] + share * dy
                x[i, 2] = pairs.origin[i, 2] + share * dz
                distance = bound
        moved[i] = distance
    return spent


@kernel
def _renew_planes(
    i: int, x: Floats, pairs: ContactPairs, body_x: Floats, body_triangles: Ints, offset: float, slack: float
) -> None:
    """Contact planes of particle i: its nearest triangles within offset + slack, one for each direction."""
    count = 0
    for entry in range(pairs.vertex_start[i], pairs.vertex_start[i + 1]):
        t = pairs.vertex_triangle[entry]
        a, b, c = body_triangles[t, 0], body_triangles[t, 1], body_triangles[t, 2]
        squared, u, v, w = point_triangle(x[i], body_x[a], body_x[b], body_x[c])
        if squared > (offset + slack) ** 2 or squared < 1e-24:
            continue
        distance = np.sqrt(squared)
        nx = (x[i, 0] - u * body_x[a, 0] - v * body_x[b, 0] - w * body_x[c, 0]) / distance
        ny = (x[i, 1] - u * body_x[a, 1] - v * body_x[b, 1] - w * body_x[c, 1]) / distance
        nz = (x[i, 2] - u * body_x[a, 2] - v * body_x[b, 2] - w * body_x[c, 2]) / distance
        gap = distance - offset
        slot = -1
        for k in range(count):
            along = (
                nx * pairs.plane_normal[i, k, 0] + ny * pairs.plane_normal[i, k, 1] + nz * pairs.plane_normal[i, k, 2]
            )
            if along > 0.97:
                slot = k
                break
        if slot < 0 and count < _MOST_PLANES:
            slot = count
            count += 1
            pairs.plane_gap[i, slot] = np.inf
        if slot < 0:  # all in use: the one farthest away gives way to a nearer one
            slot = 0
            for k in range(1, _MOST_PLANES):
                if pairs.plane_gap[i, k] > pairs.plane_gap[i, slot]:
                    slot = k
        if gap < pairs.plane_gap[i, slot]:
            pairs.plane_gap[i, slot] = gap
            pairs.plane_normal[i, slot, 0] = nx
            pairs.plane_normal[i, slot, 1] = ny
            pairs.plane_normal[i, slot, 2] = nz
    pairs.plane_count[i] = count
    for axis in range(3):
        pairs.plane_at[i, axis] = x[i, axis]


@kernel
def resolve_contacts(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    pairs: ContactPairs,
    body_x: Floats,
    body_triangles: Ints,
    offset: float,
    side_offset: float,
    friction: float,
    push_speed: float,
    dt: float,
    moved: Floats,
) -> bool:
    """Hold the cloth off the body after a step, in place; whether a new search is due.

    A particle may not end the step nearer than the offset; one that starts nearer is pushed out at most at push_speed.

    Shapes: x, v (n, 3) [m, m/s]; inverse_mass, moved (n,); offsets [m]; push_speed [m/s]; dt [s].
    """
    _repeat_side_impulses(x, v, inverse_mass, pairs, dt)
    spent = keep_within_travel(x, pairs, moved)
    _hold_vertices(x, v, inverse_mass, pairs, body_x, body_triangles, offset, friction, push_speed, dt)
    _hold_sides(x, v, inverse_mass, pairs, body_x, side_offset, friction, push_speed, dt, moved)
    return spent


@kernel
def _hold_vertices(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    pairs: ContactPairs,
    body_x: Floats,
    body_triangles: Ints,
    offset: float,
    friction: float,
    push_speed: float,
    dt: float,
) -> None:
    """Cloth vertices against body triangles: each particle against its own contact planes."""
    renewal = _RENEWAL_SHARE * offset
    for i in range(x.shape[0]):
        if pairs.vertex_start[i] == pairs.vertex_start[i + 1] or inverse_mass[i] == 0.0:
            continue
        dx = x[i, 0] - pairs.plane_at[i, 0]
        dy = x[i, 1] - pairs.plane_at[i, 1]
        dz = x[i, 2] - pairs.plane_at[i, 2]
        if pairs.plane_count[i] < 0 or dx * dx + dy * dy + dz * dz > renewal * renewal:
            _renew_planes(i, x, pairs, body_x, body_triangles, offset, 2.0 * renewal)
        planes = pairs.plane_count[i]
        # One plane is settled in one go; in a crease the planes disturb each other.
        for _ in range(1 if planes == 1 else _SWEEPS):
            for k in range(planes):
                nx, ny, nz = pairs.plane_normal[i, k, 0], pairs.plane_normal[i, k, 1], pairs.plane_normal[i, k, 2]
                gap = (
                    pairs.plane_gap[i, k]
                    + nx * (x[i, 0] - pairs.plane_at[i, 0])
                    + ny * (x[i, 1] - pairs.plane_at[i, 1])
                    + nz * (x[i, 2] - pairs.plane_at[i, 2])
                )
                if gap >= 0.0:
                    continue
                approach = nx * v[i, 0] + ny * v[i, 1] + nz * v[i, 2]
                push = _push(gap, approach, push_speed, dt)
                if push <= 0.0:
                    continue
                stop = max(-approach, 0.0)
                tx, ty, tz = v[i, 0] - approach * nx, v[i, 1] - approach * ny, v[i, 2] - approach * nz
                slide = np.sqrt(tx * tx + ty * ty + tz * tz)
                hold = min(friction * stop / slide, 1.0) if slide > 0.0 else 0.0
                v[i, 0] += stop * nx - hold * tx
                v[i, 1] += stop * ny - hold * ty
                v[i, 2] += stop * nz - hold * tz
                x[i, 0] += push * nx - hold * tx * dt
                x[i, 1] += push * ny - hold * ty * dt
                x[i, 2] += push * nz - hold * tz * dt


@inlined_kernel
def _push(gap: float, approach: float, push_speed: float, dt: float) -> float:
    """How far to move along the normal [m]: back to where the step began, and if that is too near a little farther.

    What is too near comes out exponentially, at most at push_speed: a jump would stretch the springs and stir it up.
    """
    before = gap - dt * approach
    if before < 0.0:
        before += min(push_speed, -before / _PUSH_TIME) * dt
    return float(min(0.0, before) - gap)


@kernel
def _repeat_side_impulses(x: Floats, v: Floats, inverse_mass: Floats, pairs: ContactPairs, dt: float) -> None:
    """Give each side contact what it needed in the last step.

    Side contacts share particles, so that one pass over them does not settle them. Resting contacts need the same
    impulse in every step: started from the last one, they settle from step to step instead of within each.
    """
    impulse = np.zeros(3)
    for entry in range(pairs.side_active_count[0]):
        s = pairs.side_active[entry]
        for axis in range(3):
            impulse[axis] = pairs.side_impulse[s] * pairs.side_normal[s, axis] + pairs.side_friction[s, axis]
        _apply(x, v, inverse_mass, pairs, s, impulse, dt)


@kernel
def _apply(x: Floats, v: Floats, inverse_mass: Floats, pairs: ContactPairs, s: int, impulse: Floats, dt: float) -> None:
    """Apply an impulse (3,) [N s] at the closest point of side contact s."""
    for k in range(3):
        i = pairs.sides[s, k]
        if i < 0:
            continue
        share = pairs.side_weight[s, k] * inverse_mass[i]
        for axis in range(3):
            v[i, axis] += share * impulse[axis]
            x[i, axis] += share * impulse[axis] * dt


@kernel
def _hold_sides(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    pairs: ContactPairs,
    body_x: Floats,
    offset: float,
    friction: float,
    push_speed: float,
    dt: float,
    moved: Floats,
) -> None:
    """Cloth sides against body sides, cloth triangles against body vertices: sweeps of impulses that only push."""
    count = 0
    for s in range(pairs.sides.shape[0]):
        p, q, r = pairs.sides[s, 0], pairs.sides[s, 1], pairs.sides[s, 2]
        a, b = pairs.sides[s, 3], pairs.sides[s, 4]
        farthest = max(moved[p], moved[q])
        if r >= 0:
            farthest = max(farthest, moved[r])
        # Nothing can have come nearer than by the way that its particles went since the search.
        near = pairs.side_distance[s] - _SIDE_REACH * offset <= farthest
        squared = np.inf
        if near and r < 0:
            squared, along, other = segment_segment(x[p], x[q], body_x[a], body_x[b])
            pairs.side_weight[s, 0], pairs.side_weight[s, 1] = 1.0 - along, along
        elif near:
            squared, w0, w1, w2 = point_triangle(body_x[a], x[p], x[q], x[r])
            pairs.side_weight[s, 0], pairs.side_weight[s, 1], pairs.side_weight[s, 2] = w0, w1, w2
        if squared >= (_SIDE_REACH * offset) ** 2 or squared < 1e-24:
            pairs.side_impulse[s] = 0.0
            for axis in range(3):
                pairs.side_friction[s, axis] = 0.0
            continue
        distance = np.sqrt(squared)
        for axis in range(3):
            at = body_x[a, axis]
            if r < 0:
                at += other * (body_x[b, axis] - body_x[a, axis])
            point = pairs.side_weight[s, 0] * x[p, axis] + pairs.side_weight[s, 1] * x[q, axis]
            if r >= 0:
                point += pairs.side_weight[s, 2] * x[r, axis]
            pairs.side_normal[s, axis] = (point - at) / distance
        pairs.side_gap[s] = distance - offset - dt * _approach(v, pairs, s)
        pairs.side_active[count] = s
        count += 1
    pairs.side_active_count[0] = count
    velocity = np.zeros(3)
    impulse = np.zeros(3)
    for _ in range(_SWEEPS if count > 0 else 0):
        for entry in range(count):
            s = pairs.side_active[entry]
            compliance = 0.0
            for axis in range(3):
                velocity[axis] = 0.0
            for k in range(3):
                i = pairs.sides[s, k]
                if i >= 0:
                    compliance += pairs.side_weight[s, k] ** 2 * inverse_mass[i]
                    for axis in range(3):
                        velocity[axis] += pairs.side_weight[s, k] * v[i, axis]
            if compliance <= 0.0:
                continue
            approach = 0.0
            for axis in range(3):
                approach += velocity[axis] * pairs.side_normal[s, axis]
            # A gap that was still open may close within the step, no more.
            wanted = -max(pairs.side_gap[s], 0.0) / dt
            before = pairs.side_impulse[s]
            pairs.side_impulse[s] = max(before + (wanted - approach) / compliance, 0.0)
            size = 0.0
            for axis in range(3):
                across = velocity[axis] - approach * pairs.side_normal[s, axis]
                impulse[axis] = pairs.side_friction[s, axis] - across / compliance
                size += impulse[axis] * impulse[axis]
            size = np.sqrt(size)
            limit = friction * pairs.side_impulse[s]
            share = limit / size if size > limit else 1.0
            for axis in range(3):
                held = share * impulse[axis]
                change = held - pairs.side_friction[s, axis]
                pairs.side_friction[s, axis] = held
                impulse[axis] = change + (pairs.side_impulse[s] - before) * pairs.side_normal[s, axis]
            _apply(x, v, inverse_mass, pairs, s, impulse, dt)
    for entry in range(count):
        s = pairs.side_active[entry]
        if pairs.side_gap[s] >= 0.0:
            continue
        push = min(push_speed, -pairs.side_gap[s] / _PUSH_TIME) * dt
        compliance = 0.0
        for k in range(3):
            if pairs.sides[s, k] >= 0:
                compliance += pairs.side_weight[s, k] ** 2 * inverse_mass[pairs.sides[s, k]]
        if compliance <= 0.0:
            continue
        for k in range(3):
            i = pairs.sides[s, k]
            if i >= 0:
                share = pairs.side_weight[s, k] * inverse_mass[i] / compliance
                for axis in range(3):
                    x[i, axis] += share * push * pairs.side_normal[s, axis]


@inlined_kernel
def _approach(v: Floats, pairs: ContactPairs, s: int) -> float:
    """Normal velocity of the cloth's closest point of side contact s [m/s], negative towards the body."""
    speed = 0.0
    for k in range(3):
        i = pairs.sides[s, k]
        if i >= 0:
            for axis in range(3):
                speed += pairs.side_weight[s, k] * v[i, axis] * pairs.side_normal[s, axis]
    return speed
