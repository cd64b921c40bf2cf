"""Cloth against a body: the search for pairs, and cloth vertices held off the body's triangles by contact planes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, overlapping_pairs
from cloth_core.body import Body
from cloth_core.closest_points import outside_box, point_triangle, segment_segment
from cloth_core.errors import SceneError
from cloth_core.kernel import inlined_kernel, kernel
from cloth_core.mesh_topology import Representatives
from cloth_core.pair_contacts import BODY_SIDE, BODY_VERTEX, PUSH_TIME
from cloth_core.pair_list import doubled, doubled_lengths, write_pair

__all__ = ["BodyContact", "VertexPlanes", "hold_vertices", "vertex_body_gaps"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Sides and body corners are held off at this share of the vertices' offset: they only act where vertices cannot.
_SIDE_OFFSET_SHARE = 0.5
# A vertex's contact planes are renewed when it has moved by this share of the offset; it has some from twice this share
# beyond the offset on.
_RENEWAL_SHARE = 0.05
_MOST_PLANES = 3
# Pairs of triangles whose boxes overlap, in all and for each triangle of body and cloth: surfaces have a few each. More
# would take memory and time out of all proportion.
_MOST_PAIRS, _PAIRS_PER_TRIANGLE = 100_000, 16
# Passes over the planes of a particle in a crease.
_SWEEPS = 4


class VertexPlanes(NamedTuple):
    """Body triangles within reach of each particle, and the contact planes derived from them while the cloth moves.

    Attributes:
        start: first entry of each particle in body_triangle, (n + 1,).
        body_triangle: body triangles within reach.
        distance: to each of them at the broad phase [m].
        plane_count: contact planes of each particle, (n,); -1 before they are first computed.
        normal: unit normals pointing away from the body, (n, 3, 3).
        gap: distance to the offset surface at `at` [m], (n, 3).
        velocity: of the body at each plane's closest point [m/s], (n, 3, 3).
        at: where the planes were computed [m], (n, 3).
        renewal: squared way from there after which they are renewed [m^2], (n,).
    """

    start: Ints
    body_triangle: Ints
    distance: Floats
    plane_count: Ints
    normal: Floats
    gap: Floats
    velocity: Floats
    at: Floats
    renewal: Floats

    @classmethod
    def of(cls, particle_count: int, pairs: Ints, distance: Floats) -> VertexPlanes:
        """Planes still to be computed, from pairs (particle, body triangle), shape (k, 2), and their distances."""
        order = np.argsort(pairs[:, 0], kind="stable")
        start = np.searchsorted(pairs[order, 0], np.arange(particle_count + 1)).astype(np.int32)
        return cls(
            start,
            np.ascontiguousarray(pairs[order, 1]),
            np.ascontiguousarray(distance[order]),
            plane_count=np.full(particle_count, -1, dtype=np.int32),
            normal=np.zeros((particle_count, _MOST_PLANES, 3)),
            gap=np.zeros((particle_count, _MOST_PLANES)),
            velocity=np.zeros((particle_count, _MOST_PLANES, 3)),
            at=np.zeros((particle_count, 3)),
            renewal=np.zeros(particle_count),
        )


class BodyContact:
    """Search for candidates of contact between a garment's triangles and a body.

    Args:
        body: the obstacle.
        offset: distance at which cloth vertices are held from the body [m].
    """

    def __init__(self, body: Body, offset: float) -> None:
        self.body = body
        self.offset = offset
        self.side_offset = _SIDE_OFFSET_SHARE * offset
        self._leaf_pairs = np.zeros((4096, 2), dtype=np.int32)

    def candidates(
        self, x: Floats, triangles: Ints, cloth: Representatives, tree: AabbTree, radius: float | Floats
    ) -> tuple[VertexPlanes, Ints, Floats, Floats]:
        """All pairs that can come into contact while no particle moves farther than its radius from x (n, 3) [m].

        Args:
            x, triangles, cloth: positions [m], the cloth's triangles and who owns what.
            tree: of the cloth's triangles, its boxes enlarged by at least offset + radius.
            radius: [m], for all or for each particle, (n,).

        Returns:
            the vertex pairs; the other pairs as rows (s, 7), their offsets (s,) and distances (s,) [m].
        """
        most = _MOST_PAIRS + _PAIRS_PER_TRIANGLE * (len(triangles) + len(self.body.triangles))
        found = overlapping_pairs(self.body.tree, tree, self._leaf_pairs, most)
        if found > most:
            raise SceneError(
                f"body '{self.body.name}': too many of its triangles lie at the same place, more than {most} pairs "
                "with the cloth's; repair the mesh"
            )
        if found > len(self._leaf_pairs):
            self._leaf_pairs = np.zeros((found + found // 4, 2), dtype=np.int32)
            found = overlapping_pairs(self.body.tree, tree, self._leaf_pairs, most)
        radii = np.ascontiguousarray(np.broadcast_to(radius, len(x)), dtype=np.float64)
        vertex_pairs, vertex_distance, rows, distance = _candidates(
            x, triangles, cloth, self.body.vertices, self.body.triangles, self.body.representatives,
            self._leaf_pairs[:found], self.offset, self.side_offset, radii,
        )  # fmt: skip
        planes = VertexPlanes.of(len(x), vertex_pairs, vertex_distance)
        return planes, rows, np.full(len(rows), self.side_offset), distance


@kernel
def _candidates(
    x: Floats,
    triangles: Ints,
    cloth: Representatives,
    body_x: Floats,
    body_triangles: Ints,
    body: Representatives,
    leaf_pairs: Ints,
    vertex_offset: float,
    side_offset: float,
    radius: Floats,
) -> tuple[Ints, Floats, Ints, Floats]:
    """Vertex-triangle, edge-edge and triangle-vertex pairs within their offsets and the cloth's radii (n,) [m]."""
    vertex_pairs = np.empty((4096, 2), dtype=np.int32)
    vertex_distance = np.empty((4096, 1))
    sides = np.empty((4096, 7), dtype=np.int32)
    side_distance = np.empty((4096, 1))
    vertex_count, side_count = 0, 0
    for pair in range(leaf_pairs.shape[0]):
        ct, bt = leaf_pairs[pair, 0], leaf_pairs[pair, 1]
        b0, b1, b2 = body_triangles[bt, 0], body_triangles[bt, 1], body_triangles[bt, 2]
        c0, c1, c2 = triangles[ct, 0], triangles[ct, 1], triangles[ct, 2]
        corner_reach = side_offset + max(radius[c0], max(radius[c1], radius[c2]))
        if side_count + 12 > sides.shape[0]:
            sides, side_distance = doubled(sides), doubled_lengths(side_distance)
        if vertex_count + 3 > vertex_pairs.shape[0]:
            vertex_pairs, vertex_distance = doubled(vertex_pairs), doubled_lengths(vertex_distance)
        for k in range(3):
            i = triangles[ct, k]
            vertex_reach = vertex_offset + radius[i]
            if cloth.owns_vertex[ct, k] and not outside_box(x[i], body_x[b0], body_x[b1], body_x[b2], vertex_reach):
                squared = point_triangle(x[i], body_x[b0], body_x[b1], body_x[b2])[0]
                if squared < vertex_reach * vertex_reach:
                    vertex_pairs[vertex_count, 0] = i
                    vertex_pairs[vertex_count, 1] = bt
                    vertex_distance[vertex_count, 0] = np.sqrt(squared)
                    vertex_count += 1
            j = body_triangles[bt, k]
            if body.owns_vertex[bt, k] and not outside_box(body_x[j], x[c0], x[c1], x[c2], corner_reach):
                squared = point_triangle(body_x[j], x[c0], x[c1], x[c2])[0]
                if squared < corner_reach * corner_reach:
                    write_pair(sides, side_count, BODY_VERTEX, c0, c1, c2, -1, j, -1)
                    side_distance[side_count, 0] = np.sqrt(squared)
                    side_count += 1
            if cloth.owns_edge[ct, k]:
                p, q = triangles[ct, k], triangles[ct, (k + 1) % 3]
                side_reach = side_offset + max(radius[p], radius[q])
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
                    if squared < side_reach * side_reach:
                        write_pair(sides, side_count, BODY_SIDE, p, q, -1, -1, a, b)
                        side_distance[side_count, 0] = np.sqrt(squared)
                        side_count += 1
    return (
        vertex_pairs[:vertex_count].copy(),
        vertex_distance[:vertex_count, 0].copy(),
        sides[:side_count].copy(),
        side_distance[:side_count, 0].copy(),
    )


@kernel
def vertex_body_gaps(
    x: Floats, planes: VertexPlanes, body_x: Floats, body_triangles: Ints, moved: Floats, needed: Floats, gap: Floats
) -> None:
    """Lower each particle's gap (n,) [m] to its distance from the body's triangles, as far as that is below needed.

    moved (n,): way of each particle since the candidates were found [m]; needed (n,): a distance from which on it does
    not matter [m].
    """
    for i in range(x.shape[0]):
        for entry in range(planes.start[i], planes.start[i + 1]):
            if planes.distance[entry] - moved[i] >= min(needed[i], gap[i]):
                continue
            t = planes.body_triangle[entry]
            a, b, c = body_triangles[t, 0], body_triangles[t, 1], body_triangles[t, 2]
            gap[i] = min(gap[i], np.sqrt(point_triangle(x[i], body_x[a], body_x[b], body_x[c])[0]))


@kernel
def _renew_planes(
    i: int,
    x: Floats,
    planes: VertexPlanes,
    body_x: Floats,
    body_v: Floats,
    body_triangles: Ints,
    offset: float,
    renewal: float,
) -> None:
    """Contact planes of particle i: its nearest triangles a little beyond the offset, one for each direction.

    They hold until the particle has moved by `renewal` [m], and where there is none until it can have come to one.
    """
    count = 0
    slack = 2.0 * renewal
    clear = np.inf
    for entry in range(planes.start[i], planes.start[i + 1]):
        t = planes.body_triangle[entry]
        a, b, c = body_triangles[t, 0], body_triangles[t, 1], body_triangles[t, 2]
        squared, u, v, w = point_triangle(x[i], body_x[a], body_x[b], body_x[c])
        if squared < 1e-24:
            clear = 0.0
            continue
        if squared > (offset + slack) ** 2:
            clear = min(clear, squared)
            continue
        distance = np.sqrt(squared)
        nx = (x[i, 0] - u * body_x[a, 0] - v * body_x[b, 0] - w * body_x[c, 0]) / distance
        ny = (x[i, 1] - u * body_x[a, 1] - v * body_x[b, 1] - w * body_x[c, 1]) / distance
        nz = (x[i, 2] - u * body_x[a, 2] - v * body_x[b, 2] - w * body_x[c, 2]) / distance
        gap = distance - offset
        slot = -1
        for k in range(count):
            along = nx * planes.normal[i, k, 0] + ny * planes.normal[i, k, 1] + nz * planes.normal[i, k, 2]
            if along > 0.97:
                slot = k
                break
        if slot < 0 and count < _MOST_PLANES:
            slot = count
            count += 1
            planes.gap[i, slot] = np.inf
        if slot < 0:  # all in use: the one farthest away gives way to a nearer one
            slot = 0
            for k in range(1, _MOST_PLANES):
                if planes.gap[i, k] > planes.gap[i, slot]:
                    slot = k
        if gap < planes.gap[i, slot]:
            planes.gap[i, slot] = gap
            planes.normal[i, slot, 0] = nx
            planes.normal[i, slot, 1] = ny
            planes.normal[i, slot, 2] = nz
            for axis in range(3):
                planes.velocity[i, slot, axis] = u * body_v[a, axis] + v * body_v[b, axis] + w * body_v[c, axis]
    planes.plane_count[i] = count
    free = max(np.sqrt(clear) - offset, renewal) if count == 0 else renewal
    planes.renewal[i] = free * free
    for axis in range(3):
        planes.at[i, axis] = x[i, axis]


@kernel
def hold_vertices(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    planes: VertexPlanes,
    body_x: Floats,
    body_v: Floats,
    body_triangles: Ints,
    offset: float,
    friction: float,
    push_speed: float,
    dt: float,
) -> None:
    """Cloth vertices against body triangles: each particle against its own contact planes."""
    renewal = _RENEWAL_SHARE * offset
    for i in range(x.shape[0]):
        if planes.start[i] == planes.start[i + 1] or inverse_mass[i] == 0.0:
            continue
        dx = x[i, 0] - planes.at[i, 0]
        dy = x[i, 1] - planes.at[i, 1]
        dz = x[i, 2] - planes.at[i, 2]
        if planes.plane_count[i] < 0 or dx * dx + dy * dy + dz * dz > planes.renewal[i]:
            _renew_planes(i, x, planes, body_x, body_v, body_triangles, offset, renewal)
        held = planes.plane_count[i]
        # One plane is settled in one go; in a crease the planes disturb each other.
        for _ in range(1 if held == 1 else _SWEEPS):
            for k in range(held):
                nx, ny, nz = planes.normal[i, k, 0], planes.normal[i, k, 1], planes.normal[i, k, 2]
                gap = (
                    planes.gap[i, k]
                    + nx * (x[i, 0] - planes.at[i, 0])
                    + ny * (x[i, 1] - planes.at[i, 1])
                    + nz * (x[i, 2] - planes.at[i, 2])
                )
                if gap >= 0.0:
                    continue
                # Relative to the body, which may move.
                rx = v[i, 0] - planes.velocity[i, k, 0]
                ry = v[i, 1] - planes.velocity[i, k, 1]
                rz = v[i, 2] - planes.velocity[i, k, 2]
                approach = nx * rx + ny * ry + nz * rz
                push = _push(gap, approach, push_speed, dt)
                if push <= 0.0:
                    continue
                stop = max(-approach, 0.0)
                tx, ty, tz = rx - approach * nx, ry - approach * ny, rz - approach * nz
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
        before += min(push_speed, -before / PUSH_TIME) * dt
    return float(min(0.0, before) - gap)
