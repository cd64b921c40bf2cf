"""Regions of the cloth that lie still are not stepped while the rest moves.

A particle sleeps when it is still, and so is all that could pull or push it: its neighbours along two sides of the
mesh, and what it touches. It has no velocity and takes no force, and what acts between sleeping particles is left out
of the loops. The awake particles next to it wake it as soon as one of them is a micrometre from where it lay, and with
it the neighbours around, so that a pull spreads as it would have.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.contact_state import ContactState
from cloth_core.kernel import kernel
from cloth_core.lanes import LANES
from cloth_core.model import Model
from cloth_core.rest import RestWatch
from cloth_core.runs import Runs
from cloth_core.step import ForceTerms

__all__ = ["RestingRegions", "awake_terms"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

# What moves by less than this in a window [m], the length of a window [s],
_STILL, _WINDOW = 0.5e-6, 0.05
# and how far what lies next to sleeping cloth may be from where it lay when that fell asleep [m].
_DISTURBED = 1e-6
# Sides of the mesh over which elements reach, and over which what has been disturbed wakes others.
_REACH, _WOKEN = 2, 8
# Less than this share of the particles is not worth it.
_LEAST_SHARE = 0.1


class RestingRegions:
    """Watches a model's particles and says which of them sleep.

    Args:
        model: whose particles they are.
        time: now [s].
        x: where they are [m], (k, 3).
        slowest: frequency of the slowest swing [rad/s].
        drag: air drag [1/s].
        asleep: whether all of them sleep at first, or none.

    Attributes:
        asleep: (k,).
    """

    def __init__(self, model: Model, time: float, x: Floats, slowest: float, drag: float, asleep: bool = False) -> None:
        self._model = model
        self._watch = RestWatch(_STILL, _WINDOW, slowest, drag)
        self._watch.open(time, x)
        self._guards: Ints = np.zeros(0, dtype=np.int32)
        self._place: Floats = np.zeros((0, 3))
        self._sleep(np.full(model.particle_count, asleep), x)

    def look(self, time: float, x: Floats, contacts: ContactState) -> bool:
        """Whether other particles sleep than before, now that they are at x (k, 3) [m] at a time [s]."""
        disturbed = self._disturbed(x)
        if self._watch.due(time):
            restless = ~self._watch.still(time, x)
            restless[disturbed] = True
            self._touching(restless, contacts)
            self._sleep(~self._grown(restless, _REACH), x)
            return True
        if len(disturbed) == 0:
            return False
        woken = np.zeros_like(self.asleep)
        woken[disturbed] = True
        self._touching(woken, contacts)
        self._sleep(self.asleep & ~self._grown(woken, _WOKEN), x)
        return True

    def _sleep(self, asleep: Bools, x: Floats) -> None:
        asleep = asleep & (self._model.inverse_mass > 0.0)  # what is held goes where it is taken
        if asleep.mean() < _LEAST_SHARE:
            asleep[:] = False
        self.asleep = asleep
        before, place = self._guards, self._place
        self._guards = np.flatnonzero(self._grown(asleep, _REACH) & ~asleep).astype(np.int32)
        self._place = x[self._guards]
        # Who goes on standing guard is still compared with where it lay at first, so that it cannot creep away.
        stays = np.isin(self._guards, before)
        self._place[stays] = place[np.searchsorted(before, self._guards[stays])]

    def _disturbed(self, x: Floats) -> Ints:
        way = ((x[self._guards] - self._place) ** 2).sum(axis=1)
        taken_hold_of = np.flatnonzero(self.asleep & (self._model.inverse_mass == 0.0))
        return np.concatenate([self._guards[way > _DISTURBED**2], taken_hold_of.astype(np.int32)])

    def _grown(self, chosen: Bools, rings: int) -> Bools:
        grown = chosen.copy()
        first, second = self._model.springs.pairs.T
        for _ in range(rings):
            reached = grown[first] | grown[second]
            grown[first[reached]] = True
            grown[second[reached]] = True
        return grown

    def _touching(self, chosen: Bools, contacts: ContactState) -> None:
        """Choose also what can touch those that are chosen, before the next search."""
        pairs = contacts.pairs
        members = pairs.particles[pairs.listed[: pairs.listed_count[0]]]
        there = members >= 0
        met = (chosen[members] & there).any(axis=1)
        chosen[members[met][there[met]]] = True


def awake_terms(terms: ForceTerms, asleep: Bools) -> ForceTerms:
    """The terms without what acts between particles that sleep, (k,), which are held where they are."""
    awake = ~asleep
    hinges = awake[terms.hinges].any(axis=1)
    return terms._replace(
        inverse_mass=np.where(asleep, 0.0, terms.inverse_mass),
        springs=_awake_runs(terms.springs, awake),
        trellis=_awake_runs(terms.trellis, awake),
        lines=_awake_runs(terms.lines, awake),
        twists=_awake_runs(terms.twists, awake),
        hinges=np.ascontiguousarray(terms.hinges[hinges]),
        hinge_weights=np.ascontiguousarray(terms.hinge_weights[hinges]),
        hinge_stiffness=terms.hinge_stiffness[hinges],
    )


def _awake_runs(runs: Runs, awake: Bools) -> Runs:
    """The parts of runs in which any particle is awake, and a little more where that would be too short for a run."""
    run, start, length = _awake_parts(runs.first, runs.length, awake)
    rest = awake[runs.rest].any(axis=1)
    return Runs(
        first=runs.first[run] + start[:, None],
        length=length,
        value=runs.value[run],
        rest=np.ascontiguousarray(runs.rest[rest]),
        rest_value=np.ascontiguousarray(runs.rest_value[rest]),
    )


@kernel
def _awake_parts(first: Ints, length: Ints, awake: Bools) -> tuple[Ints, Ints, Ints]:
    """Run, first element and number of elements of each part; runs as in `Runs`."""
    room = 0
    for r in range(length.shape[0]):
        room += length[r] // LANES
    run, start, count = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
    parts = 0
    for r in range(length.shape[0]):
        begin, end = -1, -1
        for e in range(length[r]):
            acts = False
            for k in range(first.shape[1]):
                acts = acts or awake[first[r, k] + e]
            if not acts:
                continue
            # Two parts this far apart do not meet when each becomes as long as a register.
            if begin >= 0 and e - end > 2 * LANES:
                run[parts], start[parts], count[parts] = r, begin, end - begin
                parts += 1
                begin = -1
            if begin < 0:
                begin = e
            end = e + 1
        if begin >= 0:
            run[parts], start[parts], count[parts] = r, begin, end - begin
            parts += 1
    for p in range(parts):
        if count[p] < LANES:
            start[p] = min(start[p], length[run[p]] - LANES)
            count[p] = LANES
    return run[:parts], start[:parts], count[:parts]
