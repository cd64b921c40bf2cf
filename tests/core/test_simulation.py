"""Runs: exact times, sub-steps, rest, stopping, recovery, reproducible to the bit, and what a report says."""

import json
import math
import os
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from apparatus import bending_force, body_of, pattern, placed, plain_fabric, rectangle, sheet, sides_through, throw
from naive_geometry import is_edge_intersecting_triangle

import cloth_core.motion
from cloth_core.body import Body
from cloth_core.errors import SimulationError
from cloth_core.fabric import Fabric
from cloth_core.mesh_topology import unique_edges
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

REPORT_KEYS = (
    "particles triangles springs terms time_step stable_time_step steps simulated_time wall_time settled rest_reason "
    "max_strain mean_strain max_seam_gap body_intersections self_intersections max_penetration state_sha256"
).split()


def hung(spacing: float = 0.05, **settings) -> Scene:
    """A sheet of poplin that is held at its two upper corners."""
    garment = sheet(0.3, 0.2, spacing)
    corners = np.flatnonzero((np.abs(garment.rest[:, 0]) > 0.149) & (garment.rest[:, 1] > 0.099)).astype(np.int32)
    return Scene(garment=garment, fabric=Fabric.preset("cotton_poplin"), pins=corners, settings=Settings(**settings))


def on_a_ball() -> Scene:
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    return Scene(garment=sheet(0.25, 0.25, 0.05, z=0.11), body=ball, fabric=Fabric.preset("wool"))


# ---- time


@pytest.mark.parametrize("duration", [0.0, 1e-7, 1e-4, 1 / 30, 0.1234567])
def test_advance_ends_at_exactly_the_time_asked_for(duration):
    simulation = Simulation(hung())
    simulation.advance(duration)
    assert simulation.time == pytest.approx(duration, abs=1e-12)
    assert (simulation.steps > 0) == (duration > 0)


def test_many_short_advances_add_up():
    simulation = Simulation(hung())
    for _ in range(60):
        simulation.advance(1 / 60)
    assert simulation.time == pytest.approx(1.0, abs=1e-9)


def test_time_advances_by_whole_steps_of_at_most_the_stable_one():
    simulation = Simulation(hung())
    before, steps = simulation.time, simulation.steps
    for _ in range(20):
        simulation.tick()
        assert simulation.time - before <= (simulation.steps - steps) * simulation.stable.time_step
        before, steps = simulation.time, simulation.steps


@pytest.mark.parametrize("duration", [-1.0, math.nan, math.inf])
def test_impossible_duration_is_refused(duration):
    simulation = Simulation(hung())
    with pytest.raises(SimulationError, match=r"advance: .* is not a duration"):
        simulation.advance(duration)
    assert simulation.time == 0.0


@pytest.mark.parametrize("wanted", [1.0, 0.01, 5e-4])
def test_time_step_longer_than_the_stable_one_is_cut_and_the_user_told(wanted):
    simulation = Simulation(hung(time_step=wanted))
    stable = simulation.stable.time_step
    assert simulation.time_step <= 0.9 * stable
    assert wanted / simulation.time_step == pytest.approx(round(wanted / simulation.time_step), rel=1e-9)
    simulation.advance(0.2)
    warnings = [w for w in simulation.report().warnings if w.startswith("time step")]
    assert len(warnings) == 1
    assert warnings[0].startswith(f"time step {wanted:g} s: longer than the stable ")
    assert warnings[0].endswith("cut into sub-steps")
    # And the result is that of a run with a step of its own choice, but for the error of the method.
    own = Simulation(hung())
    own.advance(0.2)
    assert np.abs(own.positions - simulation.positions).max() < 0.005


def test_stable_time_step_that_is_asked_for_is_used_without_a_word():
    simulation = Simulation(hung(time_step=1e-5))
    assert simulation.time_step == 1e-5
    assert simulation.report().warnings == ()


def test_tiny_time_step_is_right_and_not_taken_for_rest():
    scene = replace(hung(time_step=1e-8, rest_window=1e-5), pins=np.zeros(0, dtype=np.int32), air_drag=0.0)
    simulation = Simulation(scene)
    for _ in range(50):
        simulation.tick()
    n = 50 * 32
    assert simulation.steps == n
    assert simulation.time == pytest.approx(n * 1e-8, rel=1e-9)
    np.testing.assert_allclose(simulation.motion.v[:, 2], -9.80665 * n * 1e-8, rtol=1e-6)


def test_result_hardly_depends_on_the_time_step():
    ends = []
    for share in (1, 2, 4):
        simulation = Simulation(hung(safety=0.9 / share))
        simulation.advance(0.2)
        ends.append(simulation.positions)
    assert np.abs(ends[1] - ends[2]).max() < np.abs(ends[0] - ends[2]).max() < 0.002


# ---- physics of a whole sheet


def energy(simulation: Simulation) -> float:
    """Kinetic, elastic and bending energy [J]; the bending forces are linear in the positions."""
    model, x, v = simulation.model, simulation.motion.x, simulation.motion.v
    length = np.linalg.norm(x[model.springs.pairs[:, 1]] - x[model.springs.pairs[:, 0]], axis=1)
    stretch = (model.springs.stiffness * (length - model.springs.rest_length) ** 2).sum() / 2
    force = bending_force(model.bending, x)
    return float((model.mass[:, None] * v**2).sum() / 2 + stretch - (x * force).sum() / 2)


def test_free_undamped_sheet_keeps_energy_momentum_and_angular_momentum():
    garment = sheet(0.3, 0.2, 0.04)
    scene = Scene(
        garment=garment, fabric=plain_fabric(bending=1e-4), gravity=(0.0, 0.0, 0.0), air_drag=0.0,
        settings=Settings(safety=0.3),
    )  # fmt: skip
    simulation = Simulation(scene)
    rng = np.random.default_rng(5)
    throw(
        simulation,
        rng.standard_normal(garment.start.shape) * 0.2 + np.cross([1.0, 2.0, 5.0], garment.start) + [1, 0, 2],
    )
    mass = simulation.model.mass[:, None]

    def totals():
        x, v = simulation.motion.x, simulation.motion.v
        return energy(simulation), (mass * v).sum(axis=0), np.cross(x, mass * v).sum(axis=0)

    first = totals()
    for _ in range(10):
        simulation.advance(0.1)
        now = totals()
        assert now[0] == pytest.approx(first[0], rel=0.01)
        np.testing.assert_allclose(now[1], first[1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(now[2], first[2], rtol=1e-3, atol=1e-8)


def test_pins_stay_where_they_start():
    scene = hung()
    simulation = Simulation(scene)
    simulation.advance(0.5)
    np.testing.assert_allclose(simulation.positions[scene.pins], scene.garment.start[scene.pins], rtol=0, atol=1e-15)
    assert np.ptp(simulation.positions[:, 2]) > 0.05


# ---- rest


def test_settles_when_nothing_moves_and_says_by_which_criterion():
    scene = hung()
    simulation = Simulation(scene)
    report = simulation.settle()
    assert report.settled
    assert simulation.settled
    assert simulation.phase == "rest"
    assert report.rest_reason == "no particle moved by more than 0.5 mm in 0.1 s"
    before = simulation.positions
    simulation.advance(scene.settings.rest_window)
    assert np.abs(simulation.positions - before).max() <= 2 * scene.settings.rest_displacement


def test_resting_shape_does_not_depend_on_the_drag_that_found_it():
    shapes = []
    for drag in (3.0, 12.0):
        simulation = Simulation(replace(hung(settle_drag=drag, rest_displacement=1e-4), air_drag=0.5))
        assert simulation.settle().settled
        shapes.append(np.sort(simulation.positions[:, 2]))
    np.testing.assert_allclose(shapes[0], shapes[1], atol=0.004)


def test_nothing_that_supports_ends_the_run_with_the_reason():
    simulation = Simulation(replace(hung(), pins=np.zeros(0, dtype=np.int32)))
    report = simulation.settle()
    assert not report.settled
    assert report.rest_reason == "nothing supports the garment: there is neither a body nor a pin"
    assert report.simulated_time < 1.0


def test_garment_that_misses_the_body_ends_the_run_with_the_reason():
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    beside = placed(sheet(0.2, 0.2, 0.05), move=[0.5, 0.0, -0.08])
    simulation = Simulation(Scene(garment=beside, body=ball, fabric=Fabric.preset("wool")))
    report = simulation.settle()
    assert not report.settled
    assert report.rest_reason == "not supported by the body: it has fallen past it"
    assert report.simulated_time < 2.0


def test_longest_time_ends_the_run_with_the_reason():
    report = Simulation(hung(max_time=0.2)).settle()
    assert not report.settled
    assert report.rest_reason.startswith("not at rest after 0.2")
    assert 0.2 <= report.simulated_time < 0.25


@pytest.mark.parametrize("how", ["settle", "advance"])
def test_on_tick_is_called_and_can_stop(how):
    simulation = Simulation(hung())
    seen = []

    def on_tick(running):
        seen.append((running.time, running.progress.simulated_time))
        return len(seen) == 5

    if how == "settle":
        report = simulation.settle(on_tick)
        assert not report.settled
        assert report.rest_reason == "stopped before it came to rest"
    else:
        simulation.advance(10.0, on_tick)
        assert simulation.time < 10.0
    assert len(seen) == 5
    assert [t for t, _ in seen] == sorted({t for t, _ in seen})
    assert all(a == b for a, b in seen)


def test_on_tick_that_returns_nothing_does_not_stop():
    simulation = Simulation(hung())
    calls = []
    simulation.advance(0.05, lambda s: calls.append(s.steps))
    assert simulation.time == pytest.approx(0.05)
    assert len(calls) > 1


def test_progress_names_phase_speed_and_expected_rest():
    simulation = Simulation(hung())
    assert simulation.progress.phase == "draping"
    assert simulation.progress.estimated_rest_time is None
    estimates = []
    simulation.settle(lambda s: estimates.append(s.progress.estimated_rest_time))
    assert any(e is not None for e in estimates)
    assert all(e is None or e >= 0 for e in estimates)
    progress = simulation.progress
    assert progress.phase == "rest"
    assert progress.simulated_time == simulation.time
    assert progress.largest_speed == pytest.approx(np.linalg.norm(simulation.motion.v, axis=1).max())
    assert progress.speed > 0
    assert progress.estimated_rest_time == simulation.time


# ---- recovery


class Broken:
    """The compiled loop, which after some calls leaves a value that is not finite with one particle."""

    def __init__(self, particle: int, value: float, of: str, after: int) -> None:
        self.particle, self.value, self.of, self.left = particle, value, of, after
        self.run = cloth_core.motion.run_steps

    def __call__(self, x, v, *rest):
        done = self.run(x, v, *rest)
        self.left -= 1
        if self.left < 0:
            (x if self.of == "x" else v)[self.particle, 1] = self.value
        return done


@pytest.mark.parametrize("scene", [hung, on_a_ball], ids=["hung", "on a ball"])
@pytest.mark.parametrize(("value", "of"), [(math.nan, "x"), (math.inf, "v"), (math.nan, "v"), (1e9, "v")])
def test_state_that_is_not_finite_never_leaves_and_the_last_good_one_is_kept(monkeypatch, scene, value, of):
    simulation = Simulation(scene())
    monkeypatch.setattr(cloth_core.motion, "run_steps", Broken(7, value, of, after=3))
    good = None
    with pytest.raises(SimulationError) as caught:  # noqa: PT012
        for _ in range(50):
            good = simulation.positions
            simulation.tick()
    text = str(caught.value)
    assert text.startswith("particle 7 of panel 'sheet': left all bounds at ")
    assert f"{simulation.time_step:.3g} s" in text
    assert "use a smaller time step" in text
    assert "\n" not in text
    assert simulation.phase == "failed"
    np.testing.assert_array_equal(simulation.positions, good)
    report = simulation.report()
    assert not report.settled
    json.loads(report.to_json())
    # After a reset it runs again.
    monkeypatch.undo()
    simulation.reset()
    simulation.advance(0.01)
    assert simulation.phase == "draping"


def test_particle_is_named_by_its_panel_also_when_seams_are_merged(monkeypatch):
    panels = {"left": rectangle(0.2, 0.2, at=(-0.11, 0, 0)), "right": rectangle(0.2, 0.2, at=(0.11, 0, 0))}
    scene = Scene.build(pattern(panels, [(("left", 1), ("right", 3))]), settings=Settings(spacing=0.05))
    simulation = Simulation(scene)
    while simulation.phase == "sewing":
        simulation.tick()
    last = simulation.model.particle_count - 1
    monkeypatch.setattr(cloth_core.motion, "run_steps", Broken(last, math.nan, "x", after=0))
    original = scene.garment.particle_count - 1
    with pytest.raises(SimulationError, match=f"particle {original} of panel 'right'"):
        simulation.tick()


# ---- the same again


def test_reset_goes_back_to_the_start():
    simulation = Simulation(on_a_ball())
    fresh = simulation.state_hash()
    simulation.advance(0.1)
    moved = simulation.state_hash()
    assert moved != fresh
    simulation.reset()
    assert simulation.state_hash() == fresh
    assert (simulation.time, simulation.steps, simulation.settled) == (0.0, 0, False)
    simulation.advance(0.1)
    assert simulation.state_hash() == moved


def test_reset_opens_the_seams_again():
    panels = {"left": rectangle(0.2, 0.2, at=(-0.11, 0, 0)), "right": rectangle(0.2, 0.2, at=(0.11, 0, 0))}
    scene = Scene.build(pattern(panels, [(("left", 1), ("right", 3))]), settings=Settings(spacing=0.05))
    simulation = Simulation(scene)
    while simulation.phase == "sewing":
        simulation.tick()
    first = simulation.state_hash()
    simulation.reset()
    assert simulation.phase == "sewing"
    while simulation.phase == "sewing":
        simulation.tick()
    assert simulation.state_hash() == first


def test_reset_forgets_a_run_to_rest_that_was_cut_short():
    # Such a run sews with soft springs: what it leaves must not.
    panels = {"left": rectangle(0.2, 0.2, at=(-0.11, 0, 0)), "right": rectangle(0.2, 0.2, at=(0.11, 0, 0))}
    scene = Scene.build(pattern(panels, [(("left", 1), ("right", 3))]), settings=Settings(spacing=0.05))
    simulation, fresh = Simulation(scene), Simulation(scene)

    def cut(_: Simulation) -> bool:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        simulation.settle(cut)
    simulation.reset()
    for run in (simulation, fresh):
        run.advance(0.1)
    assert simulation.state_hash() == fresh.state_hash()


def test_two_runs_have_the_same_bits():
    one, two = Simulation(on_a_ball()), Simulation(on_a_ball())
    one.settle()
    two.settle()
    assert one.state_hash() == two.state_hash()
    assert one.steps == two.steps


@pytest.mark.parametrize("look", ["report", "describe", "progress", "positions", "sewn_mesh"])
def test_looking_at_a_run_does_not_change_it(look):
    watched, left_alone = Simulation(on_a_ball()), Simulation(on_a_ball())
    for _ in range(60):
        left_alone.tick()
        watched.tick()
        seen = getattr(watched, look)
        if callable(seen):
            seen()
    assert watched.state_hash() == left_alone.state_hash()


IN_A_PROCESS = """
from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.mesh_topology import unique_edges
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
scene = Scene.build(Pattern.load("skirt"), Body.load("young"), Fabric.preset("wool"), settings=Settings(spacing=0.05))
s = Simulation(scene)
s.advance(0.9)
print(s.phase, s.steps, s.state_hash())
"""


def test_same_bits_in_two_processes_with_one_and_two_threads():
    answers = [
        subprocess.run(
            [sys.executable, "-c", IN_A_PROCESS], capture_output=True, text=True, check=True, timeout=300,
            env=os.environ
            | {"NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads},
        ).stdout.split()
        for threads in ("1", "2")
    ]  # fmt: skip
    assert answers[0] == answers[1]
    phase, _, digest = answers[0]
    assert phase == "draping"  # sewn, and on its way
    assert len(digest) == 64
    scene = Scene.build(
        Pattern.load("skirt"), Body.load("young"), Fabric.preset("wool"), settings=Settings(spacing=0.05)
    )
    here = Simulation(scene)
    here.advance(0.9)
    assert here.state_hash() == digest


def test_hash_is_that_of_little_endian_positions_and_velocities():
    import hashlib

    simulation = Simulation(hung())
    simulation.advance(0.05)
    data = np.vstack([simulation.motion.x, simulation.motion.v]).astype("<f8").tobytes()
    assert simulation.state_hash() == hashlib.sha256(data).hexdigest()
    assert simulation.report().state_sha256 == simulation.state_hash()


# ---- what is said about a run


def test_report_has_all_keys_and_is_json():
    simulation = Simulation(on_a_ball())
    simulation.advance(0.1)
    report = simulation.report()
    data = json.loads(report.to_json())
    assert set(REPORT_KEYS) <= set(data)
    assert set(data) == {f.name for f in fields(Report)}
    assert data == report.to_dict()
    assert data["garment"] == "sheet"
    assert data["fabric"] == "wool"
    assert data["particles"] == 36
    assert data["triangles"] == 50
    assert data["springs"] == len(simulation.model.springs)
    assert data["steps"] == simulation.steps > 0
    assert data["simulated_time"] == pytest.approx(0.1)
    assert data["wall_time"] > 0
    assert 0 < data["time_step"] < data["stable_time_step"]
    assert isinstance(data["settled"], bool)
    for key in ("body_intersections", "body_edges_through_cloth", "self_intersections", "contact_searches"):
        assert isinstance(data[key], int)


def test_report_turns_what_is_not_finite_into_null():
    simulation = Simulation(hung())
    odd = replace(simulation.report(), stable_time_step=math.inf, max_strain=math.nan)
    data = json.loads(odd.to_json())
    assert data["stable_time_step"] is None
    assert data["max_strain"] is None


def test_report_counts_crossings_and_depth_of_the_state():
    ball = Body.from_arrays(*(lambda m: (m.vertices, m.faces))(trimesh.creation.icosphere(3, radius=0.1)))
    simulation = Simulation(Scene(garment=sheet(0.3, 0.3, 0.05, z=0.2), body=ball, fabric=Fabric.preset("wool")))
    clear = simulation.report()
    assert (clear.body_intersections, clear.self_intersections, clear.max_penetration) == (0, 0, 0.0)
    assert clear.body_edges_through_cloth == 0
    simulation.motion.x[:] += [0.0007, 0.0009, 0.0011 - 0.2]  # put through the ball, a little beside its own symmetry
    report = simulation.report()
    x, triangles = simulation.motion.x, simulation.model.triangles
    assert report.body_intersections == sides_through(x, triangles, ball.vertices, ball.triangles) > 0
    assert report.body_edges_through_cloth == sides_through(ball.vertices, ball.triangles, x, triangles) > 0
    middle = np.linalg.norm([0.0007, 0.0009, 0.0011])
    assert report.max_penetration == pytest.approx(0.1 - middle, rel=0.02)  # of the particle nearest to the middle
    x[:24] = x[25:] + np.array([0.011, 0.007, 0.02])
    x[::2, 2] -= 0.05
    x += np.random.default_rng(1).uniform(-1e-3, 1e-3, x.shape)  # nothing passes through a corner exactly
    expected = [
        (i, j)
        for i, j in unique_edges(triangles)[0].tolist()
        if is_edge_intersecting_triangle(
            x[i], x[j], *x[triangles[~np.isin(triangles, (i, j)).any(axis=1)]].transpose(1, 0, 2)
        ).any()
    ]
    assert simulation.report().self_intersections == len(expected) > 0


def test_scene_has_only_the_terms_that_it_needs_and_says_why():
    bare = replace(
        hung(), fabric=plain_fabric(shear=0.0, bending=0.0), pins=np.zeros(0, dtype=np.int32), gravity=(0.0, 0.0, 0.0),
        air_drag=0.0,
    )  # fmt: skip
    simulation = Simulation(bare)
    terms = simulation.describe()["terms"]
    for name in (
        "gravity",
        "air drag",
        "shear springs",
        "bending springs",
        "sewing smoothness",
        "bending",
        "spring damping",
        "pins",
        "seams",
        "body contact",
        "friction",
    ):
        assert terms[name]["active"] is False, name
        assert terms[name]["elements"] == 0
        assert terms[name]["reason"]
    assert terms["structural springs"]["active"] is True
    model = simulation.model
    assert model.contact is None or bare.body is None
    assert len(model.bending) == 0
    assert model.seam_pull is None

    full = Scene.build(
        Pattern.load("tshirt"), Body.load("young"), Fabric.preset("cotton_poplin"), settings=Settings(spacing=0.05)
    )
    terms = Simulation(full).describe()["terms"]
    for name in (
        "gravity",
        "air drag",
        "structural springs",
        "shear springs",
        "sewing smoothness",
        "bending",
        "spring damping",
        "seams",
        "body contact",
        "friction",
    ):
        assert terms[name]["active"] is True, name
        assert terms[name]["elements"] > 0
        assert terms[name]["reason"]


def test_description_is_json_and_runs_nothing():
    simulation = Simulation(on_a_ball())
    before = simulation.state_hash()
    data = json.loads(json.dumps(simulation.describe()))
    assert simulation.state_hash() == before
    assert simulation.steps == 0
    assert data["particles"] == 36
    assert data["panels"] == ["sheet"]
    assert data["mass"] == pytest.approx(0.25 * 0.25 * Fabric.preset("wool").area_density)
    assert data["area"] == pytest.approx(0.0625)
    assert data["time_step"] <= data["stable_time_step"]


def test_costs_of_the_terms_are_measured():
    simulation = Simulation(on_a_ball())
    simulation.advance(0.02)
    terms = simulation.report().terms
    for name in ("gravity", "structural springs", "body contact"):
        assert terms[name]["microseconds_per_step"] > 0
    assert terms["pins"]["microseconds_per_step"] == 0.0
