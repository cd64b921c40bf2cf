"""A body that moves: it takes cloth along by contact and friction, and never passes through it."""

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, crossings, placed, plain_fabric, sheet

from cloth_core.body import Body
from cloth_core.errors import BodyError, SceneError
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

OFFSET = 0.003
SIZE = 4.0
BALL = body_of(trimesh.creation.icosphere(2, radius=0.1))


def plate(z=0.0):
    corners = SIZE / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return Body.from_arrays(corners + np.array([0, 0, z]), [[0, 1, 2], [0, 2, 3]], "plate")


def on(body, garment, friction=0.0, gravity=GRAVITY):
    return Simulation(
        Scene(
            garment=garment, body=body, fabric=plain_fabric(friction=friction, damping_time=1e-5), air_drag=0.0,
            gravity=(0.0, 0.0, -gravity), settings=Settings(contact_offset=OFFSET),
        )
    )  # fmt: skip


@pytest.mark.parametrize("speed", [0.25, 1.0])
def test_a_plate_drags_a_sheet_along_by_friction(speed):
    # Coulomb: the sheet gains mu g until it has the plate's speed, and has stayed behind by V^2 / (2 mu g).
    friction, duration = 0.5, 0.6
    simulation = on(plate(), sheet(0.12, 0.12, 0.04, z=OFFSET), friction)
    start = simulation.positions
    simulation.move_body(simulation.scene.body.vertices + np.array([speed * duration, 0, 0]), duration)
    simulation.advance(0.9 * duration)
    assert simulation.motion.v[:, 0] == pytest.approx(speed, rel=1e-6)
    behind = speed * simulation.time - (simulation.positions - start)[:, 0]
    assert behind.mean() == pytest.approx(speed**2 / (2 * friction * GRAVITY), rel=0.02)


def test_without_friction_a_sheet_stays_where_it_is():
    simulation = on(plate(), sheet(0.12, 0.12, 0.04, z=OFFSET))
    start = simulation.positions
    simulation.move_body(simulation.scene.body.vertices + np.array([0.5, 0, 0]), 0.5)
    simulation.advance(0.6)
    assert (simulation.positions - start)[:, :2] == pytest.approx(0.0, abs=1e-9)


def test_a_plate_lifts_a_sheet():
    simulation = on(plate(), sheet(0.12, 0.12, 0.04, z=OFFSET))
    simulation.move_body(simulation.scene.body.vertices + np.array([0, 0, 0.2]), 0.4)
    simulation.advance(0.2)
    assert simulation.motion.v[:, 2] == pytest.approx(0.5, abs=1.01 * GRAVITY * simulation.time_step)
    simulation.settle()
    assert not simulation.body_moves
    assert simulation.positions[:, 2] == pytest.approx(0.2 + OFFSET, abs=1e-4)


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_a_ball_thrown_through_a_sheet_takes_it_along(speed):
    ball = body_of(trimesh.creation.icosphere(2, radius=0.05), move=[0, 0, 0.1])
    simulation = on(ball, sheet(0.3, 0.3, 0.03), gravity=0.0)
    simulation.move_body(ball.vertices + np.array([0.02, 0.01, -0.3]), 0.3 / speed)
    while simulation.body_moves:
        simulation.tick()
        assert crossings(simulation.positions, simulation.triangles, simulation.scene.body) == 0
        assert simulation.time < 3.0
    assert simulation.scene.body.vertices == pytest.approx(ball.vertices + np.array([0.02, 0.01, -0.3]), abs=1e-15)
    assert simulation.positions[:, 2].min() < -0.2


def test_a_body_waits_where_it_would_crush_cloth():
    press = body_of(trimesh.util.concatenate([
        trimesh.creation.box(extents=[1, 1, 0.1], transform=trimesh.transformations.translation_matrix([0, 0, z]))
        for z in (-0.05 - OFFSET, 0.08)
    ]))  # fmt: skip
    simulation = on(press, sheet(0.1, 0.1, 0.05))
    upper = press.vertices[:, 2] > 0.02
    simulation.move_body(press.vertices - 0.06 * upper[:, None] * [0, 0, 1], 0.05)
    for _ in range(40):
        simulation.tick()
        assert crossings(simulation.positions, simulation.triangles, simulation.scene.body) == 0
    assert simulation.body_moves
    assert -OFFSET < simulation.scene.body.vertices[upper, 2].min() < 0.0


def test_a_body_out_of_reach_arrives_in_time_and_changes_nothing():
    far = body_of(trimesh.creation.icosphere(1, radius=0.1), move=[2, 0, 0])
    still, moving = (on(far, sheet(0.1, 0.1, 0.05), gravity=0.0) for _ in range(2))
    goal = far.vertices + np.array([0.0, 0.03, 0.01])
    moving.move_body(goal, 0.1)
    for simulation in (still, moving):
        simulation.advance(0.05)
    middle = moving.scene.body.vertices
    assert middle == pytest.approx((far.vertices + goal) / 2, abs=2e-3)
    for simulation in (still, moving):
        simulation.advance(0.06)
    assert (moving.scene.body.vertices == goal).all()
    assert moving.state_hash() == still.state_hash()
    moving.reset()
    assert moving.scene.body is far


def test_a_second_call_takes_over_and_the_speed_limit_holds():
    ball = body_of(trimesh.creation.icosphere(1, radius=0.1), move=[2, 0, 0])
    simulation = on(ball, sheet(0.1, 0.1, 0.05), gravity=0.0)
    simulation.move_body(ball.vertices + np.array([1.0, 0, 0]), 0.01, max_speed=0.5)
    simulation.advance(0.1)
    assert simulation.scene.body.vertices == pytest.approx(ball.vertices + np.array([0.05, 0, 0]), abs=3e-3)
    simulation.move_body(ball.vertices, 0.1)
    simulation.advance(0.15)
    assert (simulation.scene.body.vertices == ball.vertices).all()


def test_what_cannot_be_a_motion_is_refused():
    simulation = on(plate(), placed(sheet(0.1, 0.1, 0.05), move=[0, 0, 0.1]))
    vertices = simulation.scene.body.vertices
    for wrong, duration, complaint in (
        (vertices[:3], 0.1, "4 vertices and cannot move to 3"),
        (vertices * np.nan, 0.1, "vertex 0: .* not finite"),
        (vertices, 0.0, "give a time above 0"),
    ):
        with pytest.raises(BodyError, match=complaint):
            simulation.move_body(wrong, duration)
    free = Simulation(Scene(garment=sheet(0.1, 0.1, 0.05), fabric=plain_fabric()))
    with pytest.raises(SceneError, match="no body"):
        free.move_body(vertices, 0.1)


def test_steps_between_two_searches_are_those_with_one_before_each(monkeypatch):
    """A ball that turns under a sheet and rises: its surface goes on between two searches as it does at them."""
    turn = trimesh.transformations.rotation_matrix(0.3, [0.0, 1.0, 0.0])[:3, :3]
    goal = BALL.vertices @ turn.T + np.array([0.0, 0.0, 0.03])
    ends, searches, steps = [], [], []
    for share in (0.25, 0.0):
        monkeypatch.setattr("cloth_core.moving_body._WAY_SHARE", share)
        simulation = on(BALL, sheet(0.12, 0.12, 0.03, z=0.103), friction=0.4)
        simulation.advance(0.2)
        before = simulation.motion.searches, simulation.steps
        simulation.move_body(goal, 0.3)
        simulation.advance(0.4)
        assert not simulation.body_moves
        np.testing.assert_array_equal(simulation.scene.body.vertices, goal)
        searches.append(simulation.motion.searches - before[0])
        steps.append(simulation.steps - before[1])
        ends.append(simulation.positions)
    assert searches[0] < steps[0] / 4
    assert searches[1] > 0.7 * steps[1]
    # Of a way of 3 cm; one particle a hundredth of a millimetre elsewhere at the start makes 0.45 mm of difference.
    assert np.abs(ends[0] - ends[1]).max() < 1e-3
    assert (np.abs(ends[0] - sheet(0.12, 0.12, 0.03, z=0.103).start).max(axis=1) > 0.02).all()


def test_body_is_where_its_motion_says_however_many_steps_were_done_at_once():
    simulation = on(plate(), sheet(0.12, 0.12, 0.04, z=OFFSET), friction=0.5)
    start, way = simulation.scene.body.vertices.copy(), np.array([0.02, 0.0, 0.01])
    first = simulation.scene.body
    simulation.move_body(start + way, 0.4)
    while simulation.body_moves:
        time = simulation.time
        simulation.tick()
        assert simulation.time - time > 8 * simulation.time_step  # a tick is more than the steps done at once
        share = min(simulation.time / 0.4, 1.0)
        np.testing.assert_allclose(simulation.scene.body.vertices, start + share * way, atol=1e-12)
    np.testing.assert_array_equal(first.vertices, start)
