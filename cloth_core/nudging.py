"""Takes single sides of cloth out of each other by moving a few points by a few millimetres.

What merges moves by half of its gap, and where cloth lies close beside it something may cross then that did not before.
The search is greedy and local: it is meant for the last crossings of a seam, not for cloth that is entangled.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.blocked_lines import BlockedLines
from cloth_core.body import Body
from cloth_core.body_crossings import BodyCrossings
from cloth_core.intersections import segment_crosses, self_crossing_pairs
from cloth_core.kernel import borrowing_kernel

__all__ = ["nudged_apart"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Ways that are tried [m], the shortest first, in each of 26 directions: to all neighbours in a lattice.
_WAYS = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.012)
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
# More crossings than this are left alone.
_MOST = 40


def nudged_apart(x: Floats, triangles: Ints, body: Body | None, allowed: int) -> tuple[Floats, int]:
    """Positions in which at most `allowed` sides cross, if moving single points by up to 12 mm does it.

    Args:
        x: positions [m], (n, 3).
        triangles: (m, 3).
        body: or None.
        allowed: how many sides may cross.

    Returns:
        positions [m], (n, 3), and how many sides cross there: never more than at x.
    """
    found = _Crossings.of(x, triangles, body)
    if found.total <= allowed or not 0 < found.number <= _MOST:
        return x, found.total
    # Nothing but the triangles of a point that moves can change how much crosses.
    low, high = x[found.points].min(axis=0), x[found.points].max(axis=0)
    longest = np.linalg.norm(x[triangles[:, 0]] - x[triangles[:, 1]], axis=1).max() + max(_WAYS)
    corner = x[triangles]
    near = ((corner.min(axis=1) <= high + 2.0 * longest) & (corner.max(axis=1) >= low - 2.0 * longest)).all(axis=1)
    nearby = np.ascontiguousarray(triangles[near])
    count = found.total
    found = _Crossings.of(x, nearby, body)
    elsewhere = count - found.total
    x = x.copy()
    while elsewhere + found.total > allowed:
        better = _better(x, nearby, body, found)
        if better is None:
            break
        point, place, found = better
        x[point] = place
    return x, elsewhere + found.total


class _Crossings(NamedTuple):
    """What crosses cloth or body.

    Attributes:
        number: of the sides of the cloth that cross; points: of what crosses, and the triangles that are crossed.
        tips: number of the sides of the body that cross the cloth; they are not moved out, only never made more.
        sides: all of the cloth, (e, 2); pairs: a side and the triangle of cloth that it crosses, (k, 2).
        through_body: the sides that cross the body.
    """

    number: int
    tips: int
    points: Ints
    sides: Ints
    pairs: Ints
    through_body: Ints

    @classmethod
    def of(cls, x: Floats, triangles: Ints, body: Body | None) -> _Crossings:
        sides, pairs = self_crossing_pairs(x, triangles)
        count = len(np.unique(pairs[:, 0]))
        points = [sides[pairs[:, 0]].ravel(), triangles[pairs[:, 1]].ravel()]
        through_body, tips = np.zeros(0, dtype=np.int32), 0
        if body is not None:
            crossings = BodyCrossings.of(x, triangles, body)
            through_body = np.unique(crossings.through_body[:, 0])
            count += len(through_body)
            tips = crossings.body_sides_through_cloth
            points.append(sides[through_body].ravel())
        return cls(count, tips, np.unique(np.concatenate(points)), sides, pairs, through_body)

    @property
    def total(self) -> int:
        return self.number + self.tips


class _Surroundings(NamedTuple):
    """What can cross differently when one point moves.

    Attributes:
        fixed: sides that cross whatever it does, once for the cloth and once for the body.
        sides, triangles: that move with it, (a, 2) and (b, 3).
        other_sides: that may cross those triangles and do not yet cross others, (c, 2).
        other_triangles: that those sides may cross, (d, 3).
    """

    fixed: int
    sides: Ints
    triangles: Ints
    other_sides: Ints
    other_triangles: Ints

    @classmethod
    def of(cls, x: Floats, triangles: Ints, found: _Crossings, point: int) -> _Surroundings:
        own = (triangles == point).any(axis=1)
        own_side = (found.sides == point).any(axis=1)
        star = x[triangles[own]].reshape(-1, 3)
        low, high = star.min(axis=0) - max(_WAYS), star.max(axis=0) + max(_WAYS)
        near, near_side = (
            ((x[each].min(axis=1) <= high) & (x[each].max(axis=1) >= low)).all(axis=1)
            for each in (triangles, found.sides)
        )
        still = found.pairs[~own_side[found.pairs[:, 0]] & ~own[found.pairs[:, 1]], 0]
        crosses = np.zeros(len(found.sides), dtype=np.bool_)
        crosses[still] = True
        return cls(
            fixed=int(crosses.sum()) + int((~own_side[found.through_body]).sum()),
            sides=np.ascontiguousarray(found.sides[own_side]),
            triangles=np.ascontiguousarray(triangles[own]),
            other_sides=np.ascontiguousarray(found.sides[near_side & ~own_side & ~crosses]),
            other_triangles=np.ascontiguousarray(triangles[near & ~own]),
        )

    def crossings(self, x: Floats, body: BlockedLines | None) -> int:
        """How many sides cross at x (n, 3) [m], where only the point has moved."""
        every = np.concatenate([self.other_triangles, self.triangles])
        crossing = _crossing_sides(x, self.sides, every) + _crossing_sides(x, self.other_sides, self.triangles)
        return self.fixed + crossing + (body.count(x, self.sides) if body is not None else 0)


def _better(x: Floats, triangles: Ints, body: Body | None, found: _Crossings) -> tuple[int, Floats, _Crossings] | None:
    """A point, the nearest place for it at which fewer sides cross than by now, and what crosses then."""
    through_body = BlockedLines(body) if body is not None else None
    around = [_Surroundings.of(x, triangles, found, point) for point in found.points.tolist()]
    for way in _WAYS:
        for point, surroundings in zip(found.points.tolist(), around, strict=True):
            before = x[point].copy()
            for direction in _DIRECTIONS:
                x[point] = before + way * direction
                if surroundings.crossings(x, through_body) >= found.number:
                    continue
                then = _Crossings.of(x, triangles, body)
                if then.number < found.number and then.tips <= found.tips:
                    place = x[point].copy()
                    x[point] = before
                    return point, place, then
            x[point] = before
    return None


@borrowing_kernel
def _crossing_sides(x: Floats, sides: Ints, triangles: Ints) -> int:
    """How many of some sides (e, 2) pass through a triangle (m, 3) with which they share no corner."""
    count = 0
    for e in range(sides.shape[0]):
        i, j = sides[e, 0], sides[e, 1]
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if a == i or a == j or b == i or b == j or c == i or c == j:
                continue
            apart = False
            for k in range(3):
                low, high = min(x[i, k], x[j, k]), max(x[i, k], x[j, k])
                apart = apart or max(x[a, k], max(x[b, k], x[c, k])) < low or min(x[a, k], min(x[b, k], x[c, k])) > high
            if not apart and segment_crosses(x[i], x[j], x[a], x[b], x[c]):
                count += 1
                break
    return count
