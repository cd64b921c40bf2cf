"""Cloth against cloth: the search for pairs, by the same tree of boxes as against the body (paper, step 6).

Left out, by topology and nothing else, are pairs that have a corner in common: they cannot be apart. Pairs whose
corners are neighbours are kept, at an offset that the rest shape leaves room for.

While seams close, two points that are to be one count as one from where they first come nearer than a few offsets, so
that a panel cannot get through the edge that it is to be sewn to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import DEPTH, AabbTree, boxes_overlap, build_tree, refit_tree
from cloth_core.boxes import edge_boxes, in_box, overlap, triangle_boxes
from cloth_core.errors import SceneError
from cloth_core.garment import Garment
from cloth_core.kernel import borrowing_kernel, kernel, zero
from cloth_core.mesh_topology import Representatives, point_neighbours, representatives
from cloth_core.near_distances import point_triangle_distances, segment_distances
from cloth_core.pair_contacts import CLOTH_SIDE, CLOTH_VERTEX
from cloth_core.pair_list import PairRoom, write_pair
from cloth_core.seam_gaps import ClosingSeams
from cloth_core.smooth_windows import SmoothWindows, common_window, node_windows

__all__ = ["NONE_LEFT_OUT", "SelfContact", "self_overlapping_pairs"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Neighbours are held apart at this share of the lowest height of the triangles around them.
_NEIGHBOUR_SHARE = 0.3
# Points that are to be sewn together count as one when they are nearer than this [m]. Farther away their surroundings
# must not pass through each other; nearer they must be able to, where four panels meet in one point from all sides.
_MET = 0.3
# Gaps of seams that were crossed are looked at again after so many searches: the way may be free by then.
_GAP_SEARCHES = 10
# Pairs of triangles whose boxes overlap, in all and for each triangle: about a dozen in one layer, and as many for each
# layer beside it. More than a heap of cloth has would take memory and time out of all proportion.
_MOST_PAIRS, _PAIRS_PER_TRIANGLE = 100_000, 200
# What is too smooth to touch itself may move by this share of a tile: two tiles of which one lies between are farther
# apart than twice that.
_SHARE_OF_TILE = 0.4
NONE_LEFT_OUT = np.zeros((0, 4), dtype=np.int32)


class SelfContact:
    """Search for candidates of contact between a garment's own triangles.

    Args:
        triangles: corner indices, shape (m, 3).
        identity: what each particle becomes once everything is sewn, (n,): equal numbers are one point.
        height: the lowest height of the rest triangles around each particle [m], shape (n,).
        offset: distance at which layers are held apart [m].

    Attributes:
        gaps_may_leave: whether gaps of seams that cloth touches count as cloth no longer: they may be what holds a seam
            open that comes no nearer.
        smooth: what is too smooth to touch itself, and is left out; None where nothing is.
    """

    def __init__(self, triangles: Ints, identity: Ints, height: Floats, offset: float) -> None:
        self.identity = np.ascontiguousarray(identity, dtype=np.int32)
        self.offset = offset
        self._room = _NEIGHBOUR_SHARE * height
        self.gaps_may_leave = False
        self.smooth: SmoothWindows | None = None
        self._closing: ClosingSeams | None = None
        # Which gaps are in; which seam each of those fills; and seams whose gaps are kept apart from each other's.
        self._gap_is_in: NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)
        self._gap_seam = np.zeros(0, dtype=np.int64)
        self._gaps_apart: NDArray[np.bool_] = np.zeros((0, 0), dtype=np.bool_)
        self._searches = 0
        self._leaf_pairs = np.zeros((4096, 2), dtype=np.int32)
        self._use(np.ascontiguousarray(triangles, dtype=np.int32))
        self._neighbours = point_neighbours(self.identity[self.triangles])

    def _use(self, triangles: Ints) -> None:
        self.triangles = triangles
        self._representatives = representatives(triangles)
        self._tree: AabbTree | None = None

    @classmethod
    def of(cls, garment: Garment, number: Ints, triangles: Ints, offset: float, sewing: bool) -> SelfContact:
        """Self contact of a garment whose unsewn particles are numbered `number` (n,); triangles in that numbering.

        While it is sewn, the gaps of its seams count as cloth: nothing can get between two edges that belong together.
        """
        count = int(number.max()) + 1
        identity = np.arange(count, dtype=np.int32)
        corner = garment.rest[garment.triangles]
        longest = np.max([np.linalg.norm(corner[:, k] - corner[:, k - 1], axis=1) for k in range(3)], axis=0)
        height = np.full(count, np.inf)
        np.minimum.at(height, triangles.ravel(), np.repeat(2.0 * garment.areas / longest, 3))
        contact = cls(triangles, identity, height, offset)
        contact.smooth = SmoothWindows(garment.windows, offset)
        if sewing and garment.seams:
            contact._closing = ClosingSeams(garment, triangles, _MET)
            contact._let_gaps_in(garment.start)
        return contact

    def one_point(self, x: Floats) -> Ints:
        """What each particle counts as at x (n, 3) [m], (n,): equal numbers are one point and cannot cross."""
        return self.identity if self._closing is None else self._closing.number_at(x)

    def _let_gaps_in(self, x: Floats) -> None:
        """Take those gaps of the seams for cloth that have nothing to do with any at x (n, 3) [m]."""
        closing = self._closing
        if closing is None:
            return
        if self._gap_is_in.all() and len(self._gap_is_in) == len(closing.gaps) and not self.gaps_may_leave:
            if not self._gaps_apart.all():
                self._keep_gaps_apart(x)
            return
        seams = int(closing.gap_seam.max(initial=-1)) + 1
        before = self._gap_is_in
        if self.gaps_may_leave or len(before) == 0:
            before = np.zeros(len(closing.gaps), dtype=np.bool_)
        self._gap_seam = closing.gap_seam
        self._gaps_apart = np.zeros((seams, seams), dtype=np.bool_)
        self._use(np.concatenate([closing.triangles, closing.gaps]))
        rows, apart, distance = self._pairs_within(x, 0.0)
        # What is in stays in else: cloth that touches it is what it is there for.
        self._gap_is_in = before | closing.free_gaps(x, rows[distance < apart])
        if not self._gap_is_in.all():
            self._gap_seam = closing.gap_seam[self._gap_is_in]
            self._use(np.concatenate([closing.triangles, closing.gaps[self._gap_is_in]]))
        self._keep_gaps_apart(x)

    def _keep_gaps_apart(self, x: Floats) -> None:
        """Gaps cannot pass through each other either, but for those of seams that are too near already at x (n, 3)."""
        assert self._closing is not None
        self._gaps_apart[:] = True
        pairs = self._overlapping(x, 0.0)
        pairs = pairs[(pairs >= len(self._closing.triangles)).all(axis=1)]
        one, other = self._gap_seam[pairs.T - len(self._closing.triangles)]
        group = np.minimum(one, other) * len(self._gaps_apart) + np.maximum(one, other)
        for key in np.unique(group):
            _, lengths = self._measured(x, np.ascontiguousarray(pairs[group == key]), 0.0)
            if (lengths[:, 1] < lengths[:, 0]).any():
                s, t = divmod(int(key), len(self._gaps_apart))
                self._gaps_apart[s, t] = self._gaps_apart[t, s] = False

    def largest_radii(self, x: Floats, radius: float, farthest: float) -> Floats:
        """How far each particle may move until the next search [m], (n,): farther than `radius` where nothing is near.

        To be asked before `candidates` at the same x (n, 3) [m].
        """
        if self.smooth is None:
            return np.full(len(x), radius)
        self.smooth.look(x, self.triangles)
        return np.clip(_SHARE_OF_TILE * self.smooth.room(self.triangles, len(x)), radius, farthest)

    def candidates(self, x: Floats, radius: float | Floats) -> tuple[Ints, Floats, Floats]:
        """All pairs that can come into contact while no particle moves farther than its radius from x (n, 3) [m].

        Args:
            x: positions [m].
            radius: [m], for all or for each particle, (n,).

        Returns:
            pairs as rows (s, 7), their offsets (s,) and distances (s,) [m].

        Raises:
            SceneError: dozens of layers lie at the same place.
        """
        if self._closing is not None:
            self._closing.look(x)
            self._searches += 1
            if self._searches % _GAP_SEARCHES == 0:
                self._let_gaps_in(x)
        return self._pairs_within(x, radius)

    def _pairs_within(self, x: Floats, radius: float | Floats) -> tuple[Ints, Floats, Floats]:
        pairs = self._overlapping(x, radius)
        if self._closing is not None:
            gap = pairs - len(self._closing.triangles)
            both: NDArray[np.bool_] = np.asarray((gap >= 0).all(axis=1))
            keep: NDArray[np.bool_] = np.asarray(~both)
            one, other = self._gap_seam[gap[both].T]
            keep[both] = self._gaps_apart[one, other]
            pairs = np.ascontiguousarray(pairs[keep])
        rows, lengths = self._measured(x, pairs, radius)
        return rows, np.ascontiguousarray(lengths[:, 0]), np.ascontiguousarray(lengths[:, 1])

    def _overlapping(self, x: Floats, radius: float | Floats) -> Ints:
        """Pairs of triangles whose boxes overlap when they are enlarged by half of the offset and the radii, (p, 2)."""
        if self._tree is None:
            self._tree = build_tree(x, self.triangles)
        refit_tree(self._tree, x, self.triangles, 0.5 * self.offset + radius)
        most = _MOST_PAIRS + _PAIRS_PER_TRIANGLE * len(self.triangles)
        left_out = NONE_LEFT_OUT
        if self.smooth is not None:
            left_out = node_windows(self._tree, self.smooth.windows.of_triangle, self.smooth.smooth)
        found = self_overlapping_pairs(self._tree, left_out, self._leaf_pairs, most)
        if found > most:
            raise SceneError(
                f"garment: too much of it lies at the same place, more than {most} pairs of triangles; place its "
                "panels apart from each other"
            )
        if found > len(self._leaf_pairs):
            self._leaf_pairs = np.zeros((found + found // 4, 2), dtype=np.int32)
            found = self_overlapping_pairs(self._tree, left_out, self._leaf_pairs, most)
        return self._leaf_pairs[:found]

    def _measured(self, x: Floats, pairs: Ints, radius: float | Floats) -> tuple[Ints, Floats]:
        """What is near in pairs of triangles (p, 2): rows (s, 7), and offsets and distances (s, 2) [m]."""
        number, neighbours = self.identity, self._neighbours
        if self._closing is not None:
            number, neighbours = self._closing.number, self._closing.neighbours
        triangles, own = self.triangles, self._representatives
        # Of the offset each of the two has a half.
        margin = np.array(np.broadcast_to(0.5 * self.offset + radius, len(x)))
        triangle_box, edge_box = triangle_boxes(x, triangles, margin), edge_boxes(x, own.edges, margin)
        vertices, sides = PairRoom(6), PairRoom(9)
        done = 0
        while done < len(pairs):
            vertices.make_room()
            sides.make_room()
            done = _box_pairs(
                x, margin, triangles, own, triangle_box, edge_box, number, pairs, done, vertices.pairs, vertices.count,
                sides.pairs, sides.count,
            )  # fmt: skip
        return _near_pairs(
            margin, triangles, triangle_box, own.edges, edge_box, number, *neighbours, self._room, self.offset,
            vertices.found, point_triangle_distances(x, x, triangles, vertices.found),
            sides.found, segment_distances(x, own.edges, x, own.edges, sides.found),
        )  # fmt: skip


def self_overlapping_pairs(tree: AabbTree, left_out: Ints, pairs: Ints, most: int = 2**62) -> int:
    """Traversal of a tree against itself: all pairs of different triangles whose boxes overlap, each once.

    left_out: smooth windows of each node, (nodes, 4), or none, (0, 4): what has one in common does not meet. At most
    len(pairs) are written to pairs (p, 2); the number found is returned. The search ends at more than `most`.
    """
    if len(tree.triangle) == 0:
        return 0
    return int(_overlapping_pairs(tree, left_out, np.zeros((2 * DEPTH, 2), dtype=np.int32), pairs, most))


@borrowing_kernel
def _overlapping_pairs(tree: AabbTree, left_out: Ints, stack: Ints, pairs: Ints, most: int) -> int:
    """As `self_overlapping_pairs`, of a tree that has leaves; stack: room for the pairs of nodes that wait."""
    found = zero()
    top = 1
    while top > 0 and found <= most:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        if i != j and not boxes_overlap(tree, i, tree, j):
            continue
        if left_out.shape[0] > 0 and common_window(left_out, i, j):
            continue
        if i == j:
            if tree.triangle[i] < 0:
                left, right = i + 1, tree.right[i]
                stack[top, 0], stack[top, 1] = right, right
                stack[top + 1, 0], stack[top + 1, 1] = left, right
                stack[top + 2, 0], stack[top + 2, 1] = left, left
                top += 3
            continue
        one, other = tree.triangle[i], tree.triangle[j]
        if one >= 0 and other >= 0:
            if found < pairs.shape[0]:
                pairs[found, 0] = one
                pairs[found, 1] = other
            found += 1
        # Nodes are in depth-first order, so the larger subtree is the one with more nodes up to its right child.
        elif other >= 0 or (one < 0 and tree.right[i] - i >= tree.right[j] - j):
            stack[top, 0], stack[top, 1] = tree.right[i], j
            stack[top + 1, 0], stack[top + 1, 1] = i + 1, j
            top += 2
        else:
            stack[top, 0], stack[top, 1] = i, tree.right[j]
            stack[top + 1, 0], stack[top + 1, 1] = i, j + 1
            top += 2
    return found


@borrowing_kernel
def _are_neighbours(start: Ints, neighbours: Ints, i: int, j: int) -> bool:
    for entry in range(start[i], start[i + 1]):
        if neighbours[entry] == j:
            return True
    return False


@borrowing_kernel
def _box_pairs(
    x: Floats,
    margin: Floats,
    triangles: Ints,
    cloth: Representatives,
    triangle_box: Floats,
    edge_box: Floats,
    number: Ints,
    leaf_pairs: Ints,
    first: int,
    vertices: Ints,
    vertices_found: Ints,
    sides: Ints,
    sides_found: Ints,
) -> int:
    """Whose boxes overlap in pairs of triangles (p, 2), but for what has a point (by number (n,)) in common.

    Shapes: x (n, 3), margin (n,) [m]; boxes of the triangles (m, 8) and sides (e, 8).

    (vertex, triangle) and (side, side) are added to vertices and sides, (any, 2); the numbers of those found, (1,)
    each, count them. Begins with pair `first`, and ends when it has no room for those of another one.

    Returns:
        the pair that is next.
    """
    vertex_count, side_count = vertices_found[0], sides_found[0]
    next_pair: int = leaf_pairs.shape[0]
    for pair in range(first, leaf_pairs.shape[0]):
        if vertex_count + 6 > vertices.shape[0] or side_count + 9 > sides.shape[0]:
            next_pair = pair
            break
        for turn in range(2):
            one, other = leaf_pairs[pair, turn], leaf_pairs[pair, 1 - turn]
            for k in range(cloth.own_vertices[one, 0]):
                i = cloth.own_vertices[one, 1 + k]
                li = number[i]
                shared = (
                    (li == number[triangles[other, 0]])
                    | (li == number[triangles[other, 1]])
                    | (li == number[triangles[other, 2]])
                )
                vertices[vertex_count, 0], vertices[vertex_count, 1] = i, other
                vertex_count += in_box(x, i, margin[i], triangle_box, other) & (not shared)
        one, other = leaf_pairs[pair, 0], leaf_pairs[pair, 1]
        for k in range(cloth.own_edges[one, 0]):
            i = cloth.own_edges[one, 1 + k]
            lp, lq = number[cloth.edges[i, 0]], number[cloth.edges[i, 1]]
            for m in range(cloth.own_edges[other, 0]):
                j = cloth.own_edges[other, 1 + m]
                la, lb = number[cloth.edges[j, 0]], number[cloth.edges[j, 1]]
                shared = (lp == la) | (lp == lb) | (lq == la) | (lq == lb)
                sides[side_count, 0], sides[side_count, 1] = i, j
                side_count += overlap(edge_box, i, edge_box, j) & (not shared)
    vertices_found[0], sides_found[0] = vertex_count, side_count
    return next_pair


@kernel
def _near_pairs(
    margin: Floats,
    triangles: Ints,
    triangle_box: Floats,
    edges: Ints,
    edge_box: Floats,
    number: Ints,
    start: Ints,
    neighbours: Ints,
    room: Floats,
    offset: float,
    vertices: Ints,
    vertex_distance: Floats,
    sides: Ints,
    side_distance: Floats,
) -> tuple[Ints, Floats]:
    """Pairs within both sides' margins as rows (s, 7), and their offset and distance (s, 2) [m]."""
    rows = np.empty((vertices.shape[0] + sides.shape[0], 7), dtype=np.int32)
    lengths = np.empty((rows.shape[0], 2))
    count = 0
    for pair in range(vertices.shape[0]):
        i, t = vertices[pair, 0], vertices[pair, 1]
        if vertex_distance[pair] >= margin[i] + triangle_box[t, 6]:
            continue
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        li = number[i]
        apart = offset
        if (
            _are_neighbours(start, neighbours, li, number[a])
            or _are_neighbours(start, neighbours, li, number[b])
            or _are_neighbours(start, neighbours, li, number[c])
        ):
            apart = min(offset, min(room[i], min(room[a], min(room[b], room[c]))))
        write_pair(rows, count, CLOTH_VERTEX, i, a, b, c, -1, -1)
        lengths[count, 0], lengths[count, 1] = apart, vertex_distance[pair]
        count += 1
    for pair in range(sides.shape[0]):
        i, j = sides[pair, 0], sides[pair, 1]
        if side_distance[pair] >= edge_box[i, 6] + edge_box[j, 6]:
            continue
        p, q, a, b = edges[i, 0], edges[i, 1], edges[j, 0], edges[j, 1]
        lp, lq, la, lb = number[p], number[q], number[a], number[b]
        apart = offset
        if (
            _are_neighbours(start, neighbours, lp, la)
            or _are_neighbours(start, neighbours, lp, lb)
            or _are_neighbours(start, neighbours, lq, la)
            or _are_neighbours(start, neighbours, lq, lb)
        ):
            apart = min(offset, min(min(room[p], room[q]), min(room[a], room[b])))
        write_pair(rows, count, CLOTH_SIDE, p, q, a, b, -1, -1)
        lengths[count, 0], lengths[count, 1] = apart, side_distance[pair]
        count += 1
    return rows[:count].copy(), lengths[:count].copy()
