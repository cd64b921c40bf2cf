"""What lies still is not stepped, and is stepped again as soon as something acts on it."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, sheet

from cloth_core.fabric import Fabric
from cloth_core.grasp import Pose
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation


def on_a_ball() -> Simulation:
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    return Simulation(Scene(garment=sheet(0.25, 0.25, 0.05, z=0.11), body=ball, fabric=Fabric.preset("wool")))


def asleep() -> Simulation:
    simulation = on_a_ball()
    assert simulation.settle().settled
    simulation.advance(20.0)
    return simulation


def test_after_rest_time_goes_on_without_steps():
    simulation = asleep()
    steps, state, time = simulation.steps, simulation.state_hash(), simulation.time
    simulation.advance(1000.0)
    assert simulation.time == pytest.approx(time + 1000.0, abs=1e-9)
    assert (simulation.steps, simulation.state_hash()) == (steps, state)
    report = simulation.report()
    assert report.settled
    assert 1000.0 <= report.time_not_stepped < report.simulated_time


def test_stepping_on_would_have_changed_nothing(monkeypatch):
    simulation = asleep()
    monkeypatch.setattr("cloth_core.rest_search._NOTHING", -1.0)
    monkeypatch.setattr("cloth_core.resting_regions._STILL", -1.0)
    stepped = asleep()
    assert stepped.report().time_not_stepped == 0.0
    stepped.advance(5.0)
    assert stepped.steps > simulation.steps
    np.testing.assert_allclose(stepped.positions, simulation.positions, atol=1e-6)


def test_motion_without_a_run_to_rest_is_always_stepped():
    simulation = on_a_ball()
    simulation.advance(12.0)
    assert simulation.report().time_not_stepped == 0.0


def test_a_gripper_wakes_it():
    simulation = asleep()
    steps, x = simulation.steps, simulation.positions
    corner = int(np.argmax(x[:, 0] + x[:, 1]))
    simulation.grasp("hand", np.array([corner]), Pose.of(x[corner]))
    simulation.move_grasp("hand", Pose.of(x[corner] + [0.0, 0.0, 0.05]))
    simulation.advance(0.3)
    assert simulation.steps > steps
    assert simulation.positions[corner, 2] == pytest.approx(x[corner, 2] + 0.05, abs=1e-6)
    # What is held stays awake; what is let go falls.
    simulation.release("hand")
    simulation.advance(0.09)
    assert simulation.positions[corner, 2] < x[corner, 2] + 0.049


def test_a_body_that_moves_wakes_it():
    simulation = asleep()
    before = simulation.positions
    body = simulation.scene.body
    simulation.move_body(body.vertices + np.array([0.0, 0.0, 0.02]), 0.2)
    simulation.advance(0.5)
    assert simulation.positions[:, 2].max() == pytest.approx(before[:, 2].max() + 0.02, abs=2e-3)


def test_a_reset_wakes_it():
    simulation = asleep()
    simulation.reset()
    simulation.advance(0.05)
    assert simulation.steps > 0
    assert simulation.report().time_not_stepped == 0.0
