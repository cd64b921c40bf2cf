"""Cloth triangles that a plane separates from all of the body near them.

What is held off a smooth body by its vertices cannot touch it with its sides, and no corner of the body reaches its
faces: a triangle is the convex hull of its corners, so it stays as far from the body as these stay above a plane that
has all of the body near it below. Such a triangle is left out of the search for sides and corners. None of its corners
may travel so far that sides would count there, so that nothing is missed: cloth moves as if all pairs were known. Where
that leaves a corner too little way another plane is looked for, and where there is none, sides and corners are looked
at again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel

__all__ = [
    "SeparatingPlanes",
    "find_plane",
    "given_up",
    "height_above_plane",
    "height_above_planes",
    "pairs_near",
    "separate",
    "triangles_of_particles",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# A plane must leave each corner this share of the way that it wants to go: enough for a few steps, so that planes make
# no step shorter and stop nobody.
_LEAST_SHARE = 0.1
# The same, and how much higher than that its corners must be, as a share, where a plane is put at first: one that is
# given up soon costs more than it saves.
_SHARE, _HIGHER = 0.3, 3.0


class SeparatingPlanes(NamedTuple):
    """Planes between triangles of the cloth and the body.

    Attributes:
        separated: whether there is one, (m,).
        normal: unit vector away from the body, (m, 3); level: the body near the triangle is where normal . b is at most
            this [m], (m,).
        lowest: height above a plane from which on sides count [m]; no corner comes as low as that.
        high: height that all corners must have at least [m].
        corners: of the triangles, (m, 3).
        start, entries: the triangles of particle i are entries[start[i] : start[i + 1]].
        near_start, near: the body's triangles near triangle t are near[near_start[t] : near_start[t + 1]].
        lost: room for triangles, (m,).
    """

    separated: NDArray[np.bool_]
    normal: Floats
    level: Floats
    lowest: float
    high: float
    corners: Ints
    start: Ints
    entries: Ints
    near_start: Ints
    near: Ints
    lost: Ints

    @classmethod
    def none(cls, corners: Ints) -> SeparatingPlanes:
        """No plane for any of the triangles, of corners (m, 3)."""
        count = len(corners)
        return cls(
            np.zeros(count, dtype=np.bool_), np.zeros((count, 3)), np.zeros(count), 0.0, 0.0, corners,
            *triangles_of_particles(corners, int(corners.max()) + 1 if count else 0),
            np.zeros(count + 1, dtype=np.int32), np.zeros(0, dtype=np.int32), np.zeros(count, dtype=np.int32),
        )  # fmt: skip

    def cleared(self) -> SeparatingPlanes:
        """No plane for any of the same triangles, in arrays of its own."""
        count = len(self.corners)
        return self._replace(
            separated=np.zeros(count, dtype=np.bool_), normal=np.zeros((count, 3)), level=np.zeros(count),
            near_start=np.zeros(count + 1, dtype=np.int32), near=np.zeros(0, dtype=np.int32),
        )  # fmt: skip


@kernel
def triangles_of_particles(corners: Ints, count: int) -> tuple[Ints, Ints]:
    """Which triangles (m, 3) each of `count` particles belongs to.

    Returns:
        start (count + 1,) and entries: those of particle i are entries[start[i] : start[i + 1]].
    """
    start = np.zeros(count + 2, dtype=np.int32)
    for t in range(corners.shape[0]):
        for k in range(3):
            start[corners[t, k] + 2] += 1
    for i in range(count):
        start[i + 2] += start[i + 1]
    entries = np.empty(3 * corners.shape[0], dtype=np.int32)
    for t in range(corners.shape[0]):
        for k in range(3):
            i = corners[t, k]
            entries[start[i + 1]] = t
            start[i + 1] += 1
    return start[: count + 1], entries


@kernel
def separate(
    x: Floats, wanted: Floats, planes: SeparatingPlanes, body_x: Floats, body_triangles: Ints, pairs: Ints
) -> tuple[Ints, Ints]:
    """Put a plane between each triangle and the body near it, where all its corners are high enough above one.

    Args:
        x: positions of the cloth [m], (n, 3); wanted: how far each particle wants to go [m], (n,).
        planes: of which separated, normal and level are set.
        body_x, body_triangles: the body, (b, 3) [m] and (t, 3).
        pairs: of triangles, (p, 2): the cloth's, and one of the body's that is near it.

    Returns:
        near_start and near.
    """
    count = planes.corners.shape[0]
    start = np.zeros(count + 2, dtype=np.int32)
    for pair in range(pairs.shape[0]):
        start[pairs[pair, 0] + 2] += 1
    for t in range(count):
        start[t + 2] += start[t + 1]
    near = np.empty(pairs.shape[0], dtype=np.int32)
    for pair in range(pairs.shape[0]):
        t = pairs[pair, 0]
        near[start[t + 1]] = pairs[pair, 1]
        start[t + 1] += 1
    high = planes.lowest + _HIGHER * (planes.high - planes.lowest)
    for t in range(count):
        faces = near[start[t] : start[t + 1]]
        if len(faces) > 0:
            planes.separated[t] = _separate(t, x, wanted, _SHARE, high, planes, body_x, body_triangles, faces)
    return start[: count + 1], near


@kernel
def find_plane(
    t: int,
    x: Floats,
    wanted: Floats,
    share: float,
    planes: SeparatingPlanes,
    body_x: Floats,
    body_triangles: Ints,
) -> bool:
    """Set the plane of triangle t, if one leaves its corners a share of what they want to go [m], (n,)."""
    faces = planes.near[planes.near_start[t] : planes.near_start[t + 1]]
    return _separate(t, x, wanted, share, planes.high, planes, body_x, body_triangles, faces)


@kernel
def _separate(
    t: int,
    x: Floats,
    wanted: Floats,
    share: float,
    high: float,
    planes: SeparatingPlanes,
    body_x: Floats,
    body_triangles: Ints,
    faces: Ints,
) -> bool:
    p, q, r = planes.corners[t, 0], planes.corners[t, 1], planes.corners[t, 2]
    # Their directions are those in which the body looks here, and the cloth.
    bx, by, bz = 0.0, 0.0, 0.0
    for entry in range(faces.shape[0]):
        face = faces[entry]
        nx, ny, nz = _normal(body_x, body_triangles[face, 0], body_triangles[face, 1], body_triangles[face, 2])
        bx, by, bz = bx + nx, by + ny, bz + nz
    cx, cy, cz = _normal(x, p, q, r)
    if cx * bx + cy * by + cz * bz < 0.0:
        cx, cy, cz = -cx, -cy, -cz
    best = high
    found = False
    for direction in range(2):
        nx, ny, nz = (bx, by, bz) if direction == 0 else (cx, cy, cz)
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length == 0.0:
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        lowest = np.inf
        for k in range(3):
            i = planes.corners[t, k]
            # How much higher than others a corner has to be that wants to go far.
            more = max(share * wanted[i] - (high - planes.lowest), 0.0)
            lowest = min(lowest, _along(x, i, nx, ny, nz) - more)
        level = -np.inf
        for entry in range(faces.shape[0]):
            face = faces[entry]
            for k in range(3):
                level = max(level, _along(body_x, body_triangles[face, k], nx, ny, nz))
            if level > lowest - best:
                break
        if lowest - level >= best:
            best = lowest - level
            found = True
            planes.normal[t, 0], planes.normal[t, 1], planes.normal[t, 2] = nx, ny, nz
            planes.level[t] = level
            if best >= 2.0 * planes.high:
                break
    return found


@kernel
def _normal(x: Floats, p: int, q: int, r: int) -> tuple[float, float, float]:
    """Twice the area of a triangle times its normal."""
    ax, ay, az = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    bx, by, bz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@kernel
def _along(x: Floats, i: int, nx: float, ny: float, nz: float) -> float:
    return float(x[i, 0] * nx + x[i, 1] * ny + x[i, 2] * nz)


@kernel
def height_above_planes(x: Floats, i: int, planes: SeparatingPlanes) -> float:
    """How high particle i of x (n, 3) is above the lowest plane of its triangles [m]; inf if they have none."""
    height = np.inf
    for entry in range(planes.start[i], planes.start[i + 1]):
        t = planes.entries[entry]
        if planes.separated[t]:
            height = min(height, height_above_plane(x, i, planes, t))
    return float(height)


@kernel
def height_above_plane(x: Floats, i: int, planes: SeparatingPlanes, t: int) -> float:
    """How high particle i of x (n, 3) is above the plane of triangle t [m]."""
    return float(_along(x, i, planes.normal[t, 0], planes.normal[t, 1], planes.normal[t, 2]) - planes.level[t])


@kernel
def given_up(x: Floats, wanted: Floats, planes: SeparatingPlanes, body_x: Floats, body_triangles: Ints) -> Ints:
    """Put another plane where one leaves a corner too little way; the triangles that have none any more, (k,).

    Shapes: x (n, 3), body_x (b, 3) [m]; wanted (n,), how far each particle wants to go [m]; body_triangles (t, 3). The
    body must be where it was.
    """
    count = 0
    for t in range(planes.corners.shape[0]):
        if not planes.separated[t]:
            continue
        enough = True
        for k in range(3):
            i = planes.corners[t, k]
            least = max(planes.high, planes.lowest + _LEAST_SHARE * wanted[i])
            enough = enough and height_above_plane(x, i, planes, t) >= least
        if not enough and not find_plane(t, x, wanted, _LEAST_SHARE, planes, body_x, body_triangles):
            planes.separated[t] = False
            planes.lost[count] = t
            count += 1
    return planes.lost[:count].copy()


@kernel
def pairs_near(planes: SeparatingPlanes, which: Ints) -> Ints:
    """The triangles `which` (k,), each with all of the body's that are near it, (p, 2)."""
    count = 0
    for entry in range(which.shape[0]):
        count += planes.near_start[which[entry] + 1] - planes.near_start[which[entry]]
    pairs = np.empty((count, 2), dtype=np.int32)
    count = 0
    for entry in range(which.shape[0]):
        t = which[entry]
        for place in range(planes.near_start[t], planes.near_start[t + 1]):
            pairs[count, 0], pairs[count, 1] = t, planes.near[place]
            count += 1
    return pairs
