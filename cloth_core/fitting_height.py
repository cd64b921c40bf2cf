"""How far a garment is lifted or lowered at the start where its pattern was placed for a taller or a shorter body.

Seams pull in straight lines. Those of a shoulder that starts below the body's own pass through the body and cannot
close, and a sleeve that starts above the arm ends up beside it. Nothing that starts too low comes up by itself; what
starts a little too high comes down when it is sewn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cloth_core.blocked_lines import BlockedLines, seam_lines
from cloth_core.body import Body
from cloth_core.errors import SceneError
from cloth_core.garment import Garment, Seam
from cloth_core.pattern import Pattern
from cloth_core.sewn_pairs import sewn_pairs
from cloth_core.start_around_body import started_around

__all__ = ["fitting_lift", "lifted"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# The pattern is looked at with particles so far apart [m], or with so many along a square of its area: it starts
# equally high then however fine the run is.
_SPACING, _ACROSS_AREA = 0.03, 30
# Lifts that are tried, as shares of the body's height; down every other one, of which so many are looked at closely.
_FARTHEST, _STEP, _CLOSELY = 0.24, 0.015, 4
# A seam lies across if it rises less than its length times this, and a panel that comes nearer to the garment's middle
# than this share of the garment's width belongs to the trunk.
_ACROSS, _MIDDLE = 0.7, 0.1
# Lines between the insides of two panels that are looked at; of what lies between at least this share has to stay.
_INSIDE, _KEPT = 96, 0.7
# A line of a seam that passes through the body counts as much as so many lines between insides that do not.
_WEIGHT = 2.0
# A garment is lowered only if at least so much of a seam passes through the body where it is, or if so many times as
# much of the body lies between the panels further down; and only if that gets better by this share. Of shifts that
# bring nearly as much as the best, by this share, the shortest is taken.
_SEAM_BLOCKED, _FAR_OFF, _GAIN, _NEARLY = 0.25, 1.5, 0.08, 0.9
# Exact tests of lines with triangles, after which nothing is moved; about 0.4 s. Garments on bodies take a fiftieth.
_MOST_TESTS = 2_000_000
# Seams with fewer lines are not looked at by themselves.
_FEWEST_LINES = 4


def fitting_lift(pattern: Pattern, body: Body, gap: float) -> float:
    """How far a garment has to be lifted for the seams across its top to close over the body [m]; 0 if it can be sewn.

    Negative where it has to be lowered, so that more of the body lies in it. A garment that has no such seams, as a
    skirt or a single sheet, stays where its pattern puts it.

    Args:
        pattern: one garment.
        body: what it is worn by.
        gap: between both at the start [m].

    Raises:
        ClothError: a panel cannot be meshed.
    """
    spacing = min(_SPACING, math.sqrt(pattern.area) / _ACROSS_AREA)
    fitting = _Fitting(Garment.from_pattern(pattern, spacing), body, gap)
    lift = fitting.lift()
    return 0.0 if fitting.spent else lift


def lifted(garment: Garment, worn: Sequence[Pattern], lifts: Sequence[float], body: Body | None) -> Garment:
    """A garment with each of its layers moved upwards, and a line of warning for each that is.

    Args:
        garment: as the patterns put it.
        worn: pattern of each layer.
        lifts: of each layer [m].
        body: what it is worn by, if anything.

    Raises:
        SceneError: there is not one finite lift for each layer.
    """
    if len(lifts) != len(worn) or not np.isfinite(lifts).all():
        raise SceneError(f"lifts: {list(lifts)!r} are not {len(worn)} finite numbers; give one for each garment in m")
    start, warnings = garment.start.copy(), list(garment.warnings)
    start[:, 2] += np.asarray(lifts, dtype=float)[garment.layer_of_particle]
    for pattern, lift in zip(worn, lifts, strict=True):
        if lift != 0.0:
            where = f"{1000.0 * abs(lift):.0f} mm {'above' if lift > 0.0 else 'below'} where its pattern puts it"
            fit = "" if body is None else f", to fit body '{body.name}'"
            warnings.append(f"garment '{pattern.name}': starts {where}{fit}")
    return replace(garment, start=start, warnings=tuple(warnings))


class _Fitting:
    """The search for one garment."""

    def __init__(self, garment: Garment, body: Body, gap: float) -> None:
        self._garment = garment
        self._body = body
        self._gap = gap
        self._counter = BlockedLines(body, _MOST_TESTS)
        self._top = seam_lines([seam for seam in garment.seams if _is_across_the_top(garment, seam)])
        self._inside = _inside(garment)

    @property
    def spent(self) -> bool:
        """Whether so much was in the way that the search was broken off."""
        return self._counter.spent

    def lift(self) -> float:
        """How far upwards the garment fits [m]; 0 for where it is."""
        if len(self._top) == 0:
            return 0.0
        ways = _STEP * np.ptp(self._body.vertices[:, 2]) * np.arange(1, round(_FARTHEST / _STEP) + 1)
        if self._top_blocked(0.0):
            return self._freed([*ways.tolist(), *(-ways).tolist()])
        return self._lowered((-ways[1::2]).tolist())

    def _freed(self, shifts: Sequence[float]) -> float:
        """To where the seams across the top are free: upwards over the shoulders, or downwards below the head."""
        least = _KEPT * self._between(0.0)
        lines = seam_lines(list(self._garment.seams))
        worth = {
            s: between - _WEIGHT * self._counter.count(_shifted(self._garment.start, s), lines)
            for s in shifts
            if not self._top_blocked(s) and (between := self._between(s)) >= least
        }
        if not worth:
            return 0.0
        enough = max(worth.values()) - (1.0 - _NEARLY) * self._between(0.0)
        return min((s for s in worth if worth[s] >= enough), key=abs)

    def _lowered(self, shifts: Sequence[float]) -> float:
        """Down to where more of the body lies between the panels."""
        here = self._between(0.0)
        between = {s: self._between(s) for s in shifts if not self._top_blocked(s)}
        better = sorted(
            (s for s in between if between[s] > (1.0 + 0.5 * _GAIN) * here), key=lambda s: (-between[s], -s)
        )
        is_far_off = bool(better) and between[better[0]] > _FAR_OFF * here
        if not better or not (is_far_off or self._worst_seam(self._garment) >= _SEAM_BLOCKED):
            return 0.0
        start = self._started(0.0)
        if start is not None and not is_far_off and self._worst_seam(start) < _SEAM_BLOCKED:
            return 0.0
        started = {s: self._started(s) for s in better[:_CLOSELY]}
        worth = {s: between[s] - _WEIGHT * self._blocked(g) for s, g in started.items() if g is not None}
        if not worth:
            return 0.0
        best = max(worth.values())
        # Where it cannot be put at all, any place is better.
        gain = best - (here - _WEIGHT * self._blocked(start)) if start is not None else max(best, 1.0)
        if gain < max(_GAIN * here, 1.0):
            return 0.0
        return max(s for s in worth if worth[s] >= best - (1.0 - _NEARLY) * gain)

    def _top_blocked(self, shift: float) -> int:
        """Lines of the seams across the top that pass through the body."""
        return self._counter.count(_shifted(self._garment.start, shift), self._top)

    def _between(self, shift: float) -> int:
        """Lines between the insides of panels that pass through the body."""
        rows = np.arange(len(self._inside), dtype=np.int32).reshape(-1, 2)
        return self._counter.count(_shifted(self._inside, shift), rows)

    def _started(self, shift: float) -> Garment | None:
        """As the garment starts when it is put there; None where it cannot."""
        garment = replace(self._garment, start=_shifted(self._garment.start, shift))
        try:
            return started_around(garment, self._body, self._gap)
        except SceneError:
            return None

    def _blocked(self, garment: Garment) -> int:
        """Lines of seams that pass through the body."""
        return self._counter.count(garment.start, seam_lines(list(garment.seams)))

    def _worst_seam(self, garment: Garment) -> float:
        """Largest share of a seam's lines that pass through the body."""
        shares = [0.0]
        for seam in garment.seams:
            lines = seam_lines([seam])
            if len(lines) >= _FEWEST_LINES:
                shares.append(self._counter.count(garment.start, lines) / len(lines))
        return max(shares)


def _is_across_the_top(garment: Garment, seam: Seam) -> bool:
    """Whether a seam joins two panels that face different ways, across and in the upper half of a panel of the trunk.

    Sleeves do not count: whether their seams are free depends on how the body holds its arms.
    """
    one, other = (int(garment.panel_of_particle[side[0]]) for side in (seam.first, seam.second))
    if one == other or garment.panel_normals[one] @ garment.panel_normals[other] > 0.0:
        return False
    x = garment.start[seam.first]
    way = x[-1] - x[0]
    panel = garment.start[garment.panel_of_particle == one]
    if abs(way[2]) >= _ACROSS * np.linalg.norm(way) or x[:, 2].mean() <= panel[:, 2].mean():
        return False
    sideways = np.cross([0.0, 0.0, 1.0], garment.panel_normals[one])
    of_garment, of_panel = garment.start @ sideways, panel @ sideways
    margin = _MIDDLE * float(np.ptp(of_garment))
    middle = 0.5 * float(of_garment.min() + of_garment.max())
    return bool(of_panel.min() <= middle + margin and of_panel.max() >= middle - margin)


def _inside(garment: Garment) -> Floats:
    """Ends of lines from some points of a panel across to the one it is sewn to all around, (2 k, 3) [m]: two each."""
    ends = [np.zeros((0, 2, 3))]
    for pair in sewn_pairs(garment):
        one, other = (np.flatnonzero(garment.panel_of_particle == k) for k in (pair.first, pair.second))
        x = garment.start[one[:: max(1, len(one) // _INSIDE)]]
        across = garment.start[other].mean(axis=0) - garment.start[one].mean(axis=0)
        ends.append(np.stack([x, x + across], axis=1))
    return np.concatenate(ends).reshape(-1, 3)


def _shifted(x: Floats, shift: float) -> Floats:
    return np.asarray(x + np.array([0.0, 0.0, shift]), dtype=np.float64)
