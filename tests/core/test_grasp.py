"""Grippers: held particles go where their frame goes, within the speed limit and never through a body."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, crossings, pattern, plain_fabric, rectangle, sheet
from scipy.spatial.transform import Rotation

from cloth_core.errors import SimulationError
from cloth_core.fabric import Fabric
from cloth_core.grasp import Pose
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation


def scene(body=None, gravity=0.0, **changes):
    return Scene(
        garment=sheet(0.3, 0.3, 0.03, z=0.2), body=body, fabric=plain_fabric(strain_limit=0.1, **changes), air_drag=0.0,
        gravity=(0.0, 0.0, -gravity), settings=Settings(),
    )  # fmt: skip


def corner(simulation, x, y, radius=0.05):
    return np.flatnonzero(np.linalg.norm(simulation.positions - [x, y, 0.2], axis=1) < radius)


def test_a_held_patch_moves_rigidly_with_its_gripper():
    simulation = Simulation(scene())
    held = corner(simulation, 0.15, 0.15)
    before = simulation.positions[held]
    start = Pose.of([0.1, 0.1, 0.25], Rotation.from_euler("x", 30, degrees=True).as_quat())
    turn = Rotation.from_euler("zyx", [40, -20, 10], degrees=True)
    goal = Pose.of([0.1, 0.2, 0.3], (turn * Rotation.from_quat(start.orientation)).as_quat())
    assert simulation.grasp("left", held, start) == len(held) > 3
    simulation.move_grasp("left", goal)
    simulation.advance(1.0)
    assert simulation.grasps.describe()["left"]["arrived"]
    expected = turn.apply(before - start.position) + goal.position
    assert simulation.positions[held] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("limit", [0.2, 2.0])
def test_no_held_particle_is_faster_than_the_limit(limit):
    simulation = Simulation(scene())
    held = corner(simulation, 0.15, 0.15)
    simulation.grasps.max_speed = limit
    simulation.grasp("left", held, Pose.of([0.0, 0.0, 0.2]))
    simulation.move_grasp("left", Pose.of([0.0, 0.4, 0.2], Rotation.from_euler("z", 180, degrees=True).as_quat()))
    fastest = 0.0
    last = simulation.positions[held]
    for _ in range(100):
        began = simulation.time
        simulation.tick()
        now = simulation.positions[held]
        fastest = max(fastest, np.linalg.norm(now - last, axis=1).max() / (simulation.time - began))
        last = now
    assert 0.5 * limit < fastest <= limit * (1 + 1e-9)


def test_the_limit_holds_where_contact_cuts_steps_short():
    ball = body_of(trimesh.creation.icosphere(3, radius=0.1), move=[0, 0, 0.098])
    simulation = Simulation(scene(ball, gravity=GRAVITY))
    simulation.grasps.max_speed = 0.05
    simulation.grasp("left", corner(simulation, 0.15, 0.15), Pose.of([0.15, 0.15, 0.2]))
    simulation.move_grasp("left", Pose.of([0.15, 0.15, 0.4]))
    for _ in range(30):
        simulation.tick()
        position = simulation.grasps.describe()["left"]["position"]
        assert position[2] - 0.2 <= 0.05 * simulation.time * (1 + 1e-9)
    assert position[2] > 0.2 + 0.04 * simulation.time


def test_what_is_let_go_falls_freely():
    simulation = Simulation(scene(gravity=GRAVITY))
    everything = np.arange(simulation.scene.garment.particle_count)
    simulation.grasp("left", everything, Pose.of([0.0, 0.0, 0.0]))
    simulation.advance(0.2)
    assert simulation.positions[:, 2] == pytest.approx(0.2, abs=1e-12)
    assert simulation.release("left") == len(everything)
    simulation.advance(0.1)
    # Symplectic Euler with n steps of dt falls g t^2 / 2 (1 + 1 / n).
    fallen = GRAVITY * 0.1**2 / 2 * (1 + simulation.time_step / 0.1)
    assert 0.2 - simulation.positions[:, 2] == pytest.approx(fallen, rel=1e-3)


def test_cloth_hangs_from_two_grippers_at_rest():
    cotton = replace(scene(gravity=GRAVITY), fabric=Fabric.preset("cotton_poplin"), air_drag=1.0)
    simulation = Simulation(cotton)
    corners = {"left": corner(simulation, -0.15, 0.15), "right": corner(simulation, 0.15, 0.15)}
    for name, held in corners.items():
        simulation.grasp(name, held, Pose.of([0.0, 0.0, 0.2]))
    assert simulation.settle().settled
    assert simulation.positions[:, 2].min() < 0.0
    for held in corners.values():
        assert simulation.positions[held] == pytest.approx(simulation.scene.garment.start[held], abs=1e-12)


def test_a_gripper_keeps_hold_while_seams_close():
    panels = {
        "front": rectangle(0.2, 0.2, at=(-0.115, 0.2, 0)),
        "back": rectangle(0.2, 0.2, at=(0.115, 0.2, 0)),
    }
    stitched = pattern(panels, [(("front", 1), ("back", 3))])
    simulation = Simulation(
        Scene.build(stitched, settings=Settings(spacing=0.025), fabric=plain_fabric(strain_limit=0.1), gravity=0.0)
    )
    x = simulation.positions[:, 0]
    held, sewn_to = np.flatnonzero((x < 0.0) & (x > -0.03)), np.flatnonzero((x > 0.0) & (x < 0.03))
    at = simulation.positions[held]
    assert simulation.grasp("left", held, Pose.of([0.0, 0.0, 0.0])) == len(held) > 5
    simulation.advance(1.5)
    assert simulation.phase in ("draping", "rest")  # sewn
    assert (simulation.model.inverse_mass == 0.0).sum() == len(held)
    # Where the seam has closed, its two sides met within its tolerance.
    assert simulation.positions[held] == pytest.approx(at, abs=simulation.scene.settings.seam_tolerance)
    at = simulation.positions[held]
    simulation.move_grasp("left", Pose.of([0.0, -0.2, 0.1]))
    simulation.advance(3.0, lambda s: s.grasps.describe()["left"]["arrived"])
    simulation.advance(0.1)
    assert simulation.positions[held] == pytest.approx(at + np.array([0.0, -0.2, 0.1]), abs=1e-9)
    # The other panel has come along by the seam.
    apart = np.linalg.norm(simulation.positions[sewn_to][:, None] - simulation.positions[held][None], axis=2)
    assert (apart.min(axis=1) == 0.0).all()


def test_held_cloth_cannot_be_pulled_through_a_body():
    ball = body_of(trimesh.creation.icosphere(3, radius=0.1))
    simulation = Simulation(scene(ball))
    simulation.grasps.max_speed = 10.0
    simulation.grasp("left", corner(simulation, 0.0, 0.0), Pose.of([0.0, 0.0, 0.2]))
    simulation.move_grasp("left", Pose.of([0.0, 0.0, -0.5]))
    for _ in range(60):
        simulation.tick()
        assert crossings(simulation.positions, simulation.triangles, ball) == 0
    gripper = simulation.grasps.describe()["left"]
    assert gripper["blocked"] or gripper["lag"] > 0.1


def test_two_grippers_do_not_tear_the_cloth():
    simulation = Simulation(scene(gravity=GRAVITY))
    for name, x in (("left", -0.15), ("right", 0.15)):
        simulation.grasp(name, corner(simulation, x, 0.15), Pose.of([x, 0.15, 0.2]))
        simulation.move_grasp(name, Pose.of([10 * x, 0.15, 0.2]))
    simulation.advance(1.0)
    assert all(gripper["blocked"] for gripper in simulation.grasps.describe().values())
    assert simulation.report().max_strain < 0.1
    assert simulation.progress.largest_speed < 5.0


def test_a_gripper_holds_cloth_whose_strain_limit_is_switched_off():
    simulation = Simulation(replace(scene(), without=("strain limit",)))
    held = corner(simulation, 0.15, 0.15)
    before = simulation.positions[held]
    simulation.grasp("left", held, Pose.of([0.15, 0.15, 0.2]))
    simulation.move_grasp("left", Pose.of([0.15, 0.15, 0.3]))
    simulation.advance(1.0)
    assert simulation.grasps.describe()["left"]["arrived"]
    np.testing.assert_allclose(simulation.positions[held], before + np.array([0.0, 0.0, 0.1]), atol=1e-6)


def test_a_held_particle_is_not_taken_by_another_gripper():
    simulation = Simulation(scene())
    held = corner(simulation, 0.15, 0.15)
    simulation.grasp("left", held, Pose.of([0, 0, 0]))
    with pytest.raises(SimulationError, match="right: there is nothing to hold"):
        simulation.grasp("right", held, Pose.of([0, 0, 0]))
    with pytest.raises(SimulationError, match=r"left: it holds \d+ particles; release them first"):
        simulation.grasp("left", held, Pose.of([0, 0, 0]))
    with pytest.raises(SimulationError, match="right: it holds nothing"):
        simulation.release("right")


@pytest.mark.parametrize(
    ("position", "orientation"),
    [([np.nan, 0, 0], [0, 0, 0, 1]), ([0, 0, 0], [0, 0, 0, 0]), ([0, 0], [0, 0, 0, 1]), ([0, 0, 0], [np.inf, 0, 0, 1])],
)
def test_poses_that_are_none(position, orientation):
    with pytest.raises(SimulationError, match="pose"):
        Pose.of(position, orientation)
