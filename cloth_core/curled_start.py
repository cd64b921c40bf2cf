"""Start positions curled around the body, for panels whose side seams an arm or a hand lies in.

A panel is flat at the start and wider there than once it is worn: next to a body that holds its arms near, the sides of
a skirt or a shirt start outside of them. The seams then cannot close but around the arm. Curled about an upright axis,
like paper about a pole and without any strain, the sides lie between the arm and the body.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.blocked_lines import BlockedLines, seam_lines
from cloth_core.body import Body
from cloth_core.garment import Garment
from cloth_core.intersections import crossing_edges
from cloth_core.placement import crosses_more
from cloth_core.sewn_pairs import SewnPair, sewn_pairs

__all__ = ["curled_inside_limbs"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

# Panels are curled that stand upright, up to this height of their normals.
_UPRIGHT = 0.5
# So many of a side's lines must pass through the body for its panels to be curled.
_LEAST_BLOCKED = 2
# Width of what is curled: the least, and the step in which it is tried [m].
_LEAST_WIDTH, _STEP = 0.04, 0.02
# Between the curled edges of two panels at the start [m].
_GAP = 0.01
# Shares of the blocked lines: at most so many may be left for a curl to be of use; and of those between the insides of
# the panels at least so many must, since what is inside of a sleeve or a trouser leg has to stay there.
_LEFT, _KEPT = 0.5, 0.9
# Lines between the insides of two panels that are looked at.
_INSIDE = 100
# Exact tests of lines with triangles, after which the best curls so far are taken; about 0.4 s.
_MOST_TESTS = 2_000_000


def curled_inside_limbs(garment: Garment, body: Body) -> Garment:
    """Curl the sides of panels in front of and behind the body inwards where a limb lies in the seams between them.

    Both panels of a pair are curled in the same way, a quarter of a turn, by the least width with which the fewest
    lines of their seams pass through the body; they move apart where the curl needs room. Nothing is curled if more
    crosses then than before, or if that shuts out what lies inside of the panels.
    """
    counter = BlockedLines(body, _MOST_TESTS)
    for pair in sewn_pairs(garment):
        if not _faces_away(garment, pair):
            continue
        for side in (1.0, -1.0):
            garment = _curled(garment, body, pair, side, counter)
    return garment


def _faces_away(garment: Garment, pair: SewnPair) -> bool:
    """Whether two panels stand upright and face away from each other."""
    normals = garment.panel_normals[[pair.first, pair.second]]
    return bool(normals[0] @ normals[1] < 0.0 and (np.abs(normals[:, 2]) < _UPRIGHT).all())


def _curled(garment: Garment, body: Body, pair: SewnPair, side: float, counter: BlockedLines) -> Garment:
    """The garment with one side of a pair of panels curled, if that is of use."""
    x = garment.start
    one, other = garment.panel_of_particle == pair.first, garment.panel_of_particle == pair.second
    own = one | other
    outwards = garment.panel_normals[pair.first] - garment.panel_normals[pair.second]
    outwards /= np.linalg.norm(outwards)
    halves = [_Half.of(x, one, garment.panel_normals[pair.first], outwards, side)]
    halves.append(_Half.of(x, other, garment.panel_normals[pair.second], -outwards, -side))
    across = np.zeros(len(x))
    for half in halves:
        across[half.own] = half.across
    width_of_pair = float(np.ptp(across[own]))
    middle = across[own].min() + 0.5 * width_of_pair
    outer = [s for s in pair.seams if across[np.concatenate([s.first, s.second])].mean() > middle]
    if not outer:
        return garment
    outer_lines = seam_lines(outer)
    if counter.count(x, outer_lines) < _LEAST_BLOCKED:
        return garment
    lines = seam_lines([s for s in garment.seams if own[s.first].any() or own[s.second].any()])
    plane = 0.5 * float(np.median(x[one] @ outwards) + np.median(x[other] @ outwards))
    inside = np.flatnonzero(one)[:: max(1, int(one.sum()) // _INSIDE)]

    def blocked(places: Floats) -> tuple[int, int, int]:
        """Lines of this side's seams, of all seams, and between the insides, that pass through the body."""
        back = places[inside] - 2.0 * np.outer(places[inside] @ outwards - plane, outwards)
        rows = np.arange(len(inside), dtype=np.int32)
        between = np.stack([rows, rows + len(rows)], axis=1)
        within = counter.count(np.concatenate([places[inside], back]), between)
        return counter.count(places, outer_lines), counter.count(places, lines), within

    fewest, most, within = blocked(x)
    enough, best = _LEFT * fewest, x
    for width in np.arange(_LEAST_WIDTH, width_of_pair, _STEP):
        places = x.copy()
        places[one] = halves[0].curled(width, plane)
        places[other] = halves[1].curled(width, -plane)
        here, everywhere, kept = blocked(places)
        if counter.spent:
            break
        if here >= fewest or here > enough or everywhere > most or kept < _KEPT * within:
            continue
        if _is_free(garment, places, own, body):
            fewest, best = here, places
    return garment if best is x else replace(garment, start=best)


class _Half(NamedTuple):
    """One panel of a pair.

    Attributes:
        x: its particles [m], (n, 3); own: which of the garment's they are.
        normal: of the panel, (3,); outwards: away from the other panel, (3,).
        sideways: level direction in the panel, (3,); across: how far each particle is in it [m], (n,).
    """

    x: Floats
    own: Bools
    normal: Floats
    outwards: Floats
    sideways: Floats
    across: Floats

    @classmethod
    def of(cls, x: Floats, own: Bools, normal: Floats, outwards: Floats, side: float) -> _Half:
        sideways = side * np.cross([0.0, 0.0, 1.0], normal)
        sideways /= np.linalg.norm(sideways)
        return cls(x[own], own, normal, outwards, sideways, x[own] @ sideways)

    def curled(self, width: float, plane: float) -> Floats:
        """Places [m] with so much of the side [m] curled by a quarter of a turn.

        The panel goes outwards as far as keeps the curl on its side of the plane between the two panels.
        """
        radius = 2.0 * width / np.pi
        angle = np.maximum(self.across - (self.across.max() - width), 0.0) / radius
        curl = np.outer(radius * (np.sin(angle) - angle), self.sideways)
        curl -= np.outer(radius * (1.0 - np.cos(angle)), self.normal)
        before, after = (float((x @ self.outwards).min()) - plane for x in (self.x, self.x + curl))
        lacking = max(min(0.5 * _GAP, before) - after, 0.0) / float(self.normal @ self.outwards)
        return np.asarray(self.x + curl + lacking * self.normal)


def _is_free(garment: Garment, start: Floats, own: Bools, body: Body) -> bool:
    """Whether no more crosses at start (n, 3) [m] than before, neither cloth nor thin parts of the body."""
    if crosses_more(garment, start, body):
        return False
    low, high = start[own].min(axis=0), start[own].max(axis=0)
    corners = body.vertices[body.triangles]
    near = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= low).all(axis=1)
    panels = np.ascontiguousarray(garment.triangles[own[garment.triangles[:, 0]]])
    return len(crossing_edges(body.vertices, body.triangles[near], start, panels)) == 0
