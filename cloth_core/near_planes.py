"""What nearly touches: each particle may leave, but must stay on its own side of a plane between the two parts.

A bound on the way alone would let what is pinched get nearer by a share of the distance at each search, until rounding
decides on which side it is, and would make it tremble, stopped wherever it goes. So pairs that are this near do not
bound the way, but its direction (planar truncation, as in divide and truncate, Chen et al. 2025): towards the other
part each may go until the least distance is left, away from it and along it nothing is in the way. Both parts are
convex; a plane between them keeps them apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.pair_contacts import CLOTH_SIDE, CLOTH_VERTEX, PairContacts

__all__ = [
    "NEAR",
    "NearPlanes",
    "add_plane",
    "forget_planes",
    "keep_on_own_side",
    "put_plane",
    "room_of_pair",
    "room_towards",
    "side_of_pair",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Pairs nearer than this are kept apart by planes [m]: well below the distance at which layers are held apart, so that
# they only see to what is pressed together harder than that.
NEAR = 5e-4
# Distance that is left between them [m]: far more than rounding, far less than anything that shows.
_LEAST_DISTANCE = 1e-6
# Below this no direction can be told [m].
_TOO_NEAR = 1e-9
# Each of two parts may take this share of the room between them.
_SHARE = 0.45
# Room that a new search would not make more of [m].
_NO_ROOM = 1e-6
# Places for planes that are added later.
_SPARE = 64
# By how much a plane may be missed before the whole way of a particle is cut back [m].
_SLACK = 1e-12


class NearPlanes(NamedTuple):
    """Planes of particles that nearly touch something; a particle may have several. Rows beyond number[0] are spare.

    Attributes:
        particle: (k,).
        normal: unit vectors away from what is near, (k, 3).
        room: how far the particle may go against the normal from where it was at the search [m], (k,).
        used: whether it has gone that far, although there was room, (k,).
        number: of planes, (1,).
    """

    particle: Ints
    normal: Floats
    room: Floats
    used: NDArray[np.bool_]
    number: Ints

    @classmethod
    def of(cls, rows: Floats) -> NearPlanes:
        """Planes from rows of particle, normal and room, (k, 5); there is place for as many again, and some more."""
        count = len(rows)
        table = np.zeros((2 * count + _SPARE, 5))
        table[:count] = rows
        return cls(
            table[:, 0].astype(np.int32),
            np.ascontiguousarray(table[:, 1:4]),
            table[:, 4].copy(),
            np.zeros(len(table), dtype=np.bool_),
            np.array([count], dtype=np.int32),
        )

    @classmethod
    def none(cls) -> NearPlanes:
        """No planes."""
        return cls.of(np.zeros((0, 5)))


@borrowing_kernel
def room_towards(gap: float, distance: float) -> float:
    """How far each of two parts may go towards the other [m]; -1 if no plane can be put between them.

    gap: between the two parts along the line of their closest points, which are `distance` apart [m].
    """
    if distance < _TOO_NEAR or gap < 0.5 * distance:
        return -1.0
    return _SHARE * max(gap - _LEAST_DISTANCE, 0.0)


@kernel
def add_plane(planes: Floats, count: int, i: int, nx: float, ny: float, nz: float, room: float) -> Floats:
    """Write particle, normal and room as row `count` of planes (k, 5), which is returned, longer where it was full."""
    if count == planes.shape[0]:
        longer = np.empty((2 * count, 5))
        longer[:count] = planes
        planes = longer
    planes[count, 0] = i
    planes[count, 1] = nx
    planes[count, 2] = ny
    planes[count, 3] = nz
    planes[count, 4] = room
    return planes


@borrowing_kernel
def put_plane(planes: NearPlanes, i: int, nx: float, ny: float, nz: float, room: float) -> bool:
    """Add a plane of particle i with its normal and room [m]; False if there is no place for it."""
    at = planes.number[0]
    if at == planes.particle.shape[0]:
        return False
    planes.particle[at] = i
    planes.normal[at, 0], planes.normal[at, 1], planes.normal[at, 2] = nx, ny, nz
    planes.room[at] = room
    planes.used[at] = False
    planes.number[0] = at + 1
    return True


@borrowing_kernel
def forget_planes(planes: NearPlanes, i: int) -> None:
    """Remove the planes of particle i."""
    k = 0
    while k < planes.number[0]:
        if planes.particle[k] != i:
            k += 1
            continue
        last = planes.number[0] - 1
        planes.particle[k], planes.room[k], planes.used[k] = planes.particle[last], planes.room[last], planes.used[last]
        for axis in range(3):
            planes.normal[k, axis] = planes.normal[last, axis]
        planes.number[0] = last


@borrowing_kernel
def keep_on_own_side(x: Floats, v: Floats, origin: Floats, planes: NearPlanes) -> bool:
    """Stop particles at their planes, x and v (n, 3) in place; whether any has used up room that it had.

    origin: positions at the search [m], (n, 3).
    """
    spent = False
    for turn in range(2):
        for k in range(planes.number[0]):
            i = planes.particle[k]
            nx, ny, nz = planes.normal[k, 0], planes.normal[k, 1], planes.normal[k, 2]
            dx, dy, dz = x[i, 0] - origin[i, 0], x[i, 1] - origin[i, 1], x[i, 2] - origin[i, 2]
            towards = -(dx * nx + dy * ny + dz * nz)
            excess = towards - planes.room[k]
            if turn == 0 and excess > 0.0:
                # What moves along the plane goes on.
                x[i, 0] += excess * nx
                x[i, 1] += excess * ny
                x[i, 2] += excess * nz
                approach = -(v[i, 0] * nx + v[i, 1] * ny + v[i, 2] * nz)
                if approach > 0.0:
                    v[i, 0] += approach * nx
                    v[i, 1] += approach * ny
                    v[i, 2] += approach * nz
                if planes.room[k] > _NO_ROOM:
                    planes.used[k] = spent = True
            elif turn == 1 and excess > _SLACK:
                # Between several planes: back along its way, which keeps to all of them.
                share = planes.room[k] / towards
                x[i, 0] = origin[i, 0] + share * dx
                x[i, 1] = origin[i, 1] + share * dy
                x[i, 2] = origin[i, 2] + share * dz
    return spent


@borrowing_kernel
def side_of_pair(kind: int, k: int) -> float:
    """1 if particle k of a pair belongs to the first part, towards which its normal points, -1 if to the second."""
    if kind == CLOTH_SIDE:
        return 1.0 if k < 2 else -1.0
    if kind == CLOTH_VERTEX:
        return 1.0 if k < 1 else -1.0
    return 1.0


@borrowing_kernel
def room_of_pair(x: Floats, pairs: PairContacts, s: int, body_x: Floats, closest: Floats, distance: float) -> float:
    """How far each part of pair s may go towards the other [m], -1 if no plane can be put between them.

    closest (3,): vector between the closest points [m], `distance` long.
    """
    if distance == 0.0:
        return -1.0
    first, second = np.inf, -np.inf
    for k in range(4):
        i = pairs.particles[s, k]
        if i >= 0:
            height = (x[i, 0] * closest[0] + x[i, 1] * closest[1] + x[i, 2] * closest[2]) / distance
            if side_of_pair(pairs.kind[s], k) > 0.0:
                first = min(first, height)
            else:
                second = max(second, height)
    for k in range(2):
        i = pairs.body[s, k]
        if i >= 0:
            height = (body_x[i, 0] * closest[0] + body_x[i, 1] * closest[1] + body_x[i, 2] * closest[2]) / distance
            second = max(second, height)
    return float(room_towards(first - second, distance))
