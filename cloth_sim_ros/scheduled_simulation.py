"""A simulation that keeps account of how it was moved, so that another one can be moved in the same way.

The time step is cut to meet the end of `advance`, contacts are searched between two ticks and `settle` changes the air
drag, so the state depends to its last bits on which of them was called when, and on nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.errors import ClothError, SimulationError
from cloth_core.grasp import Pose
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import OnTick, Simulation

__all__ = ["Motion", "OutsideAct", "ScheduledSimulation", "repeat", "schedule_change", "schedule_from"]

TICK, ADVANCE, SETTLE, OUTSIDE = "tick", "advance", "settle", "outside"


class OutsideAct(ClothError):
    """From here on a simulation cannot be repeated, since something acted on it that its schedule does not hold."""


@dataclass(frozen=True)
class Motion:
    """Calls of one method of a simulation. It went on until the next motion began."""

    kind: str
    """tick, advance or settle; or outside: something acted on the simulation that cannot be repeated."""
    steps: int
    """Time steps that had been done before."""
    duration: float = 0.0
    """Of each call of `advance` [s]."""
    count: int = 1
    """Calls of `advance` one after the other; ticks and settle count as one."""
    what: str = ""
    """What acted from outside."""


class ScheduledSimulation(Simulation):
    """A `Simulation` with a schedule.

    Attributes:
        schedule: how it was moved since its start; replaced whole, so that other threads can read it.
    """

    def __init__(self, scene: Scene) -> None:
        self.schedule: tuple[Motion, ...] = ()
        self._broken_off = False
        self._within_motion = False
        super().__init__(scene)

    def tick(self) -> None:
        """As of `Simulation`."""
        if not self._within_motion:
            self._note(Motion(TICK, self.steps))
        super().tick()

    def advance(self, duration: float, on_tick: OnTick | None = None) -> None:
        """As of `Simulation`."""
        if math.isfinite(duration) and duration >= 0.0:
            self._note(Motion(ADVANCE, self.steps, duration))
        self._within_motion = True
        try:
            super().advance(duration, self._watched(on_tick))
        finally:
            self._within_motion = False

    def settle(self, on_tick: OnTick | None = None) -> Report:
        """As of `Simulation`."""
        self._note(Motion(SETTLE, self.steps))
        self._within_motion = True
        try:
            return super().settle(on_tick)
        finally:
            self._within_motion = False

    def grasp(self, name: str, particles: NDArray[np.int32], pose: Pose) -> int:
        """As of `Simulation`."""
        self.acted_upon("a gripper")
        return super().grasp(name, particles, pose)

    def move_body(self, vertices: NDArray[np.float64], duration: float, max_speed: float = math.inf) -> None:
        """As of `Simulation`."""
        self.acted_upon("a moving body")
        super().move_body(vertices, duration, max_speed)

    def acted_upon(self, what: str) -> None:
        """Notes that something is about to act on the simulation of which the schedule knows no more than its name."""
        if not any(motion.kind == OUTSIDE for motion in self.schedule):
            self.schedule = (*self.schedule, Motion(OUTSIDE, self.steps, what=what))

    def _watched(self, on_tick: OnTick | None) -> OnTick | None:
        """The callback, and whether it broke the motion off."""
        self._broken_off = False
        if on_tick is None:
            return None

        def watch(simulation: Simulation) -> bool:
            self._broken_off = bool(on_tick(simulation))
            return self._broken_off

        return watch

    def _note(self, motion: Motion) -> None:
        last = self.schedule[-1] if self.schedule else None
        if last is not None and last.kind == OUTSIDE:
            return  # what follows cannot be repeated anyway
        if last is None or (last.kind, last.duration) != (motion.kind, motion.duration) or motion.kind == SETTLE:
            self.schedule = (*self.schedule, motion)
        elif motion.kind == ADVANCE:
            if self._broken_off:
                self.schedule = (*self.schedule, motion)
            else:
                self.schedule = (*self.schedule[:-1], replace(last, count=last.count + 1))


def repeat(
    simulation: Simulation, schedule: Sequence[Motion], look: Callable[[Simulation], bool]
) -> tuple[Motion, int] | None:
    """Moves a simulation, from its start, as another one was moved.

    Args:
        simulation: at its start
        schedule: of the other one
        look: called at the start, after each tick and after each motion; returns true once nothing more is of interest

    Returns:
        the first motion that cannot begin where it began, with the steps done by then, or None

    Raises:
        OutsideAct: the schedule goes no further.
    """
    if look(simulation):
        return None
    for number, motion in enumerate(schedule):
        if simulation.steps != motion.steps:
            return motion, simulation.steps
        if motion.kind == OUTSIDE:
            raise OutsideAct(
                f"{motion.what} acted on the cloth at {simulation.time:.6g} s, which the log does not hold"
            )
        last_step = schedule[number + 1].steps if number + 1 < len(schedule) else None
        seen_enough = False

        def on_tick(simulation: Simulation, last_step: int | None = last_step) -> bool:
            nonlocal seen_enough
            seen_enough = look(simulation)
            return seen_enough or (last_step is not None and simulation.steps >= last_step)

        try:
            _move(simulation, motion, on_tick)
        except SimulationError:
            # So it did when it was recorded; what was sent then is the last good state, as here.
            look(simulation)
            return None
        if seen_enough or look(simulation):
            return None
    return None


def _move(simulation: Simulation, motion: Motion, on_tick: Callable[[Simulation], bool]) -> None:
    if motion.kind == SETTLE:
        simulation.settle(on_tick)
    elif motion.kind == ADVANCE:
        ended = False

        def watch(simulation: Simulation) -> bool:
            nonlocal ended
            ended = on_tick(simulation)
            return ended

        for _ in range(motion.count):
            simulation.advance(motion.duration, watch)
            if ended:
                return
    else:
        simulation.tick()
        while not on_tick(simulation):
            simulation.tick()


def schedule_change(before: Sequence[Motion], after: Sequence[Motion]) -> dict[str, Any]:
    """What became of a schedule, as JSON values: the entries from the `first` one on that differs."""
    first = next((i for i, pair in enumerate(zip(before, after, strict=False)) if pair[0] != pair[1]), len(before))
    return {"first": min(first, len(after)), "motions": [asdict(motion) for motion in after[first:]]}


def schedule_from(changes: Sequence[dict[str, Any]]) -> tuple[Motion, ...]:
    """The schedule after all changes, in order.

    Raises:
        ValueError: a change is not what `schedule_change` gives.
    """
    schedule: list[Motion] = []
    for change in changes:
        try:
            schedule[int(change["first"]) :] = [_motion(entry) for entry in change["motions"]]
        except (LookupError, TypeError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from None
    return tuple(schedule)


def _motion(entry: dict[str, Any]) -> Motion:
    motion = Motion(
        str(entry["kind"]), int(entry["steps"]), float(entry["duration"]), int(entry["count"]), str(entry["what"])
    )
    if motion.kind not in (TICK, ADVANCE, SETTLE, OUTSIDE):
        raise ValueError(f"motion '{motion.kind}' is not known")
    return motion
