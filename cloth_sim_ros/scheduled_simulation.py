"""A simulation that keeps account of how it was moved and what acted on it, so that another one can be moved likewise.

The time step is cut to meet the end of `advance`, contacts are searched between two ticks and `settle` changes the air
drag, so the state depends to its last bits on which of them was called when, on what grippers and a moving body did
between which steps, and on nothing else.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.errors import ClothError, SimulationError
from cloth_core.grasp import Pose
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import OnTick, Simulation

__all__ = [
    "ActError",
    "Motion",
    "OutsideAct",
    "ScheduleFollower",
    "ScheduledSimulation",
    "repeat",
    "schedule_from",
    "vertices_checksum",
]

TICK, ADVANCE, SETTLE, OUTSIDE = "tick", "advance", "settle", "outside"
GRASP, MOVE_GRASP, RELEASE, GRASP_SPEED, MOVE_BODY = "grasp", "move_grasp", "release", "grasp_speed", "move_body"
_MOTIONS = (TICK, ADVANCE, SETTLE)
_ACTS = (GRASP, MOVE_GRASP, RELEASE, GRASP_SPEED, MOVE_BODY)

FindBody = Callable[[str], NDArray[np.float64]]
"""Vertices [m], (n, 3), that have a checksum; raises ClothError where there are none."""


class OutsideAct(ClothError):
    """From here on a simulation cannot be repeated, since something acted on it that its schedule does not hold."""


class ActError(ClothError):
    """Something that acted on a simulation cannot act on the one that repeats it."""


@dataclass(frozen=True)
class Motion:
    """Calls of one method of a simulation: one that moves it, and went on until the next of these began, or an act."""

    kind: str
    """tick, advance or settle; an act: grasp, move_grasp, release, grasp_speed or move_body; or outside: something
    acted on the simulation that cannot be repeated."""
    steps: int
    """Time steps that had been done before."""
    duration: float = 0.0
    """Of each call of `advance` [s]."""
    count: int = 1
    """Calls of `advance` one after the other; ticks and settle count as one."""
    what: str = ""
    """What acted from outside: the gripper, or what cannot be repeated."""
    within: bool = False
    """Whether it acted within `advance` or `settle`, which then went on."""
    values: dict[str, Any] = field(default_factory=dict)
    """Arguments of an act, as values that JSON can hold; of a body the checksum of its vertices."""

    @property
    def is_act(self) -> bool:
        """Whether it acts on the simulation rather than move it."""
        return self.kind in _ACTS


class ScheduledSimulation(Simulation):
    """A `Simulation` with a schedule.

    Attributes:
        schedule: how it was moved since its start. It only grows, but that its last entry may be replaced; a copy of it
            can be made in any thread.
    """

    def __init__(self, scene: Scene) -> None:
        self.schedule: list[Motion] = []
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
        count = super().grasp(name, particles, pose)
        self._act(GRASP, name, particles=np.asarray(particles).tolist(), **_pose_values(pose))
        return count

    def move_grasp(self, name: str, goal: Pose) -> None:
        """As of `Simulation`."""
        super().move_grasp(name, goal)
        if name in self.grasps:
            self._act(MOVE_GRASP, name, **_pose_values(goal))

    def release(self, name: str) -> int:
        """As of `Simulation`."""
        count = super().release(name)
        self._act(RELEASE, name)
        return count

    def limit_grasp_speed(self, speed: float) -> None:
        """No held particle is moved faster than this from now on [m/s]."""
        if speed != self.grasps.max_speed:
            self.grasps.max_speed = speed
            self._act(GRASP_SPEED, "", speed=speed)

    def move_body(self, vertices: NDArray[np.float64], duration: float, max_speed: float = math.inf) -> None:
        """As of `Simulation`."""
        super().move_body(vertices, duration, max_speed)
        speed = max_speed if math.isfinite(max_speed) else None
        self._act(MOVE_BODY, "", vertices=vertices_checksum(vertices), duration=duration, max_speed=speed)

    def acted_upon(self, what: str) -> None:
        """Notes that something is about to act on the simulation of which the schedule knows no more than its name."""
        if not (self.schedule and self.schedule[-1].kind == OUTSIDE):
            self.schedule.append(Motion(OUTSIDE, self.steps, what=what))

    def _act(self, kind: str, what: str, **values: Any) -> None:
        if not (self.schedule and self.schedule[-1].kind == OUTSIDE):
            self.schedule.append(Motion(kind, self.steps, what=what, within=self._within_motion, values=values))

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
            self.schedule.append(motion)
        elif motion.kind == ADVANCE:
            if self._broken_off:
                self.schedule.append(motion)
            else:
                self.schedule[-1] = replace(last, count=last.count + 1)


def repeat(
    simulation: Simulation,
    schedule: Sequence[Motion],
    look: Callable[[Simulation], bool],
    find_body: FindBody | None = None,
) -> tuple[Motion, int] | None:
    """Moves a simulation, from its start, as another one was moved, and lets act on it what acted on that.

    Args:
        simulation: at its start
        schedule: of the other one
        look: called at the start, after each tick, motion and act; returns true once nothing more is of interest
        find_body: where the body went

    Returns:
        the first motion or act that cannot begin where it began, with the steps done by then, or None

    Raises:
        OutsideAct: the schedule goes no further.
        ActError: an act cannot be repeated; says which and why.
    """
    if look(simulation):
        return None
    place = 0
    while place < len(schedule):
        motion = schedule[place]
        if simulation.steps != motion.steps:
            return motion, simulation.steps
        if motion.kind == OUTSIDE:
            raise OutsideAct(
                f"{motion.what} acted on the cloth at {simulation.time:.6g} s, which the log does not hold"
            )
        place += 1
        if motion.is_act:
            _act(simulation, motion, find_body)
            if look(simulation):
                return None
            continue
        within = []
        while place < len(schedule) and schedule[place].within:
            within.append(schedule[place])
            place += 1
        course = _Course(within, schedule[place].steps if place < len(schedule) else None, look, find_body)
        try:
            _move(simulation, motion, course)
        except SimulationError:
            # So it did when it was recorded; what was sent then is the last good state, as here.
            look(simulation)
            return None
        if course.seen_enough or look(simulation):
            return None
        if course.waiting:
            return course.waiting[0], simulation.steps
    return None


class _Course:
    """What happens after each tick of a motion that is repeated."""

    def __init__(
        self,
        waiting: list[Motion],
        last_step: int | None,
        look: Callable[[Simulation], bool],
        find_body: FindBody | None,
    ) -> None:
        self.waiting = waiting
        self.seen_enough = False
        self._last_step, self._look, self._find_body = last_step, look, find_body

    def __call__(self, simulation: Simulation) -> bool:
        """Looks and acts; true if the motion is to end."""
        self.seen_enough = self._look(simulation)
        while not self.seen_enough and self.waiting and simulation.steps == self.waiting[0].steps:
            _act(simulation, self.waiting.pop(0), self._find_body)
            self.seen_enough = self._look(simulation)
        return self.seen_enough or (self._last_step is not None and simulation.steps >= self._last_step)


def _act(simulation: Simulation, act: Motion, find_body: FindBody | None) -> None:
    try:
        _do_act(simulation, act, find_body)
    except (ClothError, LookupError, TypeError, ValueError) as error:
        what = f"{act.kind} {act.what}".rstrip()
        raise ActError(f"{what} after step {act.steps} cannot be repeated: {error}") from None


def _do_act(simulation: Simulation, act: Motion, find_body: FindBody | None) -> None:
    values = act.values
    if act.kind == GRASP:
        simulation.grasp(act.what, np.array(values["particles"], dtype=np.int32), _pose(values))
    elif act.kind == MOVE_GRASP:
        simulation.move_grasp(act.what, _pose(values))
    elif act.kind == RELEASE:
        simulation.release(act.what)
    elif act.kind == GRASP_SPEED:
        simulation.grasps.max_speed = float(values["speed"])
    else:
        if find_body is None:
            raise SimulationError("move_body: the vertices are not at hand; pass find_body")
        max_speed = values["max_speed"]
        vertices = find_body(str(values["vertices"]))
        simulation.move_body(vertices, float(values["duration"]), math.inf if max_speed is None else float(max_speed))


def vertices_checksum(vertices: NDArray[np.float64]) -> str:
    """SHA-256 of vertices [m], (n, 3), as little-endian float64, in hexadecimal."""
    return hashlib.sha256(np.ascontiguousarray(vertices, dtype="<f8").tobytes()).hexdigest()


def _pose_values(pose: Pose) -> dict[str, Any]:
    return {"position": pose.position.tolist(), "orientation": pose.orientation.tolist()}


def _pose(values: dict[str, Any]) -> Pose:
    """Not checked and normalised again, which could round differently."""
    return Pose(np.array(values["position"], dtype=np.float64), np.array(values["orientation"], dtype=np.float64))


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


class ScheduleFollower:
    """Says, again and again, what has become of a schedule meanwhile, at a cost of what is new."""

    def __init__(self) -> None:
        self._count = 0
        self._last: Motion | None = None

    def change(self, schedule: Sequence[Motion]) -> dict[str, Any] | None:
        """Since the last call, as JSON values: the entries from the `first` one on that is new. None if none is."""
        first = self._count
        if first > 0 and schedule[first - 1] != self._last:
            first -= 1
        new = schedule[first:]
        if not new:
            return None
        self._count, self._last = first + len(new), new[-1]
        return {"first": first, "motions": [asdict(motion) for motion in new]}


def schedule_from(changes: Sequence[dict[str, Any]]) -> tuple[Motion, ...]:
    """The schedule after all changes, in order.

    Raises:
        ValueError: a change is not what `ScheduleFollower.change` gives.
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
        str(entry["kind"]),
        int(entry["steps"]),
        float(entry["duration"]),
        int(entry["count"]),
        str(entry["what"]),
        bool(entry.get("within", False)),
        dict(entry.get("values", {})),
    )
    if motion.kind not in (*_MOTIONS, *_ACTS, OUTSIDE):
        raise ValueError(f"motion '{motion.kind}' is not known")
    return motion
