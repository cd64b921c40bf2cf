"""Start positions at which a limb lies between the seams of a sleeve, for bodies that hold it elsewhere.

Seams pull in straight lines. Where such a line passes through an arm, its ends may close on either side of it or not at
all; panels in front of and behind the arm are moved along themselves until the lines pass beside it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cloth_core.blocked_lines import BlockedLines, seam_lines
from cloth_core.body import Body
from cloth_core.garment import Garment, Seam
from cloth_core.placement import crosses_more
from cloth_core.sewn_pairs import sewn_pairs

__all__ = ["with_room_for_limbs"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Lines between the insides of two panels that are looked at.
_INSIDE = 96
# Exact tests of lines with triangles, after which no more panels move; about 0.4 s.
_MOST_TESTS = 2_000_000
# A limb lies in a seam of at least this length [m] if it blocks this share of its lines.
_LEAST_LENGTH, _LEAST_BLOCKED = 0.15, 0.6
# Farthest way of a pair of panels, and the step in which it is tried [m].
_FARTHEST, _STEP = 0.12, 0.01
# Directions in which something would cross, after which the best way so far is taken; each takes some 20 ms to find.
_MOST_BARRED = 40
# Cosine of the angle from which on two directions are the same.
_SAME = 0.98


def with_room_for_limbs(garment: Garment, body: Body) -> Garment:
    """Move pairs of panels that are sewn to each other along two seams or more, where a limb lies in a seam.

    Both move together, across the way between them, by 12 cm at most: to where the fewest lines of their seams pass
    through the body, but not fewer of those between their insides than at first, so that the limb gets between the
    panels and not beside them. No more crosses there than before.
    """
    counter = BlockedLines(body, _MOST_TESTS)
    for first, second, seams in sewn_pairs(garment):
        if max(_blocked_share(garment, seam, counter) for seam in seams) < _LEAST_BLOCKED:
            continue
        one, other = garment.panel_of_particle == first, garment.panel_of_particle == second
        across = garment.start[other].mean(axis=0) - garment.start[one].mean(axis=0)
        if np.linalg.norm(across) < _STEP:
            continue
        way = _freest_way(garment, one, other, across, body, counter)
        if way.any():
            garment = replace(garment, start=garment.start + np.outer(one | other, way))
        if counter.spent:
            break
    return garment


def _freest_way(
    garment: Garment, one: Bools, other: Bools, across: Floats, body: Body, counter: BlockedLines
) -> Floats:
    """The shortest way [m], (3,), of a pair of panels to where the fewest lines of their seams are blocked.

    Ways to where more would cross than before are left out, and those that go farther in the same direction.
    """
    own = one | other
    lines = seam_lines([s for s in garment.seams if own[s.first].any() or own[s.second].any()])
    inside = np.flatnonzero(one)[:: max(1, int(one.sum()) // _INSIDE)]
    rows = np.arange(len(inside), dtype=np.int32)
    between = np.stack([rows, rows + len(rows)], axis=1)

    def within(way: Floats, enough: int | None = None) -> int:
        """Lines between the insides that pass through the body."""
        x = garment.start[inside] + way
        return counter.count(np.concatenate([x, x + across]), between, enough)

    best = np.zeros(3)
    fewest, kept = counter.count(garment.start, lines), within(best)
    barred: list[Floats] = []
    for way in _ways(across):
        if fewest == 0 or len(barred) == _MOST_BARRED:
            break
        if any(way @ bar > _SAME * np.linalg.norm(way) * np.linalg.norm(bar) for bar in barred):
            continue
        start = garment.start + np.outer(own, way)
        of_seams = counter.count(start, lines, enough=fewest)
        if of_seams < fewest and within(way, enough=kept) >= kept:
            if crosses_more(garment, start, body):
                barred.append(way)
            else:
                best, fewest = way, of_seams
        if counter.spent:
            # Where so much is in the way it is no limb; half a search would find half a way.
            return np.zeros(3)
    return best


def _ways(across: Floats) -> list[Floats]:
    """Ways (3,) [m] that are tried, at right angles to `across` (3,), the shortest first."""
    along = np.cross(across, np.eye(3)[np.argmin(np.abs(across))])
    plane = np.stack([along, np.cross(across, along)])
    plane /= np.linalg.norm(plane, axis=1)[:, None]
    steps = np.arange(-_FARTHEST, _FARTHEST + 0.5 * _STEP, _STEP)
    ways = sorted((np.array(pair) @ plane for pair in product(steps, steps)), key=lambda way: float(way @ way))
    return [way for way in ways if float(way @ way) <= (_FARTHEST + 1e-9) ** 2]


def _blocked_share(garment: Garment, seam: Seam, counter: BlockedLines) -> float:
    """Share of a seam's lines that pass through the body; 0 for a short one."""
    sides = garment.rest[seam.first]
    if np.linalg.norm(np.diff(sides, axis=0), axis=1).sum() < _LEAST_LENGTH:
        return 0.0
    lines = seam_lines([seam])
    return counter.count(garment.start, lines) / max(len(lines), 1)
