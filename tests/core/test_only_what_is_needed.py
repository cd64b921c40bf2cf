"""What a scene does not need is not done, and is done again as soon as it is needed, without being asked for."""

from dataclasses import replace

import numpy as np
import trimesh
from apparatus import body_of, crossings, pattern, placed, plain_fabric, rectangle, sheet, sides_through, throw

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

WEIGHTLESS = {"gravity": (0.0, 0.0, 0.0), "air_drag": 0.0}
POPLIN = Fabric.preset("cotton_poplin")


def two_sheets(gap: float) -> Garment:
    """Level, one above the other."""
    lower, upper = sheet(0.2, 0.2, 0.05), sheet(0.1, 0.1, 0.05, z=gap)
    return Garment.joined([replace(lower, name="lower"), replace(upper, name="upper")])


def listed(simulation: Simulation) -> int:
    """Pairs that can come into contact before the next search."""
    return int(simulation.motion.contacts.pairs.listed_count[0])


def through_each_other(simulation: Simulation) -> int:
    garment, x = simulation.scene.garment, simulation.positions
    one, other = (garment.triangles[garment.panel_of_triangle == k] for k in range(2))
    return sides_through(x, one, x, other) + sides_through(x, other, x, one)


def test_self_contact_has_nothing_to_do_until_layers_come_near_and_then_holds_them():
    garment = two_sheets(0.06)
    # In whole ticks of one length: how long a last, shorter step is depends on how the time was summed up.
    scene = Scene(garment=garment, fabric=plain_fabric(), settings=Settings(time_step=1e-4), **WEIGHTLESS)
    upper = garment.panel_of_particle == 1
    velocity = np.where(upper[:, None], [0.0, 0.0, -1.0], 0.0)
    seen, alone = (Simulation(replace(scene, without=w)) for w in ((), ("self contact",)))
    for simulation in (seen, alone):
        throw(simulation, velocity)
    counts, same = [], []
    while seen.time < 0.1:
        for simulation in (seen, alone):
            simulation.tick()
        counts.append(listed(seen))
        same.append(seen.state_hash() == alone.state_hash())
        assert through_each_other(seen) == 0
    # 60 mm at 1 m/s: there is nothing to do at first, and as long as there is not, there is no bit of a difference.
    first = next(k for k, count in enumerate(counts) if count > 0)
    assert first >= 1
    assert all(same[:first])
    assert not same[-1]
    # It took over: the lower sheet was hit and takes the upper one's momentum. Without it, that one fell through.
    assert seen.positions[~upper, 2].mean() < -0.001
    assert np.abs(alone.positions[~upper, 2]).max() == 0.0
    assert alone.positions[upper, 2].mean() < seen.positions[upper, 2].mean() - 0.005 < -0.01
    # And when they have parted there is nothing to do again.
    throw(seen, np.where(upper[:, None], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]))
    seen.advance(0.05)
    assert listed(seen) == 0


def test_drag_of_a_run_to_rest_comes_and_goes_in_a_scene_without_air():
    garment = sheet(0.2, 0.2, 0.05)
    scene = Scene(garment=garment, fabric=POPLIN, air_drag=0.0, pins=[0, 4])
    simulation = Simulation(scene)
    assert simulation.motion.terms.air_drag == 0.0
    drags = []
    simulation.settle(lambda s: drags.append(s.motion.terms.air_drag))
    assert set(drags) == {scene.settings.settle_drag}
    assert simulation.motion.terms.air_drag == 0.0
    # Motion after it is free of air again: what is let go falls as a stone does.
    free = Simulation(replace(scene, pins=np.zeros(0, dtype=np.int32)))
    free.settle()
    before, velocity = free.positions, free.motion.v.copy()
    free.advance(0.05)
    fallen = (before - free.positions)[:, 2] + 0.05 * velocity[:, 2]
    np.testing.assert_allclose(fallen.mean(), 9.80665 * 0.05**2 / 2, rtol=0.02)


def test_garment_that_is_sewn_has_no_pull_left_and_no_doubled_particles():
    panels = {"left": rectangle(0.2, 0.2, at=(-0.11, 0, 0)), "right": rectangle(0.2, 0.2, at=(0.11, 0, 0))}
    scene = Scene.build(pattern(panels, [(("left", 1), ("right", 3))]), settings=Settings(spacing=0.05))
    simulation = Simulation(scene)
    open_count = simulation.model.particle_count
    assert len(simulation.motion.terms.seam.pairs) > 0
    while simulation.phase == "sewing":
        simulation.tick()
    assert simulation.model.seam_pull is None
    assert len(simulation.motion.terms.seam.pairs) == 0
    assert simulation.model.particle_count == open_count - len(scene.garment.seams[0].first)
    # To the bit what a sheet of one piece does that has these particles: the seam is not there any more.
    assert not simulation.model.sewing
    assert simulation.model.terms[[t.name for t in simulation.model.terms].index("sewing smoothness")].active is False
    simulation.reset()
    assert len(simulation.motion.terms.seam.pairs) > 0


BALL = body_of(trimesh.creation.icosphere(2, radius=0.1))


def with_a_far_part(distance: float) -> Body:
    """The ball, and another one far below it."""
    lower = trimesh.creation.icosphere(2, radius=0.1).apply_translation([0.0, 0.0, -distance])
    both = trimesh.util.concatenate([trimesh.creation.icosphere(2, radius=0.1), lower])
    return Body.from_arrays(both.vertices, both.faces, "test body")


def test_body_out_of_reach_lists_no_pair_and_changes_no_bit():
    # The same ball with and without another one that is far away.
    runs = []
    for body in (BALL, with_a_far_part(3.0)):
        scene = Scene(garment=sheet(0.25, 0.25, 0.05, z=0.105), body=body, fabric=POPLIN)
        simulation = Simulation(scene)
        far = body.vertices[body.triangles].mean(axis=1)[:, 2] < -1.0
        for _ in range(60):
            simulation.tick()
            assert not far[simulation.motion.contacts.planes.body_triangle].any()
        runs.append(simulation)
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)
    assert len(runs[0].motion.contacts.planes.body_triangle) > 0


def test_body_that_was_out_of_reach_is_met_when_cloth_comes_there():
    body = with_a_far_part(0.6)
    far = body.vertices[body.triangles].mean(axis=1)[:, 2] < -0.3
    start = placed(sheet(0.2, 0.2, 0.05), move=[0.0, 0.0, -0.2])  # below the upper ball, above the lower one
    simulation = Simulation(Scene(garment=start, body=body, fabric=POPLIN))
    assert len(simulation.motion.contacts.planes.body_triangle) == 0
    assert simulation.settle().settled
    assert far[simulation.motion.contacts.planes.body_triangle].all()
    assert len(simulation.motion.contacts.planes.body_triangle) > 0
    x = simulation.positions
    assert crossings(x, simulation.triangles, body) == 0
    assert -0.52 < x[:, 2].max() < -0.45


def test_body_that_was_out_of_reach_is_met_when_it_comes_to_the_cloth():
    far = body_of(trimesh.creation.icosphere(2, radius=0.1), move=[1.0, 0.0, 0.0])
    simulation = Simulation(Scene(garment=placed(sheet(0.2, 0.2, 0.05)), body=far, fabric=POPLIN, **WEIGHTLESS))
    simulation.advance(0.05)
    assert len(simulation.motion.contacts.planes.body_triangle) == listed(simulation) == 0
    simulation.move_body(far.vertices - [0.95, 0.0, 0.0], 0.5)
    touched = 0
    for _ in range(60):
        simulation.advance(0.01)
        touched += listed(simulation) + len(simulation.motion.contacts.planes.body_triangle)
        assert crossings(simulation.positions, simulation.triangles, simulation.scene.body) == 0
    assert touched > 0
    assert simulation.positions[:, 0].mean() < -0.05  # it was pushed along
