"""Takes a model's particles on in time: steps, searches for contacts between them, grippers and a moving body."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.contact_state import ContactSettings, ContactState
from cloth_core.errors import SceneError, SimulationError
from cloth_core.grasp import Grasps
from cloth_core.implicit_matrix import build_matrix
from cloth_core.implicit_step import ImplicitState, implicit_steps
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.model import Model
from cloth_core.moving_body import BodyMotion
from cloth_core.resting_regions import RestingRegions, awake_terms
from cloth_core.scene import Scene
from cloth_core.smooth_windows import FOLDED, FOLDING, SMOOTH, SmoothWindows
from cloth_core.stability import StableStep
from cloth_core.step import ForceTerms, Workspace, run_steps
from cloth_core.travel_renewal import SPENT

__all__ = ["Motion"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Steps between two looks at the run, and the same for implicit steps.
_TICK_STEPS = 32
_IMPLICIT_TICK_STEPS = 1
# Length of implicit steps where none is asked for [s]: by itself, and with a body, on which longer steps come to no
# rest.
_IMPLICIT_STEP = 1.0 / 120.0
_IMPLICIT_STEP_ON_BODY = 1.0 / 500.0
# Simulated time between two checks of the stable time step [s].
_CHECK_INTERVAL = 0.05
# Steps that a particle can go on at its speed before contacts are searched again, and the least such way [m].
_STEPS_PER_SEARCH = 30.0
# Where more pairs than this for each particle have to be looked at in each step, so many steps: they lengthen the list.
_CROWDED, _STEPS_IN_A_CROWD = 1.0, 12.0
_LEAST_REACH = 0.001
# What touches may go this share of the distance between layers in a step, however little room it has.
_LEAST_ROOM = 0.1
# Air drag while seams close [1/s].
_SEWING_DRAG = 10.0
# Cloth faster than this has left physics [m/s].
_HIGHEST_SPEED = 1000.0


class _FiniteState(NamedTuple):
    """What a run goes back to when it fails: positions and velocities (n, 3) [m, m/s], time [s], steps."""

    x: Floats
    v: Floats
    time: float
    steps: int


class Motion:
    """Positions and velocities of a model's particles, and what takes them on.

    There is none before `use` has given it a model.

    Args:
        scene: what is simulated.

    Attributes:
        scene: as given; its body is replaced while it moves.
        model: the terms at present.
        x, v: of the model's particles [m, m/s], (k, 3).
        time: simulated [s]; steps: done so far.
        tick_steps: steps between two looks at the run.
        time_step: in use [s]; stable: last estimate of the largest one.
        extra_drag: air drag beside the scene's, of which the larger one acts [1/s].
        sewn_since: when seams began to be pulled [s].
        grasps: who holds which particles; body_motion: the body on its way, None while it stands.
        terms, contact_settings, contacts, work, moved: what the compiled loops take.
        regions: which particles sleep; None: nobody asks.
        implicit: what implicit steps need; None for the others.
        searches: for contacts, so far.
        warnings: lines for the report.
    """

    model: Model
    x: Floats
    v: Floats
    time_step: float
    stable: StableStep
    terms: ForceTerms
    contact_settings: ContactSettings
    contacts: ContactState
    work: Workspace
    moved: Floats

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.time = 0.0
        self.steps = 0
        self.tick_steps = _TICK_STEPS if scene.settings.integrator == "symplectic" else _IMPLICIT_TICK_STEPS
        self.extra_drag = 0.0
        self.sewn_since = 0.0
        self.grasps = Grasps()
        self.body_motion: BodyMotion | None = None
        self.implicit: ImplicitState | None = None
        self.searches = 0
        self.warnings: list[str] = []
        self._impulse_step = 1.0
        self._flight_step = math.inf
        self._next_check = 0.0
        self.regions: RestingRegions | None = None

    def use(self, model: Model, unsewn_x: Floats, unsewn_v: Floats, softness: float = 1.0) -> None:
        """Take over a model and bring the state, (n, 3) in the unsewn numbering, into its own, keeping momentum."""
        self.model = model
        self.regions = None
        garment = self.scene.garment
        weight = garment.particle_areas
        self.x = model.gather(unsewn_x, weight)
        self.v = model.gather(unsewn_v, weight)
        self.grasps.hold(model, self.x)
        self.v[model.inverse_mass == 0.0] = 0.0
        self.moved = np.zeros(len(self.x))
        self.implicit = None
        if self.scene.settings.integrator == "implicit":
            matrix = build_matrix(
                len(self.x), model.springs, model.strain_limit, model.bending, model.trellis, model.trellis_stiffness
            )
            self.implicit = ImplicitState.of(matrix, garment.spacing)
        model.soften(softness)
        self.contact_settings = model.contact_settings()
        if self.body_motion is not None:
            self.contact_settings = self.contact_settings._replace(body_velocity=self.body_motion.velocity)
        self.estimate_stable_step()
        self.contacts = ContactState.none()
        self._flight_step = math.inf
        self._impulse_step = 1.0
        self.refresh_time_step(estimate=False)
        if model.contact is not None:
            self.search_contacts()

    # -- running --

    def run(self, count: int, last_time: float = math.inf) -> None:
        """Do so many steps, shorter ones where the last of them would end after last_time [s].

        Raises:
            SimulationError: the state would no longer be finite; the last good one is kept.
        """
        good = self._finite_state()
        done = 0
        dt = self.time_step if last_time == math.inf else min(self.time_step, (last_time - self.time) / count)
        while done < count:
            body, steps = self.body_motion, self.grasps.steps(count - done)
            if self._flight_step < dt:
                self._flight_step = self._longest_flight(self.speeds())
            step = min(dt, self._flight_step)
            if body is not None:
                steps = min(steps, self._steps_with_body(body, step))
            self._rescale_impulses(step)
            before_steps = self._finite_state() if self._smooth is not None else None
            if self.grasps:
                self.grasps.prescribe(self.model, self.x, self.v, self.contacts.travel, steps * step)
            did = self._steps(step, steps)
            folds = self._folds()
            if before_steps is not None and folds == FOLDED:
                # Parts that were left out of the search may have met: back, and once more with them.
                self.x, self.v = before_steps.x, before_steps.v
                self.search_contacts()
                self.look_at_regions()
                continue
            done += did
            self.steps += did
            self.time += did * step
            self.grasps.advance(did / steps)
            if body is not None:
                self._check_finite(good)
                self._advance_body(body, did * step)
                self.search_contacts()
                good = self._finite_state()  # of the cloth around the body where it is by now
            elif (did < steps or folds == FOLDING) and self.model.contact is not None:
                self._check_finite(good)
                self.search_contacts()
                self.look_at_regions()  # what sleeps may be hit before the next tick
        self._check_finite(good)
        if self.model.contact is not None and _any_beyond(self.moved, self.contacts.travel, SPENT):
            self.search_contacts()

    def check_time_step(self) -> None:
        """Estimate the stable time step anew if that is due."""
        if self.time >= self._next_check:
            self.refresh_time_step()

    def refresh_time_step(self, estimate: bool = True, tolerance: float = 1e-2) -> None:
        """Take the terms from the model, and the time step from a new estimate, or from the last one."""
        if estimate:
            self.estimate_stable_step(self.stable.mode, tolerance)
        self._take_terms()
        longest = self.model.longest_step(self.stable)
        wanted = self.scene.settings.time_step
        if self.implicit is not None:
            usual = _IMPLICIT_STEP if self.scene.body is None else _IMPLICIT_STEP_ON_BODY
            self.time_step = usual if wanted is None else wanted
        elif wanted is None:
            self.time_step = longest
        else:
            self.time_step = wanted / math.ceil(wanted / longest - 1e-9)
            if self.time_step < wanted and not any(w.startswith("time step") for w in self.warnings):
                self.warnings.append(
                    f"time step {wanted:g} s: longer than the stable {longest:g} s; cut into sub-steps"
                )
        self._next_check = self.time + _CHECK_INTERVAL

    def estimate_stable_step(self, mode: Floats | None = None, tolerance: float = 5e-4) -> None:
        """Look for the largest stable time step, from a mode or from nothing."""
        self.work = Workspace.of(0)  # its room is needed meanwhile
        self.stable = self.model.stable_step(self.x, self.air_drag, mode, tolerance)
        self.work = Workspace.of(len(self.x))

    def let_sleep(self, regions: RestingRegions | None) -> None:
        """Step only what is awake of the model's particles from now on; None: all of them."""
        self.regions = regions
        self._stop_what_sleeps()

    def look_at_regions(self) -> None:
        """See whether regions have come to lie still, or are disturbed."""
        if self.regions is not None and self.regions.look(self.time, self.x, self.contacts):
            self._stop_what_sleeps()

    def _stop_what_sleeps(self) -> None:
        self.v[self.asleep] = 0.0
        self._take_terms()

    @property
    def asleep(self) -> Bools:
        """Particles that are not stepped, (k,)."""
        return np.zeros(len(self.x), dtype=bool) if self.regions is None else self.regions.asleep

    def _take_terms(self) -> None:
        self.terms = self.model.force_terms(self.air_drag)
        if self.asleep.any():
            self.terms = awake_terms(self.terms, self.asleep)

    @property
    def air_drag(self) -> float:
        """What acts at present [1/s]."""
        return max(self.model.scene.air_drag, _SEWING_DRAG if self.model.sewing else self.extra_drag)

    def speeds(self) -> Floats:
        """Of all particles [m/s], (k,)."""
        return _lengths(self.v)

    def _steps(self, step: float, count: int) -> int:
        """Up to `count` steps of that length [s] by the scene's integrator; how many were done."""
        arguments = (
            self.x, self.v, self.work, self.moved, self.terms, self.contact_settings, self.contacts, step, count,
        )  # fmt: skip
        if self.implicit is not None:
            return implicit_steps(*arguments, self.implicit)
        closing_time = self.scene.settings.closing_time
        layers = float(self.scene.garment.layer_count)
        # Closing times until the seams of the outermost garment are closed.
        openness = max(layers - (self.time - self.sewn_since) / closing_time, 0.0) if self.model.sewing else 0.0
        return run_steps(*arguments, openness, 1.0 / closing_time)

    def _rescale_impulses(self, step: float) -> None:
        """Impulses that the next step starts from belong to the last step's length [s]; forces go on, not impulses."""
        if step != self._impulse_step:
            ratio = step / self._impulse_step
            self.model.strain_limit.impulse[:] *= ratio
            self.contacts.pairs.impulse[:] *= ratio
            self.contacts.pairs.friction[:] *= ratio
            self._impulse_step = step

    # -- contact --

    def search_contacts(self) -> None:
        """Look at what the steps may come into contact with; the model has contact."""
        assert self.model.contact is not None
        speed = self.speeds()
        crowded = self.contacts.pairs.listed_count[0] > _CROWDED * len(speed)
        steps = _STEPS_IN_A_CROWD if crowded else _STEPS_PER_SEARCH
        reach = np.maximum(steps * self.time_step * speed, _LEAST_REACH)
        self.contacts = self.model.contact.search(self.x, reach)
        self.searches += 1
        renewal = self.contacts.renewal._replace(
            steps=steps, least_reach=_LEAST_REACH, least_room=self._least_room,
            # What is held goes its own way, and the bounds of what a moving body comes near are those of that moment.
            allowed=self.body_motion is None and not self.grasps,
        )  # fmt: skip
        self.contacts = self.contacts._replace(renewal=renewal)
        if self.body_motion is not None:
            self.contacts = self.body_motion.found(self.x, self.contacts, self.contact_settings.offset)
        self._flight_step = self._longest_flight(speed)

    @property
    def _least_room(self) -> float:
        return _LEAST_ROOM * self.scene.settings.cloth_offset

    def _longest_flight(self, speed: Floats) -> float:
        """How long a step may be [s] so that contact stops nobody on the way; speed (k,) [m/s]."""
        # What may be left of a way when it counts as not yet spent is enough for one more step.
        room = np.maximum((1.0 - SPENT) * self.contacts.travel, self._least_room)
        return float((room / np.maximum(speed, 1e-9)).min())

    @property
    def _smooth(self) -> SmoothWindows | None:
        contact = self.model.contact
        return contact.cloth.smooth if contact is not None and contact.cloth is not None else None

    def _folds(self) -> int:
        """What has become of cloth that was too smooth to be searched for contact with itself; what folds will be."""
        smooth, contact = self._smooth, self.model.contact
        if smooth is None or contact is None:
            return SMOOTH
        folds = smooth.state(self.x, self.model.triangles)
        if folds != SMOOTH:
            contact.forget()
        return folds

    # -- the body --

    def move_body(self, vertices: Floats, duration: float, max_speed: float) -> None:
        """Let the body's vertices move linearly to new places; as `Simulation.move_body`."""
        if self.scene.body is None:
            raise SceneError("move_body: the scene has no body; build one with a body")
        motion = BodyMotion(self.scene.body, vertices, duration, max_speed)
        if self.model.scene.body is None:  # contact with it is switched off: nothing depends on its way
            self.scene = self.scene.with_body(self.scene.body.moved(np.array(vertices, dtype=np.float64)))
            return
        self.body_motion = None if motion.done else motion
        self.contact_settings = self.contact_settings._replace(body_velocity=motion.velocity)
        self.search_contacts()

    def _steps_with_body(self, motion: BodyMotion, step: float) -> int:
        """How many steps of that length [s] are done until the next search."""
        if self.implicit is not None:
            return 1
        steps, way = motion.steps(step, self.contact_settings.offset)
        # The steps take a copy of the vertices on; the body itself follows after them.
        vertices = motion.body.vertices.copy() if steps > 1 else motion.body.vertices
        self.contact_settings = self.contact_settings._replace(body_vertices=vertices, body_way=way)
        return steps

    def _advance_body(self, motion: BodyMotion, elapsed: float) -> None:
        assert self.model.contact is not None
        assert self.model.contact.body is not None
        body = motion.advance(elapsed)
        self.scene, self.model.scene = self.scene.with_body(body), self.model.scene.with_body(body)
        self.model.contact.body.body = body
        self.contact_settings = self.contact_settings._replace(
            body_vertices=body.vertices, body_velocity=motion.velocity, body_way=0.0
        )
        if motion.done:
            self.body_motion = None

    # -- what is no longer finite --

    def _finite_state(self) -> _FiniteState:
        return _FiniteState(self.x.copy(), self.v.copy(), self.time, self.steps)

    def _check_finite(self, good: _FiniteState) -> None:
        particle = _first_out_of_bounds(self.x, self.v)
        if particle < 0:
            return
        original = int(np.flatnonzero(self.model.number == particle)[0])
        panel = self.scene.garment.panel_names[self.scene.garment.panel_of_particle[original]]
        failure = (
            f"particle {original} of panel '{panel}': left all bounds at {self.time:.4f} s with a time step of "
            f"{self.time_step:.3g} s; use a smaller time step or safety factor"
        )
        self.x, self.v, self.time, self.steps = good
        raise SimulationError(failure)


@borrowing_kernel
def _first_out_of_bounds(x: Floats, v: Floats) -> int:
    """First particle whose place is not finite or whose speed is none that cloth can have, -1 if there is none."""
    for i in range(x.shape[0]):
        for axis in range(3):
            if not (np.isfinite(x[i, axis]) and abs(v[i, axis]) < _HIGHEST_SPEED):
                return i
    return -1


@borrowing_kernel
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
