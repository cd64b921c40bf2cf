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

from cloth_core.kernel import kernel

__all__ = ["NEAR", "NearPlanes", "add_plane", "keep_on_own_side", "room_towards"]

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
# By how much a plane may be missed before the whole way of a particle is cut back [m].
_SLACK = 1e-12


class NearPlanes(NamedTuple):
    """Planes of particles that nearly touch something, k of them; a particle may have several.

    Attributes:
        particle: (k,).
        normal: unit vectors away from what is near, (k, 3).
        room: how far the particle may go against the normal from where it was at the search [m], (k,).
    """

    particle: Ints
    normal: Floats
    room: Floats

    @classmethod
    def none(cls) -> NearPlanes:
        """No planes."""
        return cls(np.zeros(0, dtype=np.int32), np.zeros((0, 3)), np.zeros(0))


@kernel
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


@kernel
def keep_on_own_side(x: Floats, v: Floats, origin: Floats, planes: NearPlanes) -> bool:
    """Stop particles at their planes, x and v (n, 3) in place; whether any has used up room that it had.

    origin: positions at the search [m], (n, 3).
    """
    spent = False
    for turn in range(2):
        for k in range(planes.particle.shape[0]):
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
                spent = spent or planes.room[k] > _NO_ROOM
            elif turn == 1 and excess > _SLACK:
                # Between several planes: back along its way, which keeps to all of them.
                share = planes.room[k] / towards
                x[i, 0] = origin[i, 0] + share * dx
                x[i, 1] = origin[i, 1] + share * dy
                x[i, 2] = origin[i, 2] + share * dz
    return spent
