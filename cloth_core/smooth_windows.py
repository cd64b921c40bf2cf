"""Parts of panels that are too smooth to touch themselves, so that nothing has to be searched there.

In a convex window of the flat panel, let F be the deformation gradient of each triangle (space by rest plane, 3 x 2)
and Q one pair of orthonormal directions for the whole window. If all eigenvalues of the symmetric part of Q'F are at
least m > 0 in every triangle, then along the straight line of the rest plane from any point a to any point b

    (b - a) . Q'(x(b) - x(a)) = integral of (b - a) . Q'F (b - a) / |b - a|  >=  m |b - a|^2,

and so |x(b) - x(a)| >= m |b - a|: no two points of the window are nearer to each other than m times their distance in
the panel, whatever bends and shears it has. (The idea of culling by cones of normals, Volino and Magnenat-Thalmann
1994, with the criterion of Noshiro and Warschawski for a map to be one-to-one, which needs no look at the rim.)

Windows of two by two tiles overlap, so that neighbouring tiles always share one; where a window has a concave rim, a
slit or a dart in it, its rest shape is not convex and it is left to the search, as are pairs across a seam.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.mesh_topology import unique_edges

if TYPE_CHECKING:
    from shapely import STRtree

    from cloth_core.garment import Garment

__all__ = [
    "FOLDED",
    "FOLDING",
    "SMOOTH",
    "SmoothWindows",
    "Windows",
    "common_window",
    "node_windows",
    "smoothness",
    "windows_of",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

# Side of the smallest tiles [m], and at least so many particle spacings: folds have radii of a few centimetres. Those
# of each further level are twice as large.
_TILE, _TILE_SPACINGS, _LEVELS = 0.04, 2.0, 3
# The rim of a window may reach into it by this share of the spacing: rounding, not concavity.
_FLUSH = 1e-6
# The least m with which windows are left out of the search: enough for what neighbours are held apart at, and for the
# offset of layers. From so much more on they begin to be left out; at a search those stay that have this share of it,
# and with less than this share a search is due.
_LEAST, _AHEAD = 0.3, 0.3
_KEPT_FROM, _SEARCHED_FROM = 0.5, 0.4
# A window that folded up within a few steps is searched at least so many times.
_SEARCHES_AFTER_FOLD = 10

# No window has folded; one begins to, so that a search is due; or one has so far that parts of it may have met.
SMOOTH, FOLDING, FOLDED = range(3)


class Windows(NamedTuple):
    """Windows of a garment's panels, w of them; what they are made of does not depend on where the cloth is.

    Attributes:
        of_triangle: windows whose tiles each triangle belongs to, -1 for none, shape (levels, m, 4), coarsest first.
        whole: triangles that meet no other cloth around them than that of their windows, shape (levels, m).
        start, cover: the triangles that cover window w are cover[start[w] : start[w + 1]].
        inverse_rest: inverse of the two rest edges of each triangle [1/m], row by row, shape (m, 4).
        height: the lowest height of the triangles that cover it [m], shape (w,).
        side: of the tiles of each level [m], shape (levels,).
        parent: the window of the level before that holds all of window w, -1 for none, shape (w,).
    """

    of_triangle: Ints
    whole: Bools
    start: Ints
    cover: Ints
    inverse_rest: Floats
    height: Floats
    side: Floats
    parent: Ints


def windows_of(garment: Garment) -> Windows:
    """The convex windows of a garment's panels."""
    import shapely

    corner = garment.rest[garment.triangles]
    u, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]
    inverse_rest = np.stack([w[:, 1], -w[:, 0], -u[:, 1], u[:, 0]], axis=1) / area[:, None]
    longest = np.max([np.linalg.norm(corner[:, k] - corner[:, k - 1], axis=1) for k in range(3)], axis=0)
    lowest = np.abs(area) / longest
    side: Floats = max(_TILE, _TILE_SPACINGS * garment.spacing) * np.exp2(np.arange(_LEVELS)[::-1])
    of_triangle = np.full((_LEVELS, len(corner), 4), -1, dtype=np.int32)
    whole = np.zeros((_LEVELS, len(corner)), dtype=np.bool_)
    covers: list[NDArray[np.integer]] = []
    parents: list[int] = []
    for panel in range(len(garment.panel_names)):
        mine = np.flatnonzero(garment.panel_of_triangle == panel)
        low, high = corner[mine].min(axis=1), corner[mine].max(axis=1)
        boxes = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        rim = shapely.STRtree(shapely.linestrings(_rim(garment, mine)))
        above = np.full((1, 1), -1, dtype=np.int64)
        for level in range(_LEVELS):
            entries, own, whole[level, mine], numbers = _windows_of_panel(garment, mine, boxes, rim, float(side[level]))
            of_triangle[level, mine] = np.where(entries >= 0, entries + len(covers), -1)
            numbers = np.where(numbers >= 0, numbers + len(covers), -1)
            covers += own
            # Two tiles side by side lie in one or two of twice their size.
            i, j = (
                np.minimum(at // 2, most - 1) for at, most in zip(np.nonzero(numbers >= 0), above.shape, strict=True)
            )
            parents += above[i, j].tolist()
            above = numbers
    length = np.array([len(rows) for rows in covers], dtype=np.int64)
    return Windows(
        of_triangle=of_triangle,
        whole=whole,
        start=np.concatenate([[0], np.cumsum(length)]).astype(np.int32),
        cover=(np.concatenate(covers) if covers else np.zeros(0)).astype(np.int32),
        inverse_rest=inverse_rest,
        height=np.array([lowest[rows].min() for rows in covers], dtype=np.float64),
        side=side,
        parent=np.array(parents, dtype=np.int32),
    )


def _windows_of_panel(
    garment: Garment, mine: NDArray[np.integer], boxes: STRtree, rim: STRtree, side: float
) -> tuple[NDArray[np.int64], list[NDArray[np.integer]], Bools, NDArray[np.int64]]:
    """Convex windows of a panel's triangles `mine` (t,), with tiles of that side [m]; their boxes, and the panel's rim.

    Returns:
        windows of each triangle (t, 4); what covers each window; `whole` (t,); number of the window at each place.
    """
    import shapely

    corner = garment.rest[garment.triangles[mine]]
    tile, shape = _tiles(corner.mean(axis=1), side)
    # Window (i, j) has the tiles i, i + 1 by j, j + 1.
    rows, columns = max(shape[0] - 1, 1), max(shape[1] - 1, 1)
    entries = np.full((len(mine), 4), -1, dtype=np.int64)
    for k, (left, up) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        i, j = tile[:, 0] - left, tile[:, 1] - up
        inside = (i >= 0) & (j >= 0) & (i < rows) & (j < columns)
        entries[inside, k] = (i * columns + j)[inside]
    triangle, place = np.nonzero(entries >= 0)
    corners = garment.triangles[mine[triangle]].astype(np.int64)
    own = np.unique(entries[triangle, place][:, None] * len(garment.rest) + corners)
    window, point = np.divmod(own, len(garment.rest))
    # One line through the points of each window, for the sake of its hull.
    lines = shapely.linestrings(garment.rest[point], indices=window, out=_nothing(rows * columns))
    hulls = shapely.buffer(shapely.convex_hull(lines), -_FLUSH * garment.spacing)
    convex = ~(shapely.is_empty(hulls) | shapely.is_missing(hulls))
    convex[np.unique(rim.query(hulls, predicate="intersects")[0])] = False
    number = np.where(convex, np.cumsum(convex) - 1, -1)
    hulls[~convex] = None
    window, row = boxes.query(hulls)
    order = np.lexsort((row, window))
    window, row = window[order], row[order]
    at = np.searchsorted(window, np.arange(len(hulls) + 1))
    covers = [mine[row[at[k] : at[k + 1]]] for k in np.flatnonzero(convex)]
    sewn = np.bincount(garment.merged_indices)[garment.merged_indices] > 1
    seamed = sewn[garment.triangles[mine]].any(axis=1)
    tile_number = tile[:, 0] * shape[1] + tile[:, 1]
    near_seam = _spread(np.bincount(tile_number, seamed, shape[0] * shape[1]).reshape(shape) > 0.0)
    inner = ~near_seam.reshape(-1)[tile_number] & ((entries < 0) | (number[entries] >= 0)).all(axis=1)
    return np.where(entries >= 0, number[entries], -1), covers, np.asarray(inner), number.reshape(rows, columns)


def _nothing(count: int) -> NDArray[np.object_]:
    return np.full(count, None, dtype=object)


def _tiles(centre: Floats, side: float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Column and row of the tile of each centre (m, 2) [m], and how many columns and rows there are."""
    low = centre.min(axis=0)
    count = np.maximum(np.floor(np.ptp(centre, axis=0) / side).astype(np.int64), 1)
    tile = np.minimum(((centre - low) / side).astype(np.int64), count - 1)
    return tile, (int(count[0]), int(count[1]))


def _spread(tiles: Bools) -> Bools:
    """The tiles (i, j) that are set, and those around them."""
    around = np.pad(tiles, 1)
    shifted = [around[i : i + tiles.shape[0], j : j + tiles.shape[1]] for i in range(3) for j in range(3)]
    return np.asarray(np.any(shifted, axis=0), dtype=np.bool_)


def _rim(garment: Garment, triangles: NDArray[np.integer]) -> Floats:
    """Sides of these triangles that belong to one of them only, shape (k, 2, 2) [m]."""
    edges, of_triangle = unique_edges(garment.triangles[triangles])
    alone = np.bincount(of_triangle.ravel(), minlength=len(edges)) == 1
    return np.asarray(garment.rest[edges[alone]])


class SmoothWindows:
    """Which windows of a garment are smooth enough at present to be left out of the search for self contact.

    Args:
        windows: of the garment.
        offset: distance at which layers are held apart [m].

    Attributes:
        smooth: windows that are left out, shape (w,), but for those inside of larger ones.
    """

    def __init__(self, windows: Windows, offset: float) -> None:
        self.windows = windows
        # Points that have no corner in common are at least one height apart in the panel.
        self._least = np.maximum(_LEAST, 1.1 * offset / windows.height)
        self.smooth = np.zeros(len(windows.height), dtype=np.bool_)
        self._inside = np.zeros(len(windows.height), dtype=np.bool_)
        self._wait = np.zeros(len(windows.height), dtype=np.int64)
        depth = np.zeros(len(windows.height), dtype=np.int64)
        for level in range(len(windows.side)):
            depth[windows.of_triangle[level][windows.of_triangle[level] >= 0]] = level
        self._levels = [np.flatnonzero(depth == level) for level in range(len(windows.side))]

    def look(self, x: Floats, triangles: Ints) -> None:
        """Before a search at x (n, 3) [m]: leave out what is smooth by far, and what was and still is well enough."""
        self._wait = np.maximum(self._wait - 1, 0)
        least = self._least + _AHEAD * np.where(self.smooth, _KEPT_FROM, 1.0)
        may: Bools = np.asarray((self._wait == 0) & (least < 1.0))
        self._inside[:] = False
        self.smooth = np.zeros(len(may), dtype=np.bool_)
        for level in self._levels:
            parent = self.windows.parent[level]
            self._inside[level] = (parent >= 0) & (self.smooth | self._inside)[parent]
            asked = np.zeros(len(may), dtype=np.bool_)
            asked[level] = may[level] & ~self._inside[level]
            self.smooth |= smoothness(x, triangles, self.windows, least, asked)

    def state(self, x: Floats, triangles: Ints) -> int:
        """What has become at x (n, 3) [m] of the windows that are left out: SMOOTH, FOLDING or FOLDED."""
        still = smoothness(x, triangles, self.windows, self._least + _SEARCHED_FROM * _AHEAD, self.smooth)
        if (still == self.smooth).all():
            return SMOOTH
        failed = smoothness(x, triangles, self.windows, self._least, self.smooth & ~still) != (self.smooth & ~still)
        self._wait[failed] = _SEARCHES_AFTER_FOLD
        return FOLDED if failed.any() else FOLDING

    def room_of_triangles(self) -> Floats:
        """Side [m] of the largest tiles all around each triangle of which everything is left out, 0 for none, (m,)."""
        return _room(self.windows, self.smooth | self._inside)

    def room(self, triangles: Ints, particles: int) -> Floats:
        """The least of that among the triangles around each particle, (n,)."""
        return _least_around(self.room_of_triangles(), triangles, particles)


def smoothness(x: Floats, triangles: Ints, windows: Windows, least: Floats, asked: Bools) -> Bools:
    """Which of the windows asked for (w,) have m of at least `least` (w,), at x (n, 3) [m] with triangles (m, 3)."""
    result = np.zeros(asked.shape[0], dtype=np.bool_)
    _find_smooth(x, triangles, windows, least, asked, np.empty((6, windows.inverse_rest.shape[0])), np.empty(6), result)
    return result


@borrowing_kernel
def _find_smooth(
    x: Floats,
    triangles: Ints,
    windows: Windows,
    least: Floats,
    asked: Bools,
    f: Floats,
    mean: Floats,
    result: Bools,
) -> None:
    """As `smoothness`, where result (w,) is true then; f (6, m) and mean (6,) are scratch."""
    for t in range(f.shape[1]):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        a, b, c, d = (
            windows.inverse_rest[t, 0],
            windows.inverse_rest[t, 1],
            windows.inverse_rest[t, 2],
            windows.inverse_rest[t, 3],
        )
        for axis in range(3):
            u, w = x[j, axis] - x[i, axis], x[k, axis] - x[i, axis]
            f[axis, t] = u * a + w * c
            f[3 + axis, t] = u * b + w * d
    for number in range(asked.shape[0]):
        if not asked[number]:
            continue
        cover = windows.cover[windows.start[number] : windows.start[number + 1]]
        _add_up(f, cover, mean)
        result[number] = _turned_towards(mean) and _all_beyond(f, cover, mean, least[number])


@borrowing_kernel
def _add_up(f: Floats, cover: Ints, total: Floats) -> None:
    """Sum of F over the triangles of cover; f (6, m), total (6,)."""
    a = b = c = d = e = g = 0.0  # not in an array: each sum would wait for its number to be written and read again
    for entry in range(cover.shape[0]):
        t = cover[entry]
        a += f[0, t]
        b += f[1, t]
        c += f[2, t]
        d += f[3, t]
        e += f[4, t]
        g += f[5, t]
    total[0], total[1], total[2], total[3], total[4], total[5] = a, b, c, d, e, g


@kernel
def _room(windows: Windows, left_out: Bools) -> Floats:
    room = np.zeros(windows.inverse_rest.shape[0])
    for t in range(room.shape[0]):
        for level in range(windows.side.shape[0]):
            all_out = windows.whole[level, t]
            for k in range(4):
                window = windows.of_triangle[level, t, k]
                all_out = all_out and (window < 0 or left_out[window])
            if all_out:
                room[t] = windows.side[level]
                break
    return room


@kernel
def _least_around(value: Floats, triangles: Ints, particles: int) -> Floats:
    least = np.full(particles, np.inf)
    for t in range(value.shape[0]):
        for k in range(3):
            least[triangles[t, k]] = min(least[triangles[t, k]], value[t])
    return least


@borrowing_kernel
def _turned_towards(mean: Floats) -> bool:
    """Replace F (two columns, (6,)) by the Q of its polar decomposition F = Q S; False if there is none."""
    uu = mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]
    ww = mean[3] * mean[3] + mean[4] * mean[4] + mean[5] * mean[5]
    uw = mean[0] * mean[3] + mean[1] * mean[4] + mean[2] * mean[5]
    squared = uu * ww - uw * uw
    if not squared > 1e-12 * uu * ww:
        return False
    # S is the root of ((uu, uw), (uw, ww)); its inverse is ((sw, -uw), (-uw, su)) / (det * trace), up to a factor.
    det = np.sqrt(squared)
    trace = np.sqrt(uu + ww + 2.0 * det)
    su, sw, share = uu + det, ww + det, 1.0 / (det * trace)
    for axis in range(3):
        p, q = mean[axis], mean[3 + axis]
        mean[axis] = share * (sw * p - uw * q)
        mean[3 + axis] = share * (su * q - uw * p)
    return True


@borrowing_kernel
def _all_beyond(f: Floats, cover: Ints, q: Floats, least: float) -> bool:
    """Whether the symmetric part of Q'F is at least `least` in all triangles of cover; f (6, m), q (6,)."""
    below = 0
    for entry in range(cover.shape[0]):  # counted, without a way out: so that it is done to several at once
        t = cover[entry]
        fx, fy, fz, gx, gy, gz = f[0, t], f[1, t], f[2, t], f[3, t], f[4, t], f[5, t]
        first = q[0] * fx + q[1] * fy + q[2] * fz - least
        second = q[3] * gx + q[4] * gy + q[5] * gz - least
        across = 0.5 * (q[0] * gx + q[1] * gy + q[2] * gz + q[3] * fx + q[4] * fy + q[5] * fz)
        below += not ((first >= 0.0) & (second >= 0.0) & (first * second >= across * across))
    return below == 0


@kernel
def node_windows(tree: AabbTree, of_triangle: Ints, smooth: Bools) -> Ints:
    """Smooth windows that all triangles below each node of a tree have in common, the largest first, (nodes, 8).

    of_triangle (levels, m, 4): windows of a triangle, -1 for none; what the tree has beyond m belongs to none.
    """
    nodes, most = tree.triangle.shape[0], 8
    common = np.full((nodes, most), -1, dtype=np.int32)
    for node in range(nodes - 1, -1, -1):
        t = tree.triangle[node]
        count = 0
        if t >= 0:
            if t < of_triangle.shape[1]:
                for level in range(of_triangle.shape[0]):
                    for k in range(4):
                        window = of_triangle[level, t, k]
                        if window >= 0 and smooth[window] and count < most:
                            common[node, count] = window
                            count += 1
            continue
        left, right = node + 1, tree.right[node]
        for k in range(most):
            if common[left, k] < 0:
                break
            for m in range(most):
                if common[left, k] == common[right, m]:
                    common[node, count] = common[left, k]
                    count += 1
                    break
                if common[right, m] < 0:
                    break
    return common


@borrowing_kernel
def common_window(common: Ints, i: int, j: int) -> bool:
    """Whether two rows of windows (any, k) have one in common."""
    for k in range(common.shape[1]):
        if common[i, k] < 0:
            return False
        for m in range(common.shape[1]):
            if common[i, k] == common[j, m]:
                return True
            if common[j, m] < 0:
                break
    return False
