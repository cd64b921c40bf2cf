"""Runs a scene: `advance` for motion, `settle` for the drape, `tick` for those who drive it themselves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.calming import Calming, limit_speed
from cloth_core.coarse_start import Interpolation, interpolation_between, pushed_out_of_body
from cloth_core.contact import ContactSettings, ContactState
from cloth_core.crossed_start import body_start_warnings
from cloth_core.errors import ClothError, SceneError, SimulationError
from cloth_core.grasp import Grasps, Pose
from cloth_core.implicit_matrix import build_matrix
from cloth_core.implicit_step import ImplicitState, implicit_steps
from cloth_core.kernel import kernel
from cloth_core.model import Model
from cloth_core.moving_body import BodyMotion
from cloth_core.report import Report
from cloth_core.rest import RestWatch, StallWatch, slowest_swing, why_restless
from cloth_core.run_report import RunState, description_of, hash_of, report_of
from cloth_core.scene import Scene
from cloth_core.seam_closing import SeamClosing, count_crossings
from cloth_core.smooth_windows import FOLDED, FOLDING, SMOOTH, SmoothWindows
from cloth_core.stability import StableStep
from cloth_core.step import Workspace, run_steps
from cloth_core.support import PATIENCE_WITH_FALLEN, why_fallen, why_unsupported
from cloth_core.switched_off import scene_without
from cloth_core.tightness import Tightness, TightnessWatch
from cloth_core.travel_renewal import SPENT

__all__ = ["Progress", "Simulation"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
OnTick = Callable[["Simulation"], "bool | None"]

SEWING, DRAPING, REST, FAILED = "sewing", "draping", "rest", "failed"

_TICK_STEPS = 32
# The same for implicit steps, and their length where none is asked for [s]: by itself, and with a body, on which longer
# steps come to no rest.
_IMPLICIT_TICK_STEPS = 1
_IMPLICIT_STEP = 1.0 / 120.0
_IMPLICIT_STEP_ON_BODY = 1.0 / 500.0
# Simulated time between two checks of the stable time step [s].
_CHECK_INTERVAL = 0.05
# Steps that a particle can go on at its speed before contacts are searched again, and the least such way [m].
_STEPS_PER_SEARCH = 30.0
# Where more pairs than this for each particle have to be looked at in each step, so many steps: they lengthen the list.
_CROWDED, _STEPS_IN_A_CROWD = 1.0, 12.0
_LEAST_REACH = 0.001
# Share of the structural stiffness with which a run that looks for rest sews; it grows to all of it in about this time
# [s] once the seams have closed.
_SOFTNESS = 1.0 / 16.0
_STIFFENING_TIME = 0.05
# A run to rest starts with a mesh of this many times the spacing, where that is not beyond the coarsest [m].
_COARSER = 2.0
_COARSEST = 0.04
# Air drag while seams close [1/s].
_SEWING_DRAG = 10.0
# What touches may go this share of the distance between layers in a step, however little room it has.
_LEAST_ROOM = 0.1
# A run that has come to rest is no longer stepped when nothing moves farther than this in a window [m].
_NOTHING = 1e-7
# Cloth faster than this has left physics [m/s].
_HIGHEST_SPEED = 1000.0


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


class _FiniteState(NamedTuple):
    """What a run goes back to when it fails: positions and velocities (n, 3) [m, m/s], time [s], steps."""

    x: Floats
    v: Floats
    time: float
    steps: int


class Simulation:
    """A scene in motion.

    Args:
        scene: what is simulated.

    Raises:
        ClothError: the scene cannot be made into a model.

    Attributes:
        scene: as given; its body is replaced while it moves.
        model: the terms at present; replaced when the seams have closed.
        phase: "sewing", "draping", "rest" or "failed".
        time: simulated [s].
        steps: done so far.
        settled: whether the cloth is at rest by the settings' criterion.
        grasps: who holds which particles.
    """

    model: Model
    _x: Floats
    _v: Floats
    _contact_settings: ContactSettings

    def __init__(self, scene: Scene) -> None:
        self.scene = self._scene_at_start = scene
        self._wall = 0.0
        began = time.perf_counter()
        self.time = 0.0
        self.steps = 0
        self.settled = False
        self._searches = 0
        self._warnings: list[str] = []
        if scene.body is not None and not scene.worn:  # what patterns are made into is placed clear of it
            self._warnings += body_start_warnings(scene.garment, scene.body)
        self._seeking_rest = False
        self._calming = Calming()
        self._has_settled = self._asleep = False
        self._time_not_stepped = 0.0
        self._seams = SeamClosing()
        self._stall_watch, self._tightness_watch = StallWatch(), TightnessWatch()
        self._stalled = ""
        self._failure = ""
        self._coarse: tuple[Simulation, Interpolation] | None = None
        self._sewing_began = 0.0
        self._impulse_step = 1.0
        self._flight_step = math.inf
        self._speed = 0.0
        self.grasps = Grasps()
        self._body_motion: BodyMotion | None = None
        self._tick_steps = _TICK_STEPS if scene.settings.integrator == "symplectic" else _IMPLICIT_TICK_STEPS
        garment = scene.garment
        sewing = bool(scene_without(scene).garment.seams)
        if sewing and scene.settings.integrator == "implicit":
            raise SceneError("integrator 'implicit': it sews no seams; use 'symplectic', or a garment without seams")
        self._use(Model(scene, sewing=sewing), garment.start, np.zeros_like(garment.start))
        self.phase = SEWING if sewing else DRAPING
        self._wall += time.perf_counter() - began

    # -- what others read --

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
        return np.asarray(self._x[self.model.number])

    def sewn_mesh(self) -> tuple[Floats, Ints]:
        """Positions [m] with closed seams merged, shape (k, 3), and triangles (m, 3)."""
        if self._coarse is not None:
            return self.positions, self.model.triangles.copy()
        return self._x.copy(), self.model.triangles.copy()

    @property
    def progress(self) -> Progress:
        """Where the run stands."""
        if self._coarse is not None:
            return self._coarse[0].progress
        return Progress(self.phase, self.time, self._speed, self._largest_speed(), self._rest_estimate())

    @property
    def time_step(self) -> float:
        """Time step in use [s]."""
        return self._dt

    @property
    def stable(self) -> StableStep:
        """Last estimate of the largest stable time step."""
        return self._stable

    # -- running --

    def tick(self) -> None:
        """Do a fixed small number of steps; compiled code releases the GIL meanwhile.

        Raises:
            SimulationError: the state would no longer be finite; the last good one is kept, and only `reset` goes on.
        """
        self._run(self._tick_steps)

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
            if self._asleep:
                self._time_not_stepped += end - self.time
                self.time = end
                return
            left = math.ceil((end - self.time) / self._dt - 1e-9)
            self._run(min(self._tick_steps, left), last_time=end)
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
        self._seeking_rest = False
        self.model.soften(1.0)
        self._refresh_time_step(tolerance=5e-4)
        return self.report(reason)

    def _come_to_rest(self, on_tick: OnTick | None) -> str:
        """Run until the cloth lies still or there is no hope that it will; why it ended."""
        self._seeking_rest = True
        self._stall_watch, self._tightness_watch, self._stalled = StallWatch(), TightnessWatch(), ""
        self._calming.active = True
        stopped = self.steps == 0 and self._start_coarse(on_tick)
        if self.phase == SEWING:
            self.model.soften(_SOFTNESS)
        self._refresh_time_step()
        reason = "stopped before it came to rest"
        while not stopped:
            if self.settled:
                s = self.scene.settings
                reason = f"no particle moved by more than {1000 * s.rest_displacement:g} mm in {s.rest_window:g} s"
                break
            if self.time >= self.scene.settings.max_time:
                reason = f"not at rest after {self.time:.3g} s, the longest time that the settings allow"
                break
            hopeless: str | None = self._stalled
            if not hopeless and self.phase != SEWING and not self.grasps:
                hopeless = why_unsupported(self.model.scene, self._x)
            if hopeless:
                reason = hopeless
                break
            self.tick()
            if on_tick is not None and on_tick(self):
                break
        return reason

    def _start_coarse(self, on_tick: OnTick | None) -> bool:
        """Drape a coarser mesh first, and start from there; whether on_tick asked to stop meanwhile.

        Where that does not work out, because the coarse garment cannot be draped or something would cross, the fine one
        starts from the beginning.
        """
        scene = self.scene
        spacing = _COARSER * scene.settings.spacing
        if not scene.worn or len(scene.pins) > 0 or self.phase != SEWING or spacing > _COARSEST:
            return False
        stopped = False

        def follow(coarse: Simulation) -> bool:
            nonlocal stopped
            self.time, self.steps, self.phase = coarse.time, coarse.steps, coarse.phase
            stopped = on_tick is not None and bool(on_tick(self))
            return stopped or not coarse._calming.active or bool(coarse._seams.open_seams)

        try:
            coarse = Simulation(replace(scene, fabric=scene.fabric.smoothed).with_spacing(spacing))
            coarse._calming.rough = True
            interpolation = interpolation_between(coarse.scene.garment, scene.garment)
            self._coarse = (coarse, interpolation)
            coarse._come_to_rest(follow)
        except ClothError:
            return stopped
        finally:
            self._coarse = None
            self.phase = SEWING
            self._sewing_began = self.time
        x = interpolation(coarse.positions)
        if coarse.phase == SEWING:
            self._sewing_began = coarse._sewing_began
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
        count = self.grasps.take(name, particles, pose, self.model, self._x)
        self._v[self.model.inverse_mass == 0.0] = 0.0
        self._refresh_time_step()
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
        count = self.grasps.release(name, self.model)
        # The last estimate knows nothing of what was held.
        self._stable = self.model.stable_step(self._x, self._air_drag())
        self._refresh_time_step(estimate=False)
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
        if self.scene.body is None:
            raise SceneError("move_body: the scene has no body; build one with a body")
        motion = BodyMotion(self.scene.body, vertices, duration, max_speed)
        self._body_motion = None if motion.done else motion
        self._contact_settings = self._contact_settings._replace(body_velocity=motion.velocity)
        self._search_contacts()
        self._wake()

    @property
    def body_moves(self) -> bool:
        """Whether the body is on its way."""
        return self._body_motion is not None

    def _wake(self) -> None:
        self.settled = self._asleep = False
        if self.phase == REST:
            self.phase = DRAPING
        self._open_window()

    def _advance_body(self, elapsed: float) -> None:
        assert self._body_motion is not None
        assert self.model.contact is not None
        assert self.model.contact.body is not None
        body = self._body_motion.advance(elapsed)
        self.scene = self.model.scene = replace(self.scene, body=body)
        self.model.contact.body.body = body
        self._contact_settings = self._contact_settings._replace(
            body_vertices=body.vertices, body_velocity=self._body_motion.velocity
        )
        if self._body_motion.done:
            self._body_motion = None

    def _run(self, count: int, last_time: float = math.inf) -> None:
        self._refuse_to_go_on()
        began = time.perf_counter()
        before = self.time
        good = self._finite_state()
        done = 0
        dt = self._dt if last_time == math.inf else min(self._dt, (last_time - self.time) / count)
        settings = self.scene.settings
        while done < count:
            motion, steps = self._body_motion, self.grasps.steps(count - done)
            if motion is not None:
                # One step at a time: to the contacts the body stands where it was at the search.
                steps = 1
            if self._flight_step < dt:
                self._flight_step = self._longest_flight(self._speeds())
            step = min(dt, self._flight_step)
            self._rescale_impulses(step)
            before_steps = self._finite_state() if self._smooth is not None else None
            if self.grasps:
                self.grasps.prescribe(self.model, self._x, self._v, self._contacts.travel, steps * step)
            openness = self._openness()
            did = self._steps(step, steps, openness)
            folds = self._folds()
            if before_steps is not None and folds == FOLDED:
                # Parts that were left out of the search may have met: back, and once more with them.
                self._x, self._v = before_steps.x, before_steps.v
                self._search_contacts()
                continue
            done += did
            self.steps += did
            self.time += did * step
            self.grasps.advance(did / steps)
            if motion is not None:
                self._check_finite(good)
                self._advance_body(did * step)
                self._search_contacts()
                good = self._finite_state()  # of the cloth around the body where it is by now
            elif (did < steps or folds == FOLDING) and self.model.contact is not None:
                self._check_finite(good)
                self._search_contacts()
        self._check_finite(good)
        if self.model.contact is not None and self._contacts_spent():
            self._search_contacts()
        if self._seeking_rest:
            limit_speed(self._v)
            if self.phase != SEWING and self._calming.active:
                self._calming.brake(self._v, self._dt * self._tick_steps)
        if self.model.softness < 1.0 and self.time - self._sewing_began > settings.closing_time:
            self._stiffen()
        if self.phase == SEWING:
            self._sew()
        elif not self._sew_the_rest() and self._rest.due(self.time):
            self._check_rest()
        if self.time >= self._next_check:
            self._refresh_time_step()
        wall = time.perf_counter() - began
        self._wall += wall
        if wall > 0.0:
            self._speed += 0.1 * ((self.time - before) / wall - self._speed)

    def _steps(self, step: float, count: int, openness: float) -> int:
        """Up to `count` steps of that length [s] by the scene's integrator; how many were done."""
        arguments = (
            self._x, self._v, self._work, self._moved, self._terms, self._contact_settings, self._contacts, step, count,
        )  # fmt: skip
        if self._implicit is not None:
            return implicit_steps(*arguments, self._implicit)
        return run_steps(*arguments, openness, 1.0 / self.scene.settings.closing_time)

    @property
    def _smooth(self) -> SmoothWindows | None:
        contact = self.model.contact
        return contact.cloth.smooth if contact is not None and contact.cloth is not None else None

    def _folds(self) -> int:
        """What has become of cloth that was too smooth to be searched for contact with itself; what folds will be."""
        smooth, contact = self._smooth, self.model.contact
        if smooth is None or contact is None:
            return SMOOTH
        folds = smooth.state(self._x, self.model.triangles)
        if folds != SMOOTH:
            contact.forget()
        return folds

    def _openness(self) -> float:
        """Share of its start length to which a seam's pull lets it close by now."""
        if self.phase != SEWING:
            return 0.0
        return max(1.0 - (self.time - self._sewing_began) / self.scene.settings.closing_time, 0.0)

    def _rescale_impulses(self, step: float) -> None:
        """Impulses that the next step starts from belong to the last step's length [s]; forces go on, not impulses."""
        if step != self._impulse_step:
            ratio = step / self._impulse_step
            self.model.strain_limit.impulse[:] *= ratio
            self._contacts.pairs.impulse[:] *= ratio
            self._contacts.pairs.friction[:] *= ratio
            self._impulse_step = step

    # -- parts of a run --

    def _use(self, model: Model, unsewn_x: Floats, unsewn_v: Floats, softness: float = 1.0) -> None:
        """Take over a model and bring the state into its numbering, keeping momentum."""
        self.model = model
        garment = self.scene.garment
        weight = garment.particle_areas
        self._x = model.gather(unsewn_x, weight)
        self._v = model.gather(unsewn_v, weight)
        self.grasps.hold(model, self._x)
        self._v[model.inverse_mass == 0.0] = 0.0
        self._calming.start(self._v)
        self._moved = np.zeros(len(self._x))
        self._implicit: ImplicitState | None = None
        if self.scene.settings.integrator == "implicit":
            matrix = build_matrix(len(self._x), model.springs, model.bending, model.trellis, model.trellis_stiffness)
            self._implicit = ImplicitState.of(matrix, garment.spacing)
        model.soften(softness)
        self._contact_settings = model.contact_settings()
        if self._body_motion is not None:
            self._contact_settings = self._contact_settings._replace(body_velocity=self._body_motion.velocity)
        self._work = Workspace.of(0)  # so that the old one takes no room meanwhile
        self._stable = model.stable_step(self._x, self._air_drag())
        self._work = Workspace.of(len(self._x))
        self._contacts = ContactState.none()
        self._flight_step = math.inf
        self._impulse_step = 1.0
        self._refresh_time_step(estimate=False)
        if model.contact is not None:
            self._search_contacts()
        self._open_window()

    def _air_drag(self) -> float:
        extra = 0.0
        if self.model.sewing:
            extra = _SEWING_DRAG
        elif self._seeking_rest:
            extra = self.scene.settings.settle_drag
        return max(self.model.scene.air_drag, extra)

    def _refresh_time_step(self, estimate: bool = True, tolerance: float = 1e-2) -> None:
        drag = self._air_drag()
        if estimate:
            self._stable = self.model.stable_step(self._x, drag, self._stable.mode, tolerance)
        self._terms = self.model.force_terms(drag)
        longest = self.model.longest_step(self._stable)
        wanted = self.scene.settings.time_step
        if self._implicit is not None:
            usual = _IMPLICIT_STEP if self.scene.body is None else _IMPLICIT_STEP_ON_BODY
            self._dt = usual if wanted is None else wanted
        elif wanted is None:
            self._dt = longest
        else:
            self._dt = wanted / math.ceil(wanted / longest - 1e-9)
            if self._dt < wanted and not any(w.startswith("time step") for w in self._warnings):
                self._warnings.append(
                    f"time step {wanted:g} s: longer than the stable {longest:g} s; cut into sub-steps"
                )
        self._next_check = self.time + _CHECK_INTERVAL

    def _search_contacts(self) -> None:
        assert self.model.contact is not None
        speed = self._speeds()
        crowded = self._contacts.pairs.listed_count[0] > _CROWDED * len(speed)
        steps = _STEPS_IN_A_CROWD if crowded else _STEPS_PER_SEARCH
        reach = np.maximum(steps * self._dt * speed, _LEAST_REACH)
        self._contacts = self.model.contact.search(self._x, reach)
        self._searches += 1
        renewal = self._contacts.renewal._replace(
            steps=steps, least_reach=_LEAST_REACH, least_room=self._least_room,
            # What is held goes its own way, and the bounds of what a moving body comes near are those of that moment.
            allowed=self._body_motion is None and not self.grasps,
        )  # fmt: skip
        self._contacts = self._contacts._replace(renewal=renewal)
        if self._body_motion is not None:
            self._contacts = self._body_motion.found(self._x, self._contacts, self._contact_settings.offset)
        self._flight_step = self._longest_flight(speed)

    @property
    def _least_room(self) -> float:
        return _LEAST_ROOM * self.scene.settings.cloth_offset

    def _longest_flight(self, speed: Floats) -> float:
        """How long a step may be [s] so that contact stops nobody on the way; speed (n,) [m/s]."""
        # What may be left of a way when it counts as not yet spent is enough for one more step.
        room = np.maximum((1.0 - SPENT) * self._contacts.travel, self._least_room)
        return float((room / np.maximum(speed, 1e-9)).min())

    def _contacts_spent(self) -> bool:
        return _any_beyond(self._moved, self._contacts.travel, SPENT)

    def _speeds(self) -> Floats:
        return _lengths(self._v)

    def _largest_speed(self) -> float:
        return float(self._speeds().max())

    def _refuse_to_go_on(self) -> None:
        if self._failure:
            raise SimulationError(f"the run has failed and cannot go on, reset it: {self._failure}")

    def _finite_state(self) -> _FiniteState:
        return _FiniteState(self._x.copy(), self._v.copy(), self.time, self.steps)

    def _check_finite(self, good: _FiniteState) -> None:
        particle = _first_out_of_bounds(self._x, self._v)
        if particle < 0:
            return
        original = int(np.flatnonzero(self.model.number == particle)[0])
        panel = self.scene.garment.panel_names[self.scene.garment.panel_of_particle[original]]
        self._failure = (
            f"particle {original} of panel '{panel}': left all bounds at {self.time:.4f} s with a time step of "
            f"{self._dt:.3g} s; use a smaller time step or safety factor"
        )
        self._x, self._v, self.time, self.steps = good
        self.phase, self.settled = FAILED, False
        raise SimulationError(self._failure)

    def _sew(self) -> None:
        """Merge the seams when they have closed."""
        model = self._seams.merged(self.scene, self.model, self.positions, self.time, self.time - self._sewing_began)
        if model is None:
            return
        self.phase = DRAPING
        # Merging moves points at once: what that stretches or shortens comes back softly.
        softness = _SOFTNESS if self._seeking_rest else self.model.softness
        self._use(model, self._seams.positions, np.asarray(self._v[self.model.number]), softness)

    def _sew_the_rest(self) -> bool:
        """Merge points of seams that had to stay open at first; whether some were."""
        if not self._seams.open_seams or self._body_motion is not None or self.grasps:
            return False
        model = self._seams.merged_later(self.scene, self.model, self.positions, self.time)
        if model is None:
            return False
        self._use(model, self._seams.positions, np.asarray(self._v[self.model.number]))
        return True

    def _open_window(self) -> None:
        settings, gravity = self.scene.settings, self.scene.gravity
        height = float(np.ptp(self._x @ np.array(gravity))) / max(float(np.linalg.norm(gravity)), 1e-12)
        slowest = slowest_swing(gravity, height)
        self._rest = RestWatch(settings.rest_displacement, settings.rest_window, slowest, self._air_drag())
        self._rest.open(self.time, self._x)

    def _check_rest(self) -> None:
        at_rest = self._rest.at_rest(self.time, self._x)
        movement = self._rest.movement or 0.0
        allowed = self.scene.settings.rest_displacement
        if self._seeking_rest and not at_rest:
            self._stalled = self._why_hopeless(movement)
        if self._seeking_rest and self._calming.active:
            if self._calming.ended(movement, allowed):
                self._open_window()
            return
        if not at_rest:
            self._calming.resume(movement, allowed)
        self.settled = at_rest
        if self.settled:
            acted_on = self._body_motion is not None or bool(self.grasps)
            self._asleep = self._has_settled and not acted_on and movement <= _NOTHING
            self._has_settled = self._has_settled or self._seeking_rest
            self.phase = REST
        elif self.phase == REST:
            self.phase = DRAPING

    def _why_hopeless(self, movement: float) -> str:
        """Why a run to rest whose last window moved something by that much [m] will not get there; empty if it may."""
        tightness, still_open = Tightness.of(self.model, self._x), bool(self._seams.open_seams)
        self._tightness_watch.look(tightness)
        number, x = self.model.number, self._x
        fallen = why_fallen(self.scene, number, x, self._rest.farthest)
        patience = self._tightness_watch.patience(still_open, self._seams.may_close)
        if not self._stall_watch.stalls(self.time, movement, PATIENCE_WITH_FALLEN if fallen else patience):
            return ""
        since = self._stall_watch.since
        if fallen or self._tightness_watch.is_tight(still_open):
            return fallen or tightness.line
        return why_restless(self.scene.garment, number, x, self._rest, self.time - since)

    def _stiffen(self) -> None:
        """A little more of the true stiffness."""
        growth = (1.0 / _SOFTNESS) ** (self._dt * self._tick_steps / _STIFFENING_TIME)
        self.model.soften(self.model.softness * growth)
        self._refresh_time_step()
        self._open_window()

    def _rest_estimate(self) -> float | None:
        """Rest time if the movement per window goes on shrinking at the present rate."""
        movement, ratio = self._rest.movement, self._rest.ratio
        if self.settled:
            return self.time
        if movement is None or ratio is None or not 0.0 < ratio < 0.99:
            return None
        settings = self.scene.settings
        windows = math.log(max(settings.rest_displacement / movement, 1e-9)) / math.log(ratio)
        return self.time + max(windows, 1.0) * settings.rest_window

    # -- results --

    @property
    def _state(self) -> RunState:
        return RunState(
            scene=self.scene, model=self.model, x=self._x, v=self._v, positions=self.positions, forces=self._terms,
            contact_settings=self._contact_settings, contacts=self._contacts, time_step=self._dt, stable=self._stable,
            phase=self.phase, simulated_time=self.time,
        )  # fmt: skip

    def report(self, rest_reason: str | None = None) -> Report:
        """Measure the present state (exact triangle tests included)."""
        if rest_reason is None:
            rest_reason = "at rest" if self.settled else f"{self.phase}"
        why_open = self._seams.why_open(self.scene, self.positions)
        return report_of(
            self._state,
            steps=self.steps,
            wall_time=self._wall,
            settled=self.settled,
            rest_reason=rest_reason,
            open_seams=tuple(why_open),
            contact_searches=self._searches,
            time_not_stepped=self._time_not_stepped,
            warnings=[*self._warnings, *why_open.values()],
        )

    def state_hash(self) -> str:
        """SHA-256 of positions and velocities, little-endian float64."""
        return hash_of(self._x, self._v)

    def describe(self) -> dict[str, Any]:
        """Terms with reasons and measured shares, counts and the stable time step, as JSON types; nothing is run."""
        return description_of(self._state)


@kernel
def _first_out_of_bounds(x: Floats, v: Floats) -> int:
    """First particle whose place is not finite or whose speed is none that cloth can have, -1 if there is none."""
    for i in range(x.shape[0]):
        for axis in range(3):
            if not (np.isfinite(x[i, axis]) and abs(v[i, axis]) < _HIGHEST_SPEED):
                return i
    return -1


@kernel
def _any_beyond(moved: Floats, travel: Floats, share: float) -> bool:
    """Whether anything has moved by more than a share of its travel [m]; moved is squared [m^2], all (n,)."""
    for i in range(moved.shape[0]):
        if moved[i] > (share * travel[i]) * (share * travel[i]):
            return True
    return False


@kernel
def _lengths(v: Floats) -> Floats:
    """Of each row of v (n, 3), shape (n,)."""
    lengths = np.empty(v.shape[0])
    for i in range(v.shape[0]):
        lengths[i] = np.sqrt(v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1] + v[i, 2] * v[i, 2])
    return lengths
