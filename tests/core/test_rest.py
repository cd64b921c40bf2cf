"""Rest: a swing that turns round is not at rest, what lies still is, and what is called settled stays."""

import math

import numpy as np
import pytest
from apparatus import sheet

from cloth_core.fabric import Fabric
from cloth_core.quality import Settings
from cloth_core.rest import RestWatch, StallWatch, slowest_swing
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

DISPLACEMENT, WINDOW = 0.0005, 0.1


def called_at_rest(motion, slowest: float = 3.0, seconds: float = 20.0) -> list[float]:
    """Times at which a particle that moves as `motion` says [m] is called at rest."""
    watch = RestWatch(DISPLACEMENT, WINDOW, slowest)
    watch.open(0.0, np.zeros((1, 3)) + motion(0.0))
    times = (k * WINDOW for k in range(1, round(seconds / WINDOW)))
    return [t for t in times if watch.at_rest(t, np.zeros((1, 3)) + motion(t))]


@pytest.mark.parametrize("frequency", [3.0, 5.0, 10.0])
@pytest.mark.parametrize("phase", [0.0, 0.4, 0.8, 1.2])
def test_turning_point_of_a_swing_is_not_rest(frequency, phase):
    # Its highest speed times the window is twice the displacement: nowhere is it at rest, and yet at its turning points
    # it moves by less than the displacement in a window.
    amplitude = 2.0 * DISPLACEMENT / WINDOW / frequency
    swing = lambda t: np.array([amplitude * math.cos(frequency * t + phase), 0.0, 0.0])  # noqa: E731
    ways = [np.linalg.norm(swing(k * WINDOW) - swing((k - 1) * WINDOW)) for k in range(1, 200)]
    assert min(ways) < 0.5 * DISPLACEMENT
    assert called_at_rest(swing) == []


@pytest.mark.parametrize("frequency", [3.0, 5.0, 10.0])
def test_swing_that_moves_less_than_the_displacement_in_any_window_is_rest(frequency):
    amplitude = 0.3 * DISPLACEMENT / WINDOW / frequency
    assert len(called_at_rest(lambda t: np.array([0.0, amplitude * math.sin(frequency * t), 0.0]))) > 190


def test_what_lies_still_is_at_rest_after_two_windows():
    assert called_at_rest(lambda t: np.ones(3))[0] == pytest.approx(2 * WINDOW)


@pytest.mark.parametrize(("speed", "rest"), [(0.9, True), (1.1, False)])
def test_steady_motion_is_rest_below_the_displacement_per_window(speed, rest):
    assert bool(called_at_rest(lambda t: np.array([0.0, 0.0, speed * DISPLACEMENT / WINDOW * t]))) == rest


def test_slowest_swing_is_that_of_a_pendulum():
    assert slowest_swing((0.0, 0.0, -9.80665), 0.5) == pytest.approx(math.sqrt(9.80665 / 0.5))
    assert slowest_swing((0.0, 0.0, 0.0), 0.5) == 2.0


@pytest.mark.parametrize("held", ["corners", "side"])
def test_sheet_called_settled_moves_no_farther_than_promised(held):
    # In every window of the two seconds that follow, with the scene's own air, which calms nothing.
    garment = sheet(0.3, 0.2, 0.05)
    edge = garment.rest[:, 1] > 0.099
    pins = np.flatnonzero(edge & (np.abs(garment.rest[:, 0]) > (0.149 if held == "corners" else -1.0)))
    scene = Scene(
        garment=garment, fabric=Fabric.preset("cotton_poplin"), pins=pins.astype(np.int32), air_drag=0.0,
        settings=Settings(rest_displacement=DISPLACEMENT, rest_window=WINDOW, max_time=60.0),
    )  # fmt: skip
    simulation = Simulation(scene)
    assert simulation.settle().settled
    ways = []
    for _ in range(20):
        before = simulation.positions
        simulation.advance(WINDOW)
        ways.append(float(np.linalg.norm(simulation.positions - before, axis=1).max()))
    assert max(ways) <= 1.5 * DISPLACEMENT


@pytest.mark.parametrize(("decay", "stalls"), [(0.2, False), (0.3, False), (0.4, True), (1e9, True)])
def test_movements_that_do_not_halve_within_the_patience_stall(decay, stalls):
    # 0.01 exp(-t / decay) halves in 0.69 decay: within 0.25 s up to a decay of 0.36 s.
    watch = StallWatch()
    times = np.arange(0.0, 3.0, 0.01)
    assert any(watch.stalls(t, 0.01 * math.exp(-t / decay), 0.25) for t in times.tolist()) == stalls


def test_particle_that_went_farthest_is_known():
    watch = RestWatch(DISPLACEMENT, WINDOW, 3.0)
    x = np.zeros((4, 3))
    watch.open(0.0, x)
    x[2, 1] = 0.004
    x[3, 1] = 0.003
    watch.at_rest(WINDOW, x)
    assert (watch.farthest, watch.movement) == (2, pytest.approx(0.004))
