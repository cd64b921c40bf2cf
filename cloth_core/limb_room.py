"""Start positions at which a limb lies between the seams of a sleeve, for bodies that hold it elsewhere.

Seams pull in straight lines. Where such a line passes through an arm, its ends may close on either side of it or not at
all; panels in front of and behind the arm are moved along themselves until the lines pass beside it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.garment import Garment, Seam
from cloth_core.intersections import crossing_edges
from cloth_core.placement import crosses_more

__all__ = ["blocked_lines", "seam_lines", "with_room_for_limbs"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Lines of each seam, and of each panel, that are looked at.
_LINES = 24
# A limb lies in a seam of at least this length [m] if it blocks this share of its lines.
_LEAST_LENGTH, _LEAST_BLOCKED = 0.15, 0.6
# Farthest way of a pair of panels, and the step in which it is tried [m].
_FARTHEST, _STEP = 0.12, 0.01


def with_room_for_limbs(garment: Garment, body: Body) -> Garment:
    """Move pairs of panels that are sewn to each other along two seams or more, where a limb lies in a seam.

    Both move together, across the way between them, by 12 cm at most: to where the fewest lines of their seams pass
    through the body, but not fewer of those between their insides than at first, so that the limb gets between the
    panels and not beside them. Nothing moves if then more crosses at the start than before.
    """
    for (first, second), seams in _pairs(garment):
        if max(_blocked_share(garment, seam, body) for seam in seams) < _LEAST_BLOCKED:
            continue
        one, other = garment.panel_of_particle == first, garment.panel_of_particle == second
        across = garment.start[other].mean(axis=0) - garment.start[one].mean(axis=0)
        distance = float(np.linalg.norm(across))
        if distance < _STEP:
            continue
        along = np.cross(across, np.eye(3)[np.argmin(np.abs(across))])
        plane = np.stack([along, np.cross(across, along)])
        plane /= np.linalg.norm(plane, axis=1)[:, None]
        own = one | other
        own_lines = seam_lines([s for s in garment.seams if own[s.first].any() or own[s.second].any()])
        inside = np.flatnonzero(one)[:: max(1, int(one.sum()) // (4 * _LINES))]

        def blocked(way: Floats) -> tuple[int, int]:
            """Lines of the seams, and between the insides, that pass through the body."""
            x = garment.start + np.outer(own, way)  # noqa: B023
            ends = np.concatenate([x[inside], x[inside] + across])  # noqa: B023
            rows = np.arange(len(inside), dtype=np.int32)  # noqa: B023
            between = np.stack([rows, rows + len(rows), rows + len(rows)], axis=1)
            return blocked_lines(x, own_lines, body), blocked_lines(ends, between, body)  # noqa: B023

        steps = np.arange(-_FARTHEST, _FARTHEST + 0.5 * _STEP, _STEP)
        ways = sorted((np.array(pair) @ plane for pair in product(steps, steps)), key=lambda way: float(way @ way))
        ways = [way for way in ways if float(way @ way) <= (_FARTHEST + 1e-9) ** 2]
        counts = [blocked(way) for way in ways]
        seam = [of_seam if within >= counts[0][1] else len(own_lines) for of_seam, within in counts]
        garment = _moved(garment, own, ways[int(np.argmin(seam))], body)
    return garment


def _blocked_share(garment: Garment, seam: Seam, body: Body) -> float:
    """Share of a seam's lines that pass through the body; 0 for a short one."""
    sides = garment.rest[seam.first]
    if np.linalg.norm(np.diff(sides, axis=0), axis=1).sum() < _LEAST_LENGTH:
        return 0.0
    lines = seam_lines([seam])
    return blocked_lines(garment.start, lines, body) / max(len(lines), 1)


def _pairs(garment: Garment) -> list[tuple[tuple[int, int], list[Seam]]]:
    """Pairs of panels with the seams between them, where there are several."""
    found: dict[tuple[int, int], list[Seam]] = {}
    for seam in garment.seams:
        one, other = sorted(int(garment.panel_of_particle[side[0]]) for side in (seam.first, seam.second))
        if one != other:
            found.setdefault((one, other), []).append(seam)
    return [(pair, seams) for pair, seams in found.items() if len(seams) > 1]


def seam_lines(seams: list[Seam]) -> Ints:
    """Some lines between points that are to be sewn together, evenly along each seam, as flat triangles (k, 3)."""
    rows = []
    for seam in seams:
        which = np.unique(np.linspace(0, len(seam.first) - 1, _LINES).round().astype(int))
        rows.append(np.stack([seam.first[which], seam.second[which], seam.second[which]], axis=1))
    lines = np.concatenate(rows)
    return np.asarray(lines[lines[:, 0] != lines[:, 1]], dtype=np.int32)


def blocked_lines(x: Floats, lines: Ints, body: Body) -> int:
    """How many lines pass through the body with points at x (n, 3) [m]."""
    return len(crossing_edges(x, lines, body.vertices, body.triangles, body.tree))


def _moved(garment: Garment, own: NDArray[np.bool_], way: Floats, body: Body) -> Garment:
    start = garment.start + np.outer(own, way)
    return garment if crosses_more(garment, start, body) else replace(garment, start=start)
