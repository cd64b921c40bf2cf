"""Nothing that is not finite leaves a run, on whatever path: the last good state stays, and a reset starts afresh."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, rectangle, sheet, sides_through

import cloth_core.motion
from cloth_core.errors import SceneError, SimulationError
from cloth_core.fabric import Fabric
from cloth_core.grasp import Pose
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

POPLIN = Fabric.preset("cotton_poplin")
BALL = body_of(trimesh.creation.icosphere(2, radius=0.1))


class Broken:
    """A compiled loop that writes a value that is not finite from one call on, for some calls."""

    def __init__(self, monkeypatch, name: str, first: int, calls: int = 10**9) -> None:
        self.run, self.first, self.end = getattr(cloth_core.motion, name), first, first + calls
        self.count = 0
        monkeypatch.setattr(cloth_core.motion, name, self)

    def __call__(self, x, v, *rest):
        done = self.run(x, v, *rest)
        if self.first <= self.count < self.end:
            x[self.count % len(x)] = math.nan
            v[:] = math.inf
        self.count += 1
        return done


def hung(**settings) -> Simulation:
    return Simulation(Scene(garment=sheet(0.2, 0.2, 0.05), fabric=POPLIN, pins=[0], settings=Settings(**settings)))


def sewn() -> Simulation:
    panels = {"left": rectangle(0.2, 0.2, at=(-0.11, 0, 0)), "right": rectangle(0.2, 0.2, at=(0.11, 0, 0))}
    return Simulation(Scene.build(pattern(panels, [(("left", 1), ("right", 3))]), settings=Settings(spacing=0.05)))


def on_a_ball() -> Simulation:
    return Simulation(Scene(garment=sheet(0.25, 0.25, 0.05, z=0.105), body=BALL, fabric=POPLIN))


def on_a_ball_that_rises() -> Simulation:
    simulation = on_a_ball()
    simulation.advance(0.1)
    simulation.move_body(BALL.vertices + np.array([0.0, 0.0, 0.1]), 0.1)
    return simulation


def in_a_gripper() -> Simulation:
    simulation = hung()
    corner = simulation.positions[24]
    simulation.grasp("hand", np.array([24]), Pose.of(corner))
    simulation.move_grasp("hand", Pose.of(corner + np.array([0.0, 0.0, 0.1])))
    return simulation


def at_rest() -> Simulation:
    simulation = on_a_ball()
    assert simulation.settle().settled
    return simulation


def implicit() -> Simulation:
    return hung(integrator="implicit")


# How the run is begun, the compiled loop that it uses, and how it is driven.
PATHS = {
    "motion": (hung, "run_steps", lambda s, look: s.advance(2.0, look)),
    "to rest": (hung, "run_steps", lambda s, look: s.settle(look)),
    "implicit": (implicit, "implicit_steps", lambda s, look: s.advance(2.0, look)),
    "implicit, to rest": (implicit, "implicit_steps", lambda s, look: s.settle(look)),
    "sewing": (sewn, "run_steps", lambda s, look: s.advance(2.0, look)),
    "sewing, to rest": (sewn, "run_steps", lambda s, look: s.settle(look)),
    "contact": (on_a_ball, "run_steps", lambda s, look: s.advance(2.0, look)),
    "contact, to rest": (on_a_ball, "run_steps", lambda s, look: s.settle(look)),
    "moving body": (on_a_ball_that_rises, "run_steps", lambda s, look: s.advance(2.0, look)),
    "gripper": (in_a_gripper, "run_steps", lambda s, look: s.advance(2.0, look)),
    "after rest": (at_rest, "run_steps", lambda s, look: s.advance(2.0, look)),
}


@pytest.mark.parametrize("path", PATHS)
def test_the_last_good_state_stays_whatever_was_under_way(path, monkeypatch):
    begin, loop, drive = PATHS[path]
    simulation = begin()
    fresh = Simulation(simulation._scene_at_start).state_hash()
    seen = []

    def look(s: Simulation) -> None:
        assert np.isfinite(s.positions).all()
        seen.append((s.time, s.steps, s.positions, s.scene.body))

    look(simulation)
    with monkeypatch.context() as patch:
        Broken(patch, loop, first=4)
        with pytest.raises(
            SimulationError, match=r"^particle \d+ of panel '\w+': left all bounds at .*; use a smaller"
        ):
            drive(simulation, look)
    # Where it is, and when, is what was seen after the last good tick; with a body that moves, or a little later, what
    # the cloth around it was like.
    time, steps, positions, body = seen[-1]
    assert simulation.phase == "failed"
    assert np.isfinite(simulation.motion.v).all()
    if path == "moving body":
        assert simulation.time >= time
        assert simulation.scene.body is not BALL
        x, triangles = simulation.sewn_mesh()
        solid = simulation.scene.body
        assert sides_through(x, triangles, solid.vertices, solid.triangles) == 0
    else:
        assert (simulation.time, simulation.steps) == (time, steps)
        np.testing.assert_array_equal(simulation.positions, positions)
        assert simulation.scene.body is body
    # All that tells of it is finite, too.
    report = simulation.report()
    assert not report.settled
    assert math.isfinite(report.max_strain)
    assert math.isfinite(report.simulated_time)
    assert np.isfinite(simulation.sewn_mesh()[0]).all()
    assert simulation.progress.phase == simulation.describe()["phase"] == "failed"
    # It does not go on as if nothing had been, and starts afresh when it is told to.
    for go_on in (simulation.tick, lambda: simulation.advance(0.1), simulation.settle):
        with pytest.raises(SimulationError, match="the run has failed and cannot go on, reset it: particle"):
            go_on()
    simulation.reset()
    assert simulation.state_hash() == fresh
    other = Simulation(simulation._scene_at_start)
    for run in (simulation, other):
        run.advance(0.05)
    assert simulation.state_hash() == other.state_hash()


def test_coarse_start_that_fails_is_done_without(monkeypatch):
    # A garment on a body drapes a coarser mesh first; that one breaks, and the fine one starts from the beginning.
    strip = {
        "front": rectangle(0.3, 0.1, at=(0, 0.05, 0.12)),
        "back": rectangle(0.3, 0.1, at=(0, 0.05, -0.12), turned=(0, 180, 0)),
    }
    tube = pattern(strip, [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))])
    post = body_of(trimesh.creation.cylinder(0.1, 0.6, sections=24))
    scene = Scene.build(tube, post, Fabric.preset("wool"), settings=Settings(spacing=0.02, max_time=2.0))
    simulation = Simulation(scene)
    phases = []

    def look(s: Simulation) -> None:
        assert np.isfinite(s.positions).all()
        phases.append((s.phase, s.drapes_coarsely))

    broken = Broken(monkeypatch, "run_steps", first=3, calls=1)
    report = simulation.settle(look)
    assert broken.count > 4
    assert phases[0] == ("sewing", True)
    assert phases[-1][1] is False
    assert report.rest_reason
    assert simulation.phase in ("rest", "draping")
    assert np.isfinite(simulation.positions).all()


# ---- what is not finite does not get in


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300])
@pytest.mark.parametrize("what", ["start", "rest"])
def test_particle_whose_place_is_no_number_is_refused_with_its_name(what, value):
    garment = sheet(0.2, 0.2, 0.05)
    places = getattr(garment, what).copy()
    places[7, 1] = value
    with pytest.raises(SceneError, match=rf"^panel 'sheet', particle 7: its {what} position .*; mend the pattern"):
        Scene(garment=replace(garment, **{what: places}), fabric=POPLIN)


@pytest.mark.parametrize("particle", [-1, 25, 10**6])
def test_particle_that_does_not_exist_cannot_be_held(particle):
    simulation = hung()
    before = simulation.state_hash()
    with pytest.raises(SimulationError, match=rf"^hand: particle {particle} does not exist, there are 25"):
        simulation.grasp("hand", np.array([3, particle]), Pose.of([0.0, 0.0, 0.0]))
    assert not simulation.grasps
    assert simulation.state_hash() == before
