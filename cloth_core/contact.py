"""Contact of cloth with a body: nothing can pass through, at any speed and time step.

*Search* (rarely): the double traversal of the AABB trees finds every vertex-triangle, triangle-vertex and edge-edge pair
within reach, and from their distances a bound on how far each particle may travel before the next search: less than
its distance to the body, so that it cannot have crossed (the displacement bound of offset geometric contact, Chen et
al. 2025; the body stands still, so the cloth may use nearly the whole gap).

*Response* (each step): a contact holds its particle at the offset by removing the approaching velocity, with Coulomb
friction bounded by the same impulse (Moreau's time stepping). There is no contact stiffness: the stable time step does
not depend on contact, a particle at rest stays at rest exactly, and nothing is ever pulled towards the body.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree, overlapping_pairs, refit_tree
from cloth_core.body import Body
from cloth_core.closest_points import point_triangle, segment_segment
from cloth_core.intersections import crossing_edges
from cloth_core.mesh_topology import Representatives, representatives

__all__ = ["BodyContact", "ContactPairs", "no_contact_pairs", "resolve_contacts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Share of the distance to the body that a particle may travel between two searches.
_TRAVEL = 0.9
# Sides and body corners are held off at this share of the vertices' offset: they only act where vertices cannot.
_SIDE_OFFSET_SHARE = 0.5
# A vertex's contact planes are renewed when it has moved by this share of the offset.
_RENEWAL_SHARE = 0.05
_MOST_PLANES = 3


class ContactPairs(NamedTuple):
    """What one search found, and the contact planes that are derived from it while the cloth moves.

    Attributes:
        origin: positions at the search [m], (n, 3).
        travel: how far each particle may move from there [m], (n,).
        vertex_start: first entry of each particle in vertex_triangle, (n + 1,).
        vertex_triangle: body triangles within reach of each particle.
        edges: cloth side (2 particles) and body side (2 vertices) within reach, (e, 4).
        edge_distance: their distance at the search [m], (e,).
        faces: cloth triangle (3 particles) and body vertex within reach, (f, 4).
        face_distance: their distance at the search [m], (f,).
        plane_count: contact planes of each particle, (n,); -1 before they are first computed.
        plane_normal: unit normals pointing away from the body, (n, 3, 3).
        plane_gap: distance to the offset surface at plane_at [m], (n, 3).
        plane_at: where the planes were computed [m], (n, 3).
    """

    origin: Floats
    travel: Floats
    vertex_start: Ints
    vertex_triangle: Ints
    edges: Ints
    edge_distance: Floats
    faces: Ints
    face_distance: Floats
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
        vertex_pairs, edges, edge_distance, faces, face_distance, gap = _narrow_phase(
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
            edges=edges,
            edge_distance=edge_distance,
            faces=faces,
            face_distance=face_distance,
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
        np.zeros((0, 4), dtype=np.int32), np.zeros(0), np.zeros((0, 4), dtype=np.int32), np.zeros(0),
        np.zeros(0, dtype=np.int32), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3)),
    )  # fmt: skip


@njit(cache=True, nogil=True)
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
) -> tuple[Ints, Ints, Floats, Ints, Floats, Floats]:
    """Distances of all vertex-triangle, edge-edge and triangle-vertex pairs of the leaf pairs that are within reach.

    The last value is each particle's smallest distance [m], over all pairs that its triangles and sides are in; inf
    where there is none.
    """
    gap = np.full(x.shape[0], np.inf)
    vertex_pairs = np.empty((4096, 2), dtype=np.int32)
    edges = np.empty((4096, 4), dtype=np.int32)
    edge_distance = np.empty(4096)
    faces = np.empty((1024, 4), dtype=np.int32)
    face_distance = np.empty(1024)
    vertex_count, edge_count, face_count = 0, 0, 0
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
                        vertex_pairs = np.concatenate((vertex_pairs, np.empty_like(vertex_pairs)))
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
                    if face_count == faces.shape[0]:
                        faces = np.concatenate((faces, np.empty_like(faces)))
                        face_distance = np.concatenate((face_distance, np.empty_like(face_distance)))
                    faces[face_count, 0] = c0
                    faces[face_count, 1] = c1
                    faces[face_count, 2] = c2
                    faces[face_count, 3] = j
                    face_distance[face_count] = distance
                    face_count += 1
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
                        if edge_count == edges.shape[0]:
                            edges = np.concatenate((edges, np.empty_like(edges)))
                            edge_distance = np.concatenate((edge_distance, np.empty_like(edge_distance)))
                        edges[edge_count, 0] = p
                        edges[edge_count, 1] = q
                        edges[edge_count, 2] = a
                        edges[edge_count, 3] = b
                        edge_distance[edge_count] = distance
                        edge_count += 1
    return (
        vertex_pairs[:vertex_count].copy(),
        edges[:edge_count].copy(),
        edge_distance[:edge_count].copy(),
        faces[:face_count].copy(),
        face_distance[:face_count].copy(),
        gap,
    )


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
            along = nx * pairs.plane_normal[i, k, 0] + ny * pairs.plane_normal[i, k, 1] + nz * pairs.plane_normal[i, k, 2]
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
    pairs.plane_at[i] = x[i]


@njit(cache=True, nogil=True)
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
    spent = keep_within_travel(x, pairs, moved)
    renewal = _RENEWAL_SHARE * offset
    for i in range(x.shape[0]):
        if pairs.vertex_start[i] == pairs.vertex_start[i + 1] or inverse_mass[i] == 0.0:
            continue
        dx = x[i, 0] - pairs.plane_at[i, 0]
        dy = x[i, 1] - pairs.plane_at[i, 1]
        dz = x[i, 2] - pairs.plane_at[i, 2]
        if pairs.plane_count[i] < 0 or dx * dx + dy * dy + dz * dz > renewal * renewal:
            _renew_planes(i, x, pairs, body_x, body_triangles, offset, 2.0 * renewal)
            dx, dy, dz = 0.0, 0.0, 0.0
        for k in range(pairs.plane_count[i]):
            nx, ny, nz = pairs.plane_normal[i, k, 0], pairs.plane_normal[i, k, 1], pairs.plane_normal[i, k, 2]
            gap = pairs.plane_gap[i, k] + nx * dx + ny * dy + nz * dz
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
            for axis in range(3):
                n = pairs.plane_normal[i, k, axis]
                t = tx if axis == 0 else (ty if axis == 1 else tz)
                v[i, axis] += stop * n - hold * t
                x[i, axis] += push * n - hold * t * dt
            dx = x[i, 0] - pairs.plane_at[i, 0]
            dy = x[i, 1] - pairs.plane_at[i, 1]
            dz = x[i, 2] - pairs.plane_at[i, 2]
    weight = np.zeros(3)
    index = np.zeros(3, dtype=np.int64)
    at = np.zeros(3)
    for e in range(pairs.edges.shape[0]):
        p, q, a, b = pairs.edges[e, 0], pairs.edges[e, 1], pairs.edges[e, 2], pairs.edges[e, 3]
        if pairs.edge_distance[e] - side_offset > max(moved[p], moved[q]):
            continue
        squared, s, t = segment_segment(x[p], x[q], body_x[a], body_x[b])
        if squared >= side_offset * side_offset or squared < 1e-24:
            continue
        index[0], index[1] = p, q
        weight[0], weight[1] = 1.0 - s, s
        for axis in range(3):
            at[axis] = body_x[a, axis] + t * (body_x[b, axis] - body_x[a, axis])
        _hold_off(x, v, inverse_mass, index, weight, 2, at, np.sqrt(squared), side_offset, friction, push_speed, dt)
    for f in range(pairs.faces.shape[0]):
        p, q, r, j = pairs.faces[f, 0], pairs.faces[f, 1], pairs.faces[f, 2], pairs.faces[f, 3]
        if pairs.face_distance[f] - side_offset > max(moved[p], max(moved[q], moved[r])):
            continue
        squared, w0, w1, w2 = point_triangle(body_x[j], x[p], x[q], x[r])
        if squared >= side_offset * side_offset or squared < 1e-24:
            continue
        index[0], index[1], index[2] = p, q, r
        weight[0], weight[1], weight[2] = w0, w1, w2
        _hold_off(
            x, v, inverse_mass, index, weight, 3, body_x[j], np.sqrt(squared), side_offset, friction, push_speed, dt
        )
    return keep_within_travel(x, pairs, moved) or spent


@njit(cache=True, nogil=True, inline="always")
def _push(gap: float, approach: float, push_speed: float, dt: float) -> float:
    """How far to move along the normal [m]: back to the offset, or as far out as push_speed allows."""
    before = gap - dt * approach
    return float(min(0.0, before + push_speed * dt if before < 0.0 else 0.0) - gap)


@njit(cache=True, nogil=True)
def _hold_off(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    index: NDArray[np.int64],
    weight: Floats,
    count: int,
    at: Floats,
    distance: float,
    offset: float,
    friction: float,
    push_speed: float,
    dt: float,
) -> None:
    """One contact between the point sum weight_k x[index_k] of the cloth and the point `at` of the body."""
    normal = np.zeros(3)
    velocity = np.zeros(3)
    compliance = 0.0
    for k in range(count):
        compliance += weight[k] * weight[k] * inverse_mass[index[k]]
        for axis in range(3):
            normal[axis] += weight[k] * x[index[k], axis]
            velocity[axis] += weight[k] * v[index[k], axis]
    if compliance <= 0.0:
        return
    approach = 0.0
    for axis in range(3):
        normal[axis] = (normal[axis] - at[axis]) / distance
        approach += normal[axis] * velocity[axis]
    push = _push(distance - offset, approach, push_speed, dt)
    if push <= 0.0:
        return
    stop = max(-approach, 0.0)
    slide = 0.0
    for axis in range(3):
        velocity[axis] -= approach * normal[axis]
        slide += velocity[axis] * velocity[axis]
    slide = np.sqrt(slide)
    hold = min(friction * stop / slide, 1.0) if slide > 0.0 else 0.0
    for k in range(count):
        share = weight[k] * inverse_mass[index[k]] / compliance
        for axis in range(3):
            v[index[k], axis] += share * (stop * normal[axis] - hold * velocity[axis])
            x[index[k], axis] += share * (push * normal[axis] - hold * velocity[axis] * dt)
