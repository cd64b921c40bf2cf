"""Regions of the cloth that lie still are not stepped while the rest moves.

A particle sleeps when it is still, and so is all that could pull or push it: its neighbours along two sides of the
mesh, and what it touches. It has no velocity and takes no force, and what acts between sleeping particles is left out
of the loops. What is awake next to it, along the mesh or near enough to touch it, wakes it as soon as that is a
micrometre from where it lay, and with it the neighbours around, so that a pull spreads as it would have. What is let go
wakes what is around it at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.contact_state import ContactState
from cloth_core.kernel import borrowing_kernel, kernel
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
# Ends of windows at which what has been woken stays awake: in the first of them it slept for a part.
_WARY = 2
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
        self._held: Bools = model.inverse_mass == 0.0
        self._wary: Ints = np.zeros(len(x), dtype=np.int32)
        # Who stands next to what sleeps, and where each particle was when that began, or else when the window did.
        self._guards: Bools = np.zeros(len(x), dtype=bool)
        self._place: Floats = x.copy()
        self._sleep(np.full(model.particle_count, asleep), x)

    def look(self, time: float, x: Floats, contacts: ContactState) -> bool:
        """Whether other particles sleep than before, now that they are at x (k, 3) [m] at a time [s]."""
        disturbed, due = self._disturbed(x, contacts), self._watch.due(time)
        woken = disturbed.any()
        if not due and not woken:
            return False
        asleep = self.asleep
        if due:
            restless = ~self._watch.still(time, x) | (self._wary > 0)
            self._wary = np.maximum(self._wary - 1, 0)
            self._touching(restless, contacts)
            asleep = ~self._grown(restless, _REACH)
        if woken:
            self._touching(disturbed, contacts)
            around = self._grown(disturbed, _WOKEN)
            self._wary[around & (self.asleep | disturbed)] = _WARY
            asleep = asleep & ~around
        self._sleep(asleep, x, contacts)
        if due:
            self._place[~self._guards] = x[~self._guards]
        return True

    def _sleep(self, asleep: Bools, x: Floats, contacts: ContactState | None = None) -> None:
        asleep = asleep & ~self._held  # what is held goes where it is taken
        if asleep.mean() < _LEAST_SHARE:
            asleep[:] = False
        self.asleep = asleep
        guards = self._grown(asleep, _REACH)
        if contacts is not None:
            beside = asleep.copy()
            self._touching(beside, contacts)
            guards |= beside
        guards &= ~asleep
        # Who goes on standing guard is still compared with where it lay at first, so that it cannot creep away.
        new = guards & ~self._guards
        self._place[new] = x[new]
        self._guards = guards

    def _disturbed(self, x: Floats, contacts: ContactState) -> Bools:
        """Which particles shall wake what is around them, (k,)."""
        held = self._model.inverse_mass == 0.0
        disturbed: Bools = (self.asleep & held) | (self._held & ~held)
        self._held = held
        if self.asleep.any():
            guards = np.flatnonzero(self._guards)
            way = ((x[guards] - self._place[guards]) ** 2).sum(axis=1)
            disturbed[guards[way > _DISTURBED**2]] = True
            pairs = contacts.pairs
            _find_comers(pairs.particles, pairs.listed[: pairs.listed_count[0]], self.asleep, x, self._place, disturbed)
        return disturbed

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


@borrowing_kernel
def _find_comers(particles: Ints, listed: Ints, asleep: Bools, x: Floats, place: Floats, disturbed: Bools) -> None:
    """Note in disturbed (k,) who has moved and may touch what sleeps; particles (s, 4), -1 for none, of those listed.

    x: where they are; place: where they were when the window began, or later [m], (k, 3).
    """
    for entry in range(listed.shape[0]):
        s = listed[entry]
        sleeps = False
        for k in range(4):
            i = particles[s, k]
            sleeps = sleeps or (i >= 0 and asleep[i])
        if not sleeps:
            continue
        for k in range(4):
            i = particles[s, k]
            if i >= 0 and not asleep[i]:
                dx, dy, dz = x[i, 0] - place[i, 0], x[i, 1] - place[i, 1], x[i, 2] - place[i, 2]
                if dx * dx + dy * dy + dz * dz > _DISTURBED * _DISTURBED:
                    disturbed[i] = True


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
