"""Repair of triangle meshes as they come: scans, STL soup, several shells, any winding. What was done is counted.

In this order: vertices at one place become one; triangles without area and repeated ones are dropped; within each piece
that hangs together over sides with exactly two triangles the winding is made to agree; each piece is turned outside
out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import build_tree
from cloth_core.equal_rows import first_of_equal
from cloth_core.kernel import kernel
from cloth_core.mesh_topology import unique_edges
from cloth_core.winding_number import dipoles, winding_numbers

__all__ = ["RepairedMesh", "repair_mesh"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Vertices at the rim of a hole that are no farther apart than this share of the mesh's size are one.
_WELD_SHARE = 1e-6
# An open piece encloses something if its holes can be closed with less than this share of its area (a hemisphere: 0.5).
_MOST_CLOSING = 0.6
# A closed piece encloses something unless rounding decides: share of its area to the power 1.5 (a ball: 0.094).
_LEAST_VOLUME = 1e-9
# Fragments enclose something together from this share on (a standing person: 0.025).
_LEAST_TOGETHER = 0.003
# A mesh of which more triangles than this share hang together with no other is called loose.
_MOST_LOOSE = 0.1
# Shells, largest first, in which others are looked for, and points of those others that are tried.
_MOST_NESTED_CHECKED = 64
_NESTED_SAMPLES = 16
# Any direction that no mesh is likely to be aligned with.
_SWEEP = np.array([0.4317, 0.7121, 0.5537]) / np.linalg.norm([0.4317, 0.7121, 0.5537])


class RepairedMesh(NamedTuple):
    """A mesh, what was mended with counts, and what a user should know, one line each.

    Attributes:
        vertices: [m], (n, 3); triangles: (m, 3).
        repairs: what was done -> how often.
        warnings: without the body's name.
    """

    vertices: Floats
    triangles: Ints
    repairs: dict[str, int]
    warnings: list[str]


def repair_mesh(vertices: Floats, triangles: Ints) -> RepairedMesh:
    """Mend a mesh, vertices (n, 3) [m] and triangles (m, 3); all indices exist and all coordinates are finite.

    No triangle is left where none has an area; that is for the caller to refuse.
    """
    repairs: dict[str, int] = {}
    x = vertices + 0.0  # turns -0 into 0
    faces = _weld(x, triangles, repairs)
    faces = _without_flat(x, faces, repairs)
    faces = _without_duplicates(faces, repairs)
    used = np.zeros(len(x), dtype=bool)
    used[faces] = True
    lost = len(x) - int(used.sum()) - repairs.get("duplicate vertices merged", 0)
    if lost:
        repairs["unused vertices dropped"] = lost
    if not used.all():
        number = np.cumsum(used, dtype=np.int32) - 1
        x, faces = np.ascontiguousarray(x[used]), number[faces].astype(np.int32)
    warnings: list[str] = []
    if len(faces):
        faces = _turned(x, faces, repairs, warnings)
    return RepairedMesh(x, np.ascontiguousarray(faces), repairs, warnings)


# ---- vertices and triangles


def _weld(x: Floats, triangles: Ints, repairs: dict[str, int]) -> Ints:
    """Triangles in which the first vertex at a place stands for all others there."""
    used = np.zeros(len(x), dtype=bool)
    used[triangles] = True
    first = first_of_equal(x.view(np.uint64))
    faces = first[triangles]
    edges, sides = unique_edges(faces)
    at_rim = np.zeros(len(x), dtype=bool)
    at_rim[edges[np.bincount(sides.ravel(), minlength=len(edges)) == 1]] = True
    rim = np.flatnonzero(at_rim).astype(np.int32)
    if len(rim):
        size = float(np.linalg.norm(np.ptp(x[triangles.ravel()], axis=0)))
        place = x[rim] @ _SWEEP
        order = np.argsort(place, kind="stable")
        near = _clusters(x[rim[order]], place[order], _WELD_SHARE * size)
        lowest = np.full(len(rim), len(x), dtype=np.int32)
        np.minimum.at(lowest, near, rim[order])
        first[rim[order]] = lowest[near]
        first = first[first]
        faces = first[triangles]
    left = np.zeros(len(x), dtype=bool)
    left[faces] = True
    merged = int((used & ~left).sum())
    if merged:
        repairs["duplicate vertices merged"] = merged
    return np.asarray(faces, dtype=np.int32)


@kernel
def _clusters(x: Floats, place: Floats, distance: float) -> Ints:
    """Number of the group of each point (n, 3), where points within a distance [m] of each other are in one group.

    place: sorted, coordinate along a unit vector [m], (n,). A group's number is the index of one of its points.
    """
    parent = np.arange(x.shape[0]).astype(np.int32)
    for i in range(x.shape[0]):
        for j in range(i + 1, x.shape[0]):
            if place[j] - place[i] > distance:
                break
            squared = 0.0
            for k in range(3):
                squared += (x[i, k] - x[j, k]) ** 2
            if squared <= distance * distance:
                a, b = i, j
                while parent[a] != a:
                    a = parent[a]
                while parent[b] != b:
                    b = parent[b]
                parent[max(a, b)] = min(a, b)
    for i in range(x.shape[0]):
        parent[i] = parent[parent[i]]
    return parent


def _without_flat(x: Floats, faces: Ints, repairs: dict[str, int]) -> Ints:
    flat = _flat(x, faces)
    if not flat.any():
        return faces
    repairs["zero-area triangles dropped"] = int(flat.sum())
    return np.asarray(faces[~flat])


@kernel
def _flat(x: Floats, faces: Ints) -> NDArray[np.bool_]:
    """Which triangles are lines or points: higher by less than a billionth of their length."""
    flat = np.zeros(faces.shape[0], dtype=np.bool_)
    for t in range(faces.shape[0]):
        a, b, c = x[faces[t, 0]], x[faces[t, 1]], x[faces[t, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        third = (ux - wx) ** 2 + (uy - wy) ** 2 + (uz - wz) ** 2
        longest = max(ux * ux + uy * uy + uz * uz, max(wx * wx + wy * wy + wz * wz, third))
        flat[t] = np.sqrt(nx * nx + ny * ny + nz * nz) <= 1e-9 * max(longest, 1e-24)
    return flat


def _without_duplicates(faces: Ints, repairs: dict[str, int]) -> Ints:
    first = first_of_equal(np.sort(faces, axis=1).astype(np.uint64))
    kept = first == np.arange(len(faces))
    if kept.all():
        return faces
    repairs["duplicate triangles dropped"] = int((~kept).sum())
    return np.asarray(faces[kept])


# ---- winding


class _Pieces(NamedTuple):
    """Triangles that hang together over sides with exactly two triangles.

    Attributes:
        piece: number of each triangle's piece, (m,).
        total: how many pieces there are.
        turn: which triangles to turn so that each piece winds one way, (m,).
        twisted: which pieces cannot be made to agree with themselves, (total,).
        uses: triangles at each side, (e,).
    """

    piece: Ints
    total: int
    turn: NDArray[np.bool_]
    twisted: NDArray[np.bool_]
    uses: Ints


@kernel
def _flood(faces: Ints, sides: Ints, side_count: int) -> _Pieces:
    total = faces.shape[0]
    owner = np.full((side_count, 2), -1, dtype=np.int32)
    uses = np.zeros(side_count, dtype=np.int32)
    for t in range(total):
        for k in range(3):
            e = sides[t, k]
            if uses[e] < 2:
                owner[e, uses[e]] = t
            uses[e] += 1
    piece = np.full(total, -1, dtype=np.int32)
    turn = np.zeros(total, dtype=np.bool_)
    twisted = np.zeros(total, dtype=np.bool_)
    waiting = np.empty(total, dtype=np.int32)
    count = 0
    for seed in range(total):
        if piece[seed] >= 0:
            continue
        piece[seed] = count
        waiting[0] = seed
        done, known = 0, 1
        while done < known:
            t = waiting[done]
            done += 1
            for k in range(3):
                e = sides[t, k]
                if uses[e] != 2:
                    continue
                other = owner[e, 1] if owner[e, 0] == t else owner[e, 0]
                m = 0
                while sides[other, m] != e:
                    m += 1
                # Two triangles that agree run along their common side in opposite directions.
                wanted = turn[t] != (faces[other, m] == faces[t, k])
                if piece[other] < 0:
                    piece[other] = count
                    turn[other] = wanted
                    waiting[known] = other
                    known += 1
                elif turn[other] != wanted:
                    twisted[count] = True
        count += 1
    return _Pieces(piece, count, turn, twisted[:count].copy(), uses)


def _turned(x: Floats, faces: Ints, repairs: dict[str, int], warnings: list[str]) -> Ints:
    """Triangles that wind one way in each piece, with the normals outwards where it encloses anything."""
    edges, sides = unique_edges(faces)
    pieces = _flood(faces, sides, len(edges))
    piece, count, turn = pieces.piece, pieces.total, pieces.turn.copy()
    size = np.bincount(piece, minlength=count)
    turn[pieces.twisted[piece]] = False
    volume, bare, area, closing = _enclosed(x, *_reversed(faces, sides, turn), pieces)
    broken = np.zeros(count, dtype=bool)
    broken[piece[(pieces.uses[sides] != 2).any(axis=1)]] = True
    sheet = (closing > _MOST_CLOSING * area) | (np.abs(volume) < _LEAST_VOLUME * area**1.5)
    # A sheet stays as most of it is, or goes with the rest where that is given inside out.
    most = 2 * np.bincount(piece, weights=turn, minlength=count) > size
    inside_out = _given_inside_out(most, volume, bare, area, sheet)
    turn ^= np.where(sheet, most != inside_out, volume < 0.0)[piece] & ~pieces.twisted[piece]
    turned = np.bincount(piece, weights=turn, minlength=count).astype(np.int64)
    whole = turned == size
    for what, number in (
        ("triangles turned to agree with their neighbours", int(turned[~whole].sum())),
        ("triangles turned outside out", int(turned[whole].sum())),
    ):
        if number:
            repairs[what] = number
    faces, _ = _reversed(faces, sides, turn)
    rim = int((pieces.uses == 1).sum())
    if rim:
        warnings.append(
            f"{rim} sides have one triangle only; the surface is open there, and inside is where it goes round a point "
            "by more than half (generalised winding number)"
        )
    branched = int((pieces.uses > 2).sum())
    if branched:
        warnings.append(f"{branched} sides have more than two triangles; which way is out is decided for each piece")
    loose = int((size == 1).sum())
    if loose > _MOST_LOOSE * len(faces):
        warnings.append(
            f"{loose} of {len(faces)} triangles share no side with exactly one other; "
            "which of their sides is out is taken from the file"
        )
    if pieces.twisted.any():
        warnings.append(
            f"{int(size[pieces.twisted].sum())} triangles form a surface with one side only (a Moebius strip); "
            "their winding is left as it is"
        )
    warnings += _nested(x, faces, piece, ~broken & ~pieces.twisted & ~sheet)
    return faces


def _reversed(faces: Ints, sides: Ints, turn: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Corners and sides of triangles, some of them the other way round."""
    corners = np.where(turn[:, None], faces[:, ::-1], faces)
    return np.ascontiguousarray(corners), np.where(turn[:, None], sides[:, [1, 0, 2]], sides)


def _given_inside_out(
    most: NDArray[np.bool_], volume: Floats, bare: Floats, area: Floats, sheet: NDArray[np.bool_]
) -> bool:
    """Whether a mesh came inside out: by the pieces that enclose something, or by fragments that do so together.

    All for each piece: whether most of it came the other way round than `volume` and `bare` count it, and so on.
    """
    if area[~sheet].sum() >= area[sheet].sum():
        return bool((area * np.where(most != (volume < 0.0), 1.0, -1.0))[~sheet].sum() > 0.0)
    together = float((bare * np.where(most, -1.0, 1.0))[sheet].sum())
    return int(sheet.sum()) > 1 and together < -_LEAST_TOGETHER * float(area.sum()) ** 1.5


def _enclosed(x: Floats, faces: Ints, sides: Ints, pieces: _Pieces) -> tuple[Floats, Floats, Floats, Floats]:
    """Signed volume [m^3] of each piece, its holes closed by fans from their middles, and open; its area and theirs."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = pieces.total
    y = x - (x.min(axis=0) + x.max(axis=0)) / 2.0
    a, b, c = (y[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.bincount(pieces.piece, weights=np.sqrt((normal**2).sum(axis=1)) / 2.0, minlength=count)
    volume = np.bincount(pieces.piece, weights=(a * normal).sum(axis=1) / 6.0, minlength=count)
    # Sides of a piece that no other of its triangles continues, in the order in which their triangle runs along them.
    open_side = pieces.uses[sides] != 2
    if not open_side.any():
        return np.asarray(volume), np.asarray(volume), np.asarray(area), np.zeros(count, dtype=np.float64)
    t, k = np.nonzero(open_side)
    start, end = faces[t, k], faces[t, (k + 1) % 3]
    place = pieces.piece[t].astype(np.int64) * len(x)
    corners, index = np.unique(np.concatenate([place + start, place + end]), return_inverse=True)
    start_of, end_of = index.ravel()[: len(t)], index.ravel()[len(t) :]
    graph = coo_matrix((np.ones(len(t)), (start_of, end_of)), shape=(len(corners), len(corners)))
    loops, loop = connected_components(graph, directed=False)
    loop_of = loop[start_of]
    uses = np.bincount(loop_of, minlength=loops)
    middle = np.stack([np.bincount(loop_of, weights=y[start][:, k], minlength=loops) / uses for k in range(3)], axis=1)
    tip, first, second = middle[loop_of], y[end], y[start]
    fan = np.einsum("ij,ij->i", tip, np.cross(first, second)) / 6.0
    fan_area = np.sqrt((np.cross(first - tip, second - tip) ** 2).sum(axis=1)) / 2.0
    own = pieces.piece[t]
    closed = np.asarray(volume + np.bincount(own, weights=fan, minlength=count))
    closing = np.bincount(own, weights=fan_area, minlength=count).astype(np.float64)
    return closed, np.asarray(volume), np.asarray(area), closing


def _nested(x: Floats, faces: Ints, piece: Ints, closed: NDArray[np.bool_]) -> list[str]:
    """A line about closed pieces that lie inside another closed one, if there are any."""
    shells = np.flatnonzero(closed)
    if len(shells) < 2:
        return []
    size = np.bincount(piece)
    order = np.argsort(piece, kind="stable")
    first = np.concatenate([[0], np.cumsum(size)])
    corners = x[faces[order]]
    low = np.minimum.reduceat(corners.min(axis=1), first[:-1])
    high = np.maximum.reduceat(corners.max(axis=1), first[:-1])
    inside = np.zeros(len(size), dtype=bool)
    for outer in shells[np.argsort(-size[shells], kind="stable")][:_MOST_NESTED_CHECKED]:
        within = (low[shells] > low[outer]).all(axis=1) & (high[shells] < high[outer]).all(axis=1)
        inner = shells[within & ~inside[shells]]
        if len(inner) == 0:
            continue
        own = np.ascontiguousarray(faces[order[first[outer] : first[outer + 1]]])
        tree = build_tree(x, own)
        sums = dipoles(x, own, tree)
        for k in inner:
            triangles = order[np.linspace(first[k], first[k + 1] - 1, _NESTED_SAMPLES).astype(int)]
            points = np.ascontiguousarray(x[faces[triangles, 0]])
            inside[k] = bool((winding_numbers(points, x, own, tree, sums) > 0.5).all())
    if not inside.any():
        return []
    largest = int(np.argmax(np.where(inside, size, 0)))
    place = ", ".join(f"{value:.3g}" for value in (low[largest] + high[largest]) / 2.0)
    return [
        f"{int(inside.sum())} shells lie inside another one, the largest with {size[largest]} triangles around "
        f"({place}) m; they are kept, and what is between or within them counts as inside"
    ]
