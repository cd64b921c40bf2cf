"""The time step from which a scene really blows up, by bisection: the experiment that predictions are held to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cloth_core.errors import SimulationError
from cloth_core.model import Model
from cloth_core.motion import Motion
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

__all__ = ["BlowUp", "FixedStepMotion", "measure_blow_up"]

Floats = NDArray[np.float64]

# Noise that a trial starts from and the movement that counts as blown up, as shares of the shortest spring.
_NOISE, _BLOWN_UP = 1e-7, 1e-3
# Where contact and gravity are at work the cloth moves a little by itself.
_BLOWN_UP_IN_CONTACT = 0.3
# The bracket is halved until its ends differ by less than this.
_PRECISION = 0.002


@dataclass(frozen=True)
class BlowUp:
    """What was predicted for a scene and what happened.

    Attributes:
        predicted: stable time step of the assembled model [s].
        measured: shortest time step with which the scene blew up [s]; 0.2 % below it, it stayed bounded.
        damping_ratio: of the predicted limiting mode.
        particles: how many the scene has.
    """

    predicted: float
    measured: float
    damping_ratio: float
    particles: int

    @property
    def ratio(self) -> float:
        """Predicted over measured: 1 is exact, above 1 is unsafe."""
        return self.predicted / self.measured


class FixedStepMotion(Motion):
    """A motion whose time step is what an experiment says, stable or not.

    Attributes:
        fixed_step: [s]; None: as usual.
    """

    fixed_step: float | None = None

    def search_contacts(self) -> None:
        """As for any motion, without renewals."""
        super().search_contacts()
        # Particles that are stopped at the end of their way again and again hold back what blows up as well.
        self.contacts = self.contacts._replace(renewal=self.contacts.renewal._replace(allowed=False))

    def refresh_time_step(self, estimate: bool = True, tolerance: float = 1e-2) -> None:
        """As for any motion, but for the time step."""
        super().refresh_time_step(estimate and self.fixed_step is None, tolerance)
        if self.fixed_step is not None:
            self.time_step = self.fixed_step


def measure_blow_up(
    scene: Scene,
    *,
    change: Callable[[Model], None] | None = None,
    rest_first: float = 0.0,
    steps: int = 1500,
) -> BlowUp:
    """Bisect the time step between bounded and blown up.

    Every trial starts from the same state with noise on all free particles and with the predicted limiting mode, and
    runs `steps` steps of the simulation itself, contact and all. Just above the limit an undamped mode of frequency w
    grows by 1 + sqrt(8 e) a step where w dt = 2 (1 + e), an overdamped one by 1 + 2 e.

    Args:
        scene: what is tried.
        change: alters the assembled model before it is used, for example its masses.
        rest_first: time for which the scene runs as usual before the trials [s].
        steps: of each trial; fewer make the measured limit come out a little too long.

    Returns:
        prediction (from the state in which the trials start) and measurement.
    """
    motion = FixedStepMotion(scene)
    model, start = _state(scene, rest_first)
    if change is not None:
        change(model)
    if scene.body is None:
        model.contact = None  # contact of cloth with cloth holds back what blows up, and hides it
    motion.use(model, start, np.zeros_like(start))
    predicted = model.stable_step(motion.x, motion.air_drag)
    if not math.isfinite(predicted.time_step):
        raise SimulationError("blow-up: nothing stiff and nothing that drags can move; take a scene with a limit")
    origin = motion.x.copy()
    shortest = _shortest(model, scene)
    limit = (_BLOWN_UP_IN_CONTACT if model.contact is not None or rest_first > 0.0 else _BLOWN_UP) * shortest
    noise = _noise(model, predicted.mode, _NOISE * shortest)

    def blows_up(dt: float) -> bool:
        motion.x[:] = origin + noise
        motion.v[:] = 0.0
        motion.fixed_step = dt
        motion.refresh_time_step()
        if model.contact is not None:
            motion.search_contacts()
        done = motion.steps
        try:
            while motion.steps < done + steps:
                motion.run(motion.tick_steps)
                if not float(np.abs(motion.x - origin).max()) < limit:
                    return True
        except SimulationError:
            motion.x, motion.v = origin.copy(), np.zeros_like(origin)
            return True
        return False

    low, high = _bracket(blows_up, predicted.time_step)
    while high / low > 1.0 + _PRECISION:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if blows_up(middle) else (middle, high)
    return BlowUp(predicted.time_step, high, predicted.damping_ratio, model.particle_count)


def _state(scene: Scene, run_first: float) -> tuple[Model, Floats]:
    """The model, and positions in the unsewn numbering (n, 3) [m], after the scene has run for a time [s]."""
    if run_first == 0.0:
        return Model(scene, sewing=bool(scene.garment.seams)), scene.garment.start
    simulation = Simulation(scene)
    simulation.advance(run_first)
    return simulation.model, simulation.positions


def _bracket(blows_up: Callable[[float], bool], guess: float) -> tuple[float, float]:
    """A bounded and a blown-up step on either side of the limit, searched outwards from a guess."""
    step = guess * 1.01
    factor = 1.05
    if blows_up(step):
        while True:
            shorter = step / factor
            if not blows_up(shorter):
                return shorter, step
            step, factor = shorter, min(factor * factor, 4.0)
    while True:
        longer = step * factor
        if longer > 1e6 * guess:
            raise SimulationError(
                f"blow-up: nothing blows up with steps of {guess:.3g} to {longer:.3g} s; take a scene with a limit"
            )
        if blows_up(longer):
            return step, longer
        step, factor = longer, min(factor * factor, 4.0)


def _shortest(model: Model, scene: Scene) -> float:
    """Shortest spring [m], or the spacing where there is none."""
    lengths = model.springs.rest_length
    positive = lengths[lengths > 1e-9]
    return float(positive.min()) if len(positive) else scene.garment.spacing


def _noise(model: Model, mode: Floats, amplitude: float) -> Floats:
    """Random displacements [m] of the free particles and, as large, the limiting mode; shape (k, 3)."""
    free = (model.inverse_mass > 0.0)[:, None]
    random = np.random.default_rng(0).uniform(-1.0, 1.0, mode.shape)
    shape = mode * np.sqrt(model.inverse_mass)[:, None]  # the mode is mass-scaled
    largest = float(np.abs(shape).max())
    seeded = shape / largest if largest > 0.0 else 0.0
    return np.asarray(amplitude * free * (random + seeded))
