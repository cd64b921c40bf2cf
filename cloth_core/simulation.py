"""Runs a scene: `advance` for motion, `settle` for the drape, `tick` for those who drive it themselves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.coarse_start import Interpolation, interpolation_between, pushed_out_of_body
from cloth_core.crossed_start import body_start_warnings
from cloth_core.errors import ClothError, SceneError, SimulationError
from cloth_core.grasp import Grasps, Pose
from cloth_core.model import Model
from cloth_core.motion import Motion
from cloth_core.report import Report
from cloth_core.rest_search import RestSearch
from cloth_core.run_report import RunState, description_of, hash_of, report_of
from cloth_core.scene import Scene
from cloth_core.seam_closing import SeamClosing, count_crossings
from cloth_core.stability import StableStep
from cloth_core.switched_off import scene_without

__all__ = ["Progress", "Simulation"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
OnTick = Callable[["Simulation"], "bool | None"]

SEWING, DRAPING, REST, FAILED = "sewing", "draping", "rest", "failed"

# Share of the structural stiffness with which a run that looks for rest sews; it grows to all of it in about this time
# [s] once the seams have closed.
_SOFTNESS = 1.0 / 16.0
_STIFFENING_TIME = 0.05
# A run to rest starts with a mesh of this many times the spacing, where that is not beyond the coarsest [m].
_COARSER = 2.0
_COARSEST = 0.04


@dataclass(frozen=True)
class Progress:
    """Where a run stands.

    Attributes:
        phase: sewing, draping, rest or failed.
        simulated_time: [s].
        speed: simulated seconds per wall-clock second, over the last ticks.
        largest_speed: of any particle [m/s].
        estimated_rest_time: simulated time at which rest is expected [s], or None.
    """

    phase: str
    simulated_time: float
    speed: float
    largest_speed: float
    estimated_rest_time: float | None


class Simulation:
    """A scene in motion.

    Args:
        scene: what is simulated.

    Raises:
        ClothError: the scene cannot be made into a model.

    Attributes:
        motion: positions, velocities and all that takes them on.
        phase: "sewing", "draping", "rest" or "failed".
    """

    def __init__(self, scene: Scene) -> None:
        self._scene_at_start = scene
        self._wall = 0.0
        began = time.perf_counter()
        self.motion = Motion(scene)
        self._warnings: list[str] = []
        if scene.body is not None and not scene.worn:  # what patterns are made into is placed clear of it
            self._warnings += body_start_warnings(scene.garment, scene.body)
        self._rest = RestSearch()
        self._seams = SeamClosing()
        self._time_not_stepped = 0.0
        self._failure = ""
        self._coarse: tuple[Simulation, Interpolation] | None = None
        self._speed = 0.0
        garment = scene.garment
        sewing = bool(scene_without(scene).garment.seams)
        if sewing and scene.settings.integrator == "implicit":
            raise SceneError("integrator 'implicit': it sews no seams; use 'symplectic', or a garment without seams")
        self._use(Model(scene, sewing=sewing), garment.start, np.zeros_like(garment.start))
        self.phase = SEWING if sewing else DRAPING
        self._wall += time.perf_counter() - began

    # -- what others read --

    @property
    def scene(self) -> Scene:
        """As given; its body is replaced while it moves."""
        return self.motion.scene

    @property
    def model(self) -> Model:
        """The terms at present; replaced when the seams have closed."""
        return self.motion.model

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return self.motion.time

    @property
    def steps(self) -> int:
        """Done so far."""
        return self.motion.steps

    @property
    def grasps(self) -> Grasps:
        """Who holds which particles."""
        return self.motion.grasps

    @property
    def settled(self) -> bool:
        """Whether the cloth is at rest by the settings' criterion."""
        return self._rest.settled

    @property
    def asleep(self) -> bool:
        """Whether it lies so still after a run to rest that time goes on without steps."""
        return self._rest.asleep

    @property
    def drapes_coarsely(self) -> bool:
        """Whether it is still a coarser mesh that is draped, from which this one will start."""
        return self._coarse is not None

    @property
    def triangles(self) -> Ints:
        """Corner indices into `positions`, shape (m, 3); the same for the whole run."""
        return self.scene.garment.triangles

    @property
    def positions(self) -> Floats:
        """One row for each particle of each panel [m], shape (n, 3); sewn ones coincide."""
        if self._coarse is not None:
            coarse, interpolation = self._coarse
            return interpolation(coarse.positions)
        return np.asarray(self.motion.x[self.model.number])

    def sewn_mesh(self) -> tuple[Floats, Ints]:
        """Positions [m] with closed seams merged, shape (k, 3), and triangles (m, 3)."""
        if self._coarse is not None:
            return self.positions, self.model.triangles.copy()
        return self.motion.x.copy(), self.model.triangles.copy()

    @property
    def progress(self) -> Progress:
        """Where the run stands."""
        if self._coarse is not None:
            return self._coarse[0].progress
        largest_speed = float(self.motion.speeds().max())
        return Progress(self.phase, self.time, self._speed, largest_speed, self._rest.rest_time(self.time))

    @property
    def time_step(self) -> float:
        """Time step in use [s]."""
        return self.motion.time_step

    @property
    def stable(self) -> StableStep:
        """Last estimate of the largest stable time step."""
        return self.motion.stable

    # -- running --

    def tick(self) -> None:
        """Do a fixed small number of steps; compiled code releases the GIL meanwhile.

        Raises:
            SimulationError: the state would no longer be finite; the last good one is kept, and only `reset` goes on.
        """
        self._run(self.motion.tick_steps)

    def advance(self, duration: float, on_tick: OnTick | None = None) -> None:
        """Simulate `duration` [s] of physical time; on_tick may return True to stop.

        Once a run to rest has ended and after it nothing moves any more by as much as 0.1 um in a window, time goes on
        without steps until something acts from outside.

        Raises:
            SimulationError: as in tick.
        """
        if not (math.isfinite(duration) and duration >= 0.0):
            raise SimulationError(f"advance: {duration!r} s is not a duration; give a number of seconds")
        end = self.time + duration
        while self.time < end - 1e-12:
            if self.asleep:
                self._time_not_stepped += end - self.time
                self.motion.time = end
                return
            left = math.ceil((end - self.time) / self.time_step - 1e-9)
            self._run(min(self.motion.tick_steps, left), last_time=end)
            if on_tick is not None and on_tick(self):
                return

    def settle(self, on_tick: OnTick | None = None) -> Report:
        """Run until the cloth lies still (paper, step 5); on_tick may return True to stop early.

        At rest means that within `rest_window` no particle moves by more than `rest_displacement`, and that none is
        about to: a swing that turns round is none (`cloth_core.rest`). The way there is not physical in time, only its
        end is the equilibrium: extra air drag (`settle_drag`) and braking of what slows down calm the swinging, and a
        run from the start drapes a coarser mesh first, sews with soft structural springs (`Model.soften`), which allows
        longer steps, and gives them their true stiffness when the seams have closed; nothing moves faster than 3 m/s.

        Raises:
            SimulationError: as in tick.
        """
        self._refuse_to_go_on()
        reason = self._come_to_rest(on_tick)
        self._rest.seeking = False
        self.motion.extra_drag = 0.0
        self.model.soften(1.0)
        self.motion.refresh_time_step(tolerance=5e-4)
        return self.report(reason)

    def _come_to_rest(self, on_tick: OnTick | None) -> str:
        """Run until the cloth lies still or there is no hope that it will; why it ended."""
        self._rest.begin()
        self.motion.extra_drag = self.scene.settings.settle_drag
        self._rest.rest_regions(self.motion)
        stopped = self.steps == 0 and self._start_coarse(on_tick)
        if self.phase == SEWING:
            self.model.soften(_SOFTNESS)
        self.motion.refresh_time_step()
        while not stopped:
            ended = self._rest.why_ended(self.motion)
            if ended:
                return ended
            self.tick()
            stopped = on_tick is not None and bool(on_tick(self))
        return "stopped before it came to rest"

    def _start_coarse(self, on_tick: OnTick | None) -> bool:
        """Drape a coarser mesh first, and start from there; whether on_tick asked to stop meanwhile.

        Where that does not work out, because the coarse garment cannot be draped or something would cross, the fine one
        starts from the beginning.
        """
        scene, motion = self.scene, self.motion
        spacing = _COARSER * scene.settings.spacing
        if not scene.worn or len(scene.pins) > 0 or self.phase != SEWING or spacing > _COARSEST:
            return False
        stopped = False

        def follow(coarse: Simulation) -> bool:
            nonlocal stopped
            motion.time, motion.steps, self.phase = coarse.time, coarse.steps, coarse.phase
            stopped = on_tick is not None and bool(on_tick(self))
            return stopped or not coarse._rest.calming.active or bool(coarse._seams.open_seams)

        try:
            coarse = Simulation(replace(scene, fabric=scene.fabric.smoothed).with_spacing(spacing))
            coarse._rest.calming.rough = True
            interpolation = interpolation_between(coarse.scene.garment, scene.garment)
            self._coarse = (coarse, interpolation)
            coarse._come_to_rest(follow)
        except ClothError:
            return stopped
        finally:
            self._coarse = None
            self.phase = SEWING
            motion.sewn_since = self.time
        x = interpolation(coarse.positions)
        if coarse.phase == SEWING:
            motion.sewn_since = coarse.motion.sewn_since
            self._use(self.model, x, np.zeros_like(x))
            return stopped
        model = Model(scene, closed=scene.garment.seams)
        if not coarse._seams.open_seams and scene.body is not None:
            sewn = model.gather(x, scene.garment.particle_areas)
            x = pushed_out_of_body(sewn, model.triangles, scene.body, scene.settings.contact_offset)[model.number]
        if not coarse._seams.open_seams and count_crossings(scene, model, x) == 0:
            self.phase = DRAPING
            self._use(model, x, np.zeros_like(x))
        return stopped

    def reset(self) -> None:
        """Back to the start, with all seams open, nothing held and the body where it was."""
        self.__init__(self._scene_at_start)  # type: ignore[misc]

    # -- what acts from outside while it runs --

    def grasp(self, name: str, particles: Ints, pose: Pose) -> int:
        """Hold particles (unsewn numbering) at a gripper's frame; returns how many.

        Raises:
            SimulationError: the gripper holds something already, or there is nothing to hold.
        """
        motion = self.motion
        count = motion.grasps.take(name, particles, pose, motion.model, motion.x)
        motion.v[motion.model.inverse_mass == 0.0] = 0.0
        motion.refresh_time_step()
        self._wake()
        return count

    def move_grasp(self, name: str, goal: Pose) -> None:
        """Let a gripper follow to a new pose."""
        if self.grasps.move(name, goal):
            self._wake()

    def release(self, name: str) -> int:
        """Let go of what a gripper holds; returns how many particles.

        Raises:
            SimulationError: it holds nothing.
        """
        motion = self.motion
        count = motion.grasps.release(name, motion.model)
        # The last estimate knows nothing of what was held.
        motion.estimate_stable_step()
        motion.refresh_time_step(estimate=False)
        self._wake()
        return count

    def move_body(self, vertices: Floats, duration: float, max_speed: float = math.inf) -> None:
        """Let the body's vertices move linearly to new places (n, 3) [m] within `duration` [s] of simulated time.

        A second call before the first has ended starts from where the body is by then. The body takes longer where
        max_speed [m/s] or cloth that is pinched asks for it.

        Raises:
            SceneError: there is no body.
            BodyError: the vertices do not belong to it.
        """
        self.motion.move_body(vertices, duration, max_speed)
        self._wake()

    @property
    def body_moves(self) -> bool:
        """Whether the body is on its way."""
        return self.motion.body_motion is not None

    def _wake(self) -> None:
        if self.phase == REST:
            self.phase = DRAPING
        self._rest.wake(self.motion)

    # -- parts of a run --

    def _run(self, count: int, last_time: float = math.inf) -> None:
        self._refuse_to_go_on()
        motion = self.motion
        began, before = time.perf_counter(), motion.time
        try:
            motion.run(count, last_time)
        except SimulationError as error:
            self._failure = str(error)
            self.phase, self._rest.settled = FAILED, False
            raise
        self._rest.calm(motion)
        sewn_for = motion.time - motion.sewn_since
        if motion.model.softness < 1.0 and sewn_for > self.scene.closing_time:
            self._stiffen()
        if self.phase == SEWING:
            self._sew(sewn_for)
        elif not self._sew_the_rest() and self._rest.look(motion, self._seams):
            self.phase = REST if self._rest.settled else DRAPING
        self._rest.rest_regions(motion)
        motion.check_time_step()
        wall = time.perf_counter() - began
        self._wall += wall
        if wall > 0.0:
            self._speed += 0.1 * ((motion.time - before) / wall - self._speed)

    def _refuse_to_go_on(self) -> None:
        if self._failure:
            raise SimulationError(f"the run has failed and cannot go on, reset it: {self._failure}")

    def _use(self, model: Model, unsewn_x: Floats, unsewn_v: Floats, softness: float = 1.0) -> None:
        """Go on with a model, from a state in the unsewn numbering."""
        self.motion.use(model, unsewn_x, unsewn_v, softness)
        self._rest.calming.start(self.motion.v)
        self._rest.open_window(self.motion)

    def _sew(self, sewn_for: float) -> None:
        """Merge the seams when they have closed; for how long they have been pulled [s]."""
        model = self._seams.merged(self.scene, self.model, self.positions, self.time, sewn_for)
        if model is None:
            return
        self.phase = DRAPING
        # Merging moves points at once: what that stretches or shortens comes back softly.
        softness = _SOFTNESS if self._rest.seeking else self.model.softness
        self._use(model, self._seams.positions, np.asarray(self.motion.v[self.model.number]), softness)

    def _sew_the_rest(self) -> bool:
        """Merge points of seams that had to stay open at first; whether some were."""
        if not self._seams.open_seams or self.body_moves or self.grasps:
            return False
        model = self._seams.merged_later(self.scene, self.model, self.positions, self.time)
        if model is None:
            return False
        self._use(model, self._seams.positions, np.asarray(self.motion.v[self.model.number]))
        return True

    def _stiffen(self) -> None:
        """A little more of the true stiffness."""
        motion = self.motion
        growth = (1.0 / _SOFTNESS) ** (motion.time_step * motion.tick_steps / _STIFFENING_TIME)
        motion.model.soften(motion.model.softness * growth)
        motion.refresh_time_step()
        self._rest.open_window(motion)

    # -- results --

    @property
    def _state(self) -> RunState:
        return RunState(self.motion, self.positions, self.phase)

    def report(self, rest_reason: str | None = None) -> Report:
        """Measure the present state (exact triangle tests included)."""
        if rest_reason is None:
            rest_reason = "at rest" if self.settled else self.phase
        why_open = self._seams.why_open(self.scene, self.positions)
        return report_of(
            self._state,
            wall_time=self._wall,
            settled=self.settled,
            rest_reason=rest_reason,
            open_seams=tuple(why_open),
            time_not_stepped=self._time_not_stepped,
            warnings=[*self._warnings, *self.motion.warnings, *why_open.values()],
        )

    def state_hash(self) -> str:
        """SHA-256 of positions and velocities, little-endian float64."""
        return hash_of(self.motion.x, self.motion.v)

    def describe(self) -> dict[str, Any]:
        """Terms with reasons and measured shares, counts and the stable time step, as JSON types; nothing is run."""
        return description_of(self._state)
