"""Cloth against a body: the search for pairs, and cloth vertices held off the body's triangles by contact planes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, overlapping_pairs
from cloth_core.body import Body
from cloth_core.boxes import ROW, edge_boxes, in_box, overlap, put_edge_box, put_triangle_box, triangle_boxes
from cloth_core.closest_points import away_from_triangle, point_triangle
from cloth_core.errors import SceneError
from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel
from cloth_core.mesh_topology import Representatives
from cloth_core.near_distances import point_triangle_distances, segment_distances
from cloth_core.pair_contacts import BODY_SIDE, BODY_VERTEX, PUSH_TIME
from cloth_core.pair_list import PairRoom, write_pair
from cloth_core.reachable_tree import ReachableTree

__all__ = ["BodyContact", "VertexPlanes", "arm", "hold_vertices", "vertex_body_gaps"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Sides and body corners are held off at this share of the vertices' offset: they only act where vertices cannot.
_SIDE_OFFSET_SHARE = 0.5
# A vertex's contact planes are renewed when it has moved by this share of the offset; it has some from twice this share
# beyond the offset on.
_RENEWAL_SHARE = 0.05
_MOST_PLANES = 3
# Where in a plane's row its gap and its velocity are, behind its normal.
_GAP, _VELOCITY = 3, 4
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
        plane: of each the unit normal away from the body, the distance to the offset surface at `at` [m] and the
            velocity of the body at its closest point [m/s], side by side, (n, 3, 7).
        at: where the planes were computed [m], and the squared way from there after which they are renewed [m^2],
            (n, 4).
        armed: particles that can come to the offset surface before the next search; the first armed_count[0] count.
        is_armed: whether each is one of them, (n,).
    """

    start: Ints
    body_triangle: Ints
    distance: Floats
    plane_count: Ints
    plane: Floats
    at: Floats
    armed: Ints
    armed_count: Ints
    is_armed: NDArray[np.bool_]

    @classmethod
    def of(cls, particle_count: int, pairs: Ints, distance: Floats) -> VertexPlanes:
        """Planes still to be computed, from pairs (particle, body triangle), shape (k, 2), and their distances."""
        return cls(
            *_by_particle(particle_count, pairs, distance),
            plane_count=np.full(particle_count, -1, dtype=np.int32),
            plane=np.zeros((particle_count, _MOST_PLANES, 7)),
            at=np.zeros((particle_count, 4)),
            armed=np.zeros(particle_count, dtype=np.int32),
            armed_count=np.zeros(1, dtype=np.int32),
            is_armed=np.zeros(particle_count, dtype=np.bool_),
        )

    @classmethod
    def none(cls, particle_count: int) -> VertexPlanes:
        """Where there is no body."""
        return cls.of(particle_count, np.zeros((0, 2), dtype=np.int32), np.zeros(0))

    def arm_all(self) -> None:
        """Take all that has triangles within reach for what can come to the offset surface."""
        has = np.diff(self.start) > 0
        self.is_armed[:] = has
        self.armed_count[0] = has.sum()
        self.armed[: has.sum()] = np.flatnonzero(has)


@kernel
def _by_particle(particle_count: int, pairs: Ints, distance: Floats) -> tuple[Ints, Ints, Floats]:
    """Start (n + 1,) of each particle's entries, in the order of pairs (k, 2); their triangles and distances (k,)."""
    start = np.zeros(particle_count + 1, dtype=np.int32)
    for pair in range(pairs.shape[0]):
        start[pairs[pair, 0] + 1] += 1
    for i in range(particle_count):
        start[i + 1] += start[i]
    place = start.copy()
    triangle, sorted_distance = np.empty(pairs.shape[0], dtype=np.int32), np.empty(pairs.shape[0])
    for pair in range(pairs.shape[0]):
        i = pairs[pair, 0]
        triangle[place[i]], sorted_distance[place[i]] = pairs[pair, 1], distance[pair]
        place[i] += 1
    return start, triangle, sorted_distance


class BodyContact:
    """Search for candidates of contact between a garment's triangles and a body.

    Args:
        body: the obstacle.
        offset: distance at which cloth vertices are held from the body [m].

    Attributes:
        reachable: the part of the body's tree that is searched.
    """

    def __init__(self, body: Body, offset: float) -> None:
        self.body = body
        self.offset = offset
        self.reachable = ReachableTree()
        self.side_offset = _SIDE_OFFSET_SHARE * offset
        self._leaf_pairs = np.zeros((4096, 2), dtype=np.int32)
        self._boxes = _BodyBoxes.of(body)
        self._boxes_of = body

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
        body_tree = self.reachable.of(self.body.tree, tree.lower[0], tree.upper[0])
        found = overlapping_pairs(body_tree, tree, self._leaf_pairs, most)
        if found > most:
            raise SceneError(
                f"body '{self.body.name}': too many of its triangles lie at the same place, more than {most} pairs "
                "with the cloth's; repair the mesh"
            )
        if found > len(self._leaf_pairs):
            self._leaf_pairs = np.zeros((found + found // 4, 2), dtype=np.int32)
            found = overlapping_pairs(body_tree, tree, self._leaf_pairs, most)
        body = self.body
        body_x, own = body.vertices, body.representatives
        margin = np.array(np.broadcast_to(self.side_offset + radius, len(x)))
        cloth_triangles, cloth_edges = triangle_boxes(x, triangles, margin), edge_boxes(x, cloth.edges, margin)
        reach = margin + (self.offset - self.side_offset)
        rooms = PairRoom(3), PairRoom(3), PairRoom(9)
        done = 0
        while done < found:
            for room in rooms:
                room.make_room()
            done = _box_pairs(
                x, reach, cloth, cloth_triangles, cloth_edges, body_x, body.triangles, own, self._body_boxes(),
                self._leaf_pairs[:found], done, *(room.pairs for room in rooms), *(room.count for room in rooms),
            )  # fmt: skip
        vertices, corners, sides = (room.found for room in rooms)
        distance = point_triangle_distances(x, body_x, body.triangles, vertices)
        near = distance < reach[vertices[:, 0]]
        planes = VertexPlanes.of(len(x), vertices[near], distance[near])
        rows, distance = _near_pairs(
            corners, point_triangle_distances(body_x, x, triangles, corners), triangles, cloth_triangles,
            sides, segment_distances(x, cloth.edges, body_x, own.edges, sides), cloth.edges, cloth_edges, own.edges,
        )  # fmt: skip
        return planes, rows, np.full(len(rows), self.side_offset), distance

    def _body_boxes(self) -> _BodyBoxes:
        """Boxes of what has been near of the body so far, as long as it stays where it is."""
        if self._boxes_of is not self.body:
            self._boxes.made[:] = False
            self._boxes_of = self.body
        return self._boxes


class _BodyBoxes(NamedTuple):
    """Boxes of a body's triangles and of the sides that they own, made for those that the search comes near to.

    Attributes:
        triangles, edges: (t, 8) and (e, 8), as from `cloth_core.boxes`.
        made: whether those of a triangle have been, (t,).
    """

    triangles: Floats
    edges: Floats
    made: NDArray[np.bool_]

    @classmethod
    def of(cls, body: Body) -> _BodyBoxes:
        """None is made yet."""
        triangles, edges = len(body.triangles), len(body.representatives.edges)
        return cls(np.empty((triangles, ROW)), np.empty((edges, ROW)), np.zeros(triangles, dtype=np.bool_))


@borrowing_kernel
def _make_boxes(boxes: _BodyBoxes, t: int, x: Floats, triangles: Ints, body: Representatives) -> None:
    """Those of triangle t of a body with vertices x (b, 3) [m]."""
    put_triangle_box(boxes.triangles, t, x, triangles, 0.0)
    for k in range(body.own_edges[t, 0]):
        put_edge_box(boxes.edges, body.own_edges[t, 1 + k], x, body.edges, 0.0)
    boxes.made[t] = True


@borrowing_kernel
def _box_pairs(
    x: Floats,
    margin: Floats,
    cloth: Representatives,
    cloth_triangles: Floats,
    cloth_edges: Floats,
    body_x: Floats,
    body_triangles: Ints,
    body: Representatives,
    boxes: _BodyBoxes,
    leaf_pairs: Ints,
    first: int,
    vertices: Ints,
    corners: Ints,
    sides: Ints,
    vertices_found: Ints,
    corners_found: Ints,
    sides_found: Ints,
) -> int:
    """Whose boxes overlap in pairs of triangles (p, 2): each twice the index of what the cloth and the body have there.

    Shapes: x (n, 3) and margin (n,) of the cloth's vertices [m]; boxes of its triangles and sides (any, 8).

    (cloth vertex, body triangle), (body vertex, cloth triangle) and (cloth side, body side) are added to vertices,
    corners and sides, (any, 2); the numbers of those found, (1,) each, count them. Begins with pair `first`, and ends
    when it has no room for those of another one.

    Returns:
        the pair that is next.
    """
    vertex_count, corner_count, side_count = vertices_found[0], corners_found[0], sides_found[0]
    next_pair: int = leaf_pairs.shape[0]
    for pair in range(first, leaf_pairs.shape[0]):
        full = vertex_count + 3 > vertices.shape[0] or corner_count + 3 > corners.shape[0]
        if full or side_count + 9 > sides.shape[0]:
            next_pair = pair
            break
        ct, bt = leaf_pairs[pair, 0], leaf_pairs[pair, 1]
        if not boxes.made[bt]:
            _make_boxes(boxes, bt, body_x, body_triangles, body)
        for k in range(cloth.own_vertices[ct, 0]):
            i = cloth.own_vertices[ct, 1 + k]
            vertices[vertex_count, 0], vertices[vertex_count, 1] = i, bt
            vertex_count += in_box(x, i, margin[i], boxes.triangles, bt)
        for k in range(body.own_vertices[bt, 0]):
            j = body.own_vertices[bt, 1 + k]
            corners[corner_count, 0], corners[corner_count, 1] = j, ct
            corner_count += in_box(body_x, j, 0.0, cloth_triangles, ct)
        for k in range(cloth.own_edges[ct, 0]):
            i = cloth.own_edges[ct, 1 + k]
            for m in range(body.own_edges[bt, 0]):
                j = body.own_edges[bt, 1 + m]
                sides[side_count, 0], sides[side_count, 1] = i, j
                side_count += overlap(cloth_edges, i, boxes.edges, j)
    vertices_found[0], corners_found[0], sides_found[0] = vertex_count, corner_count, side_count
    return next_pair


@kernel
def _near_pairs(
    corners: Ints,
    corner_distance: Floats,
    triangles: Ints,
    cloth_triangles: Floats,
    sides: Ints,
    side_distance: Floats,
    edges: Ints,
    cloth_edges: Floats,
    body_edges: Ints,
) -> tuple[Ints, Floats]:
    """Rows (s, 7) and distances (s,) [m] of those pairs of corners and sides that are within the margin of a box."""
    rows = np.empty((corners.shape[0] + sides.shape[0], 7), dtype=np.int32)
    distance = np.empty(rows.shape[0])
    count = 0
    for pair in range(corners.shape[0]):
        j, t = corners[pair, 0], corners[pair, 1]
        if corner_distance[pair] < cloth_triangles[t, 6]:
            write_pair(rows, count, BODY_VERTEX, triangles[t, 0], triangles[t, 1], triangles[t, 2], -1, j, -1)
            distance[count] = corner_distance[pair]
            count += 1
    for pair in range(sides.shape[0]):
        i, j = sides[pair, 0], sides[pair, 1]
        if side_distance[pair] < cloth_edges[i, 6]:
            write_pair(rows, count, BODY_SIDE, edges[i, 0], edges[i, 1], -1, -1, body_edges[j, 0], body_edges[j, 1])
            distance[count] = side_distance[pair]
            count += 1
    return rows[:count].copy(), distance[:count].copy()


@borrowing_kernel
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


@borrowing_kernel
def arm(planes: VertexPlanes, i: int) -> None:
    """Let particle i be one that can come to the offset surface."""
    if not planes.is_armed[i]:
        planes.is_armed[i] = True
        planes.armed[planes.armed_count[0]] = i
        planes.armed_count[0] += 1


@borrowing_kernel
def _renew_planes(
    i: int,
    x: Floats,
    planes: VertexPlanes,
    body_x: Floats,
    body_v: Floats,
    body_triangles: Ints,
    body_way: float,
    offset: float,
    renewal: float,
) -> None:
    """Contact planes of particle i: its nearest triangles a little beyond the offset, one for each direction.

    They hold until the particle has moved by `renewal` [m], and where there is none until it can have come to one while
    the body moves by body_way [m].
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
        nx, ny, nz = away_from_triangle(x[i], body_x[a], body_x[b], body_x[c], u, v, w, distance)
        gap = distance - offset
        slot = -1
        for k in range(count):
            along = nx * planes.plane[i, k, 0] + ny * planes.plane[i, k, 1] + nz * planes.plane[i, k, 2]
            if along > 0.97:
                slot = k
                break
        if slot < 0 and count < _MOST_PLANES:
            slot = count
            count += 1
            planes.plane[i, slot, _GAP] = np.inf
        if slot < 0:  # all in use: the one farthest away gives way to a nearer one
            slot = 0
            for k in range(1, _MOST_PLANES):
                if planes.plane[i, k, _GAP] > planes.plane[i, slot, _GAP]:
                    slot = k
        if gap < planes.plane[i, slot, _GAP]:
            plane = planes.plane[i, slot]
            plane[0], plane[1], plane[2], plane[_GAP] = nx, ny, nz, gap
            for axis in range(3):
                plane[_VELOCITY + axis] = u * body_v[a, axis] + v * body_v[b, axis] + w * body_v[c, axis]
    planes.plane_count[i] = count
    free = max(np.sqrt(clear) - offset - body_way, renewal) if count == 0 else renewal
    for axis in range(3):
        planes.at[i, axis] = x[i, axis]
    planes.at[i, 3] = free * free


@borrowing_kernel
def hold_vertices(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    planes: VertexPlanes,
    body_x: Floats,
    body_v: Floats,
    body_triangles: Ints,
    body_way: float,
    offset: float,
    friction: float,
    push_speed: float,
    dt: float,
) -> None:
    """Cloth vertices against body triangles: each armed particle against its own contact planes."""
    renewal = _RENEWAL_SHARE * offset
    for entry in range(planes.armed_count[0]):
        i = planes.armed[entry]
        if inverse_mass[i] == 0.0:
            continue
        px, py, pz = x[i, 0], x[i, 1], x[i, 2]
        dx, dy, dz = px - planes.at[i, 0], py - planes.at[i, 1], pz - planes.at[i, 2]
        if planes.plane_count[i] < 0 or dx * dx + dy * dy + dz * dz > planes.at[i, 3]:
            _renew_planes(i, x, planes, body_x, body_v, body_triangles, body_way, offset, renewal)
        held = planes.plane_count[i]
        if held == 0:
            continue
        ax, ay, az = planes.at[i, 0], planes.at[i, 1], planes.at[i, 2]
        # One plane is settled in one go; in a crease the planes disturb each other.
        for _ in range(1 if held == 1 else _SWEEPS):
            for k in range(held):
                plane = planes.plane[i, k]
                nx, ny, nz = plane[0], plane[1], plane[2]
                gap = plane[_GAP] + nx * (px - ax) + ny * (py - ay) + nz * (pz - az)
                if gap >= 0.0:
                    continue
                # Relative to the body, which may move.
                rx, ry, rz = v[i, 0] - plane[_VELOCITY], v[i, 1] - plane[_VELOCITY + 1], v[i, 2] - plane[_VELOCITY + 2]
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
                px += push * nx - hold * tx * dt
                py += push * ny - hold * ty * dt
                pz += push * nz - hold * tz * dt
        x[i, 0], x[i, 1], x[i, 2] = px, py, pz


@borrowing_kernel
def carry_planes(planes: VertexPlanes, dt: float) -> None:
    """Take the contact planes on by the way that the body's surface goes in a step of dt [s]."""
    for entry in range(planes.armed_count[0]):
        i = planes.armed[entry]
        for k in range(planes.plane_count[i]):
            plane = planes.plane[i, k]
            along = plane[0] * plane[_VELOCITY] + plane[1] * plane[_VELOCITY + 1] + plane[2] * plane[_VELOCITY + 2]
            plane[_GAP] -= dt * along


@inlined_kernel
def _push(gap: float, approach: float, push_speed: float, dt: float) -> float:
    """How far to move along the normal [m]: back to where the step began, and if that is too near a little farther.

    What is too near comes out exponentially, at most at push_speed: a jump would stretch the springs and stir it up.
    """
    before = gap - dt * approach
    if before < 0.0:
        before += min(push_speed, -before / PUSH_TIME) * dt
    return float(min(0.0, before) - gap)
