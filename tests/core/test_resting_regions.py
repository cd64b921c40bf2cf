"""Regions that lie still are not stepped while the rest moves, and are stepped again before that could be seen."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, pattern, rectangle, sheet

from cloth_core.contact_state import ContactState
from cloth_core.fabric import Fabric
from cloth_core.grasp import Pose
from cloth_core.model import Model
from cloth_core.quality import Settings
from cloth_core.resting_regions import RestingRegions, awake_terms
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.step import Workspace, total_force

POPLIN = Fabric.preset("cotton_poplin")
TABLE = body_of(trimesh.creation.box(extents=[1.0, 1.0, 0.1]), move=[0.0, 0.0, -0.05])


def towel(**changes) -> Scene:
    return Scene(garment=sheet(0.5, 0.5, 0.025, z=0.004), body=TABLE, fabric=POPLIN, **changes)


def all_awake(monkeypatch) -> None:
    monkeypatch.setattr("cloth_core.resting_regions._STILL", -1.0)
    monkeypatch.setattr("cloth_core.rest_search._NOTHING", -1.0)


def take_the_corner(simulation: Simulation):
    """Holds the corner at +x, +y; returns where it is."""
    x = simulation.positions
    corner = x[np.argmax(x[:, 0] + x[:, 1])]
    held = np.flatnonzero(np.linalg.norm(x - corner, axis=1) < 0.04)
    simulation.grasp("hand", held, Pose.of(corner))
    return corner


def carry(simulation: Simulation, start, way, duration, on_step=lambda: None) -> None:
    """Moves the hand smoothly by a way [m], within its speed limit."""
    steps = round(duration / 0.01)
    for k in range(steps):
        share = (k + 1) / steps
        simulation.move_grasp("hand", Pose.of(start + share**2 * (3 - 2 * share) * np.asarray(way)))
        simulation.advance(0.01)
        on_step()


def rested(scene: Scene) -> Simulation:
    simulation = Simulation(scene)
    assert simulation.settle().settled
    simulation.advance(0.5)
    return simulation


def corner_lifted() -> tuple[Simulation, list[np.ndarray], list[float]]:
    """A towel whose corner is lifted and then held; positions and the share asleep, every 0.1 s."""
    simulation = rested(towel())
    start = take_the_corner(simulation)
    seen, asleep = [], []
    for _ in range(12):
        if len(seen) == 0:
            carry(simulation, start, [-0.1, -0.1, 0.12], 1.0)
        simulation.advance(0.1)
        seen.append(simulation.positions)
        asleep.append(float(simulation.motion.asleep.mean()))
    return simulation, seen, asleep


def test_what_lies_on_the_table_sleeps_while_a_corner_is_held_up(monkeypatch):
    simulation, seen, asleep = corner_lifted()
    assert asleep[-1] > 0.5
    sleeping = simulation.motion.asleep
    assert simulation.motion.x[sleeping, 2].max() < 0.01
    assert not sleeping[simulation.motion.x[:, 2] > 0.05].any()
    report = simulation.report()
    assert report.particles_asleep == sleeping.sum() == simulation.describe()["particles_asleep"]
    assert (simulation.motion.v[sleeping] == 0.0).all()
    # As if everything had been stepped, to a tenth of a millimetre.
    all_awake(monkeypatch)
    stepped, reference, none = corner_lifted()
    assert none == [0.0] * len(none)
    assert stepped.report().particles_asleep == 0
    ways = np.linalg.norm(np.array(seen) - np.array(reference), axis=2)
    assert np.sqrt((ways**2).mean()) < 1e-4
    assert ways[-1].max() < 1e-3


def test_what_sleeps_follows_when_the_corner_pulls_the_towel_away(monkeypatch):
    ends, asleep = [], []
    for awake in (False, True):
        with monkeypatch.context() as patch:
            if awake:
                all_awake(patch)
            simulation = rested(towel())
            asleep.append(simulation.motion.asleep.mean())
            assert (simulation.motion.v[simulation.motion.asleep] == 0.0).all()
            start = take_the_corner(simulation)
            before = simulation.positions
            carry(simulation, start, [0.1, 0.1, 0.0], 1.0)
            simulation.advance(0.3)
            ends.append(simulation.positions)
    assert asleep == [1.0, 0.0]
    assert (np.linalg.norm(ends[0] - before, axis=1) > 0.08).all()  # all of it has slid
    assert np.linalg.norm(ends[0] - ends[1], axis=1).max() < 1e-3


def test_what_is_let_go_wakes_and_falls_onto_what_sleeps():
    simulation, _, asleep = corner_lifted()
    assert asleep[-1] > 0.5
    height = simulation.positions[:, 2].max()
    simulation.release("hand")
    simulation.advance(1.0)
    assert simulation.positions[:, 2].max() < 0.3 * height
    x, triangles = simulation.sewn_mesh()
    assert crossings(x, triangles, TABLE) == 0
    assert simulation.report().self_intersections == 0
    # In the end all of it lies still again.
    simulation.advance(3.0)
    assert simulation.motion.asleep.all()


def test_a_body_that_moves_wakes_everything():
    simulation = rested(towel())
    assert simulation.motion.asleep.all()
    before = simulation.positions
    simulation.move_body(TABLE.vertices + np.array([0.0, 0.0, 0.02]), 0.2)
    assert not simulation.motion.asleep.any()
    simulation.advance(0.5)
    np.testing.assert_allclose(simulation.positions - before, [[0.0, 0.0, 0.02]] * len(before), atol=1e-4)


def test_motion_without_a_run_to_rest_is_stepped_as_a_whole(monkeypatch):
    hashes = []
    for awake in (False, True):
        with monkeypatch.context() as patch:
            if awake:
                all_awake(patch)
            simulation = Simulation(towel())
            simulation.advance(1.0)
            assert not simulation.motion.asleep.any()
            hashes.append(simulation.state_hash())
    assert hashes[0] == hashes[1]


def test_run_to_rest_steps_everything():
    simulation = rested(towel())
    assert simulation.motion.asleep.all()
    simulation.settle(lambda s: bool(s.motion.asleep.any()))
    assert not simulation.motion.asleep.any()
    assert simulation.settled


def sewn_tube() -> Scene:
    panels = {"left": rectangle(0.3, 0.2, at=(0, 0, 0.05)), "right": rectangle(0.3, 0.2, at=(0, 0, -0.05))}
    return Scene.build(pattern(panels, [(("left", 2), ("right", 2))]), None, POPLIN, settings=Settings(spacing=0.01))


@pytest.mark.parametrize("scene", [towel, sewn_tube])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.98, 1.0])
@pytest.mark.parametrize("patches", [False, True])
def test_forces_on_what_is_awake_are_all_there(scene, share, patches):
    scene = scene()
    model = Model(scene, closed=scene.garment.seams)
    rng = np.random.default_rng(1)
    x = model.gather(scene.garment.start, scene.garment.particle_areas)
    x += 1e-3 * rng.standard_normal(x.shape)
    v = rng.standard_normal(x.shape)
    if patches:  # regions beside each other
        height = x @ rng.standard_normal(3)
        asleep = height <= np.quantile(height, share) if share > 0.0 else np.zeros(len(x), dtype=bool)
    else:  # here and there
        asleep = rng.random(len(x)) < share
    full, part = model.force_terms(1.0), awake_terms(model.force_terms(1.0), asleep)
    forces = []
    for terms in (full, part):
        work = Workspace.of(len(x))
        total_force(x, v, terms, 0.0, work)
        forces.append(work.force[:, : len(x)].T.copy())
    scale = np.abs(forces[0]).max()
    np.testing.assert_allclose(forces[1][~asleep], forces[0][~asleep], rtol=0, atol=1e-12 * scale)
    assert (part.inverse_mass[asleep] == 0.0).all()
    np.testing.assert_array_equal(part.inverse_mass[~asleep], model.inverse_mass[~asleep])

    def elements(terms) -> int:
        runs = (terms.springs, terms.trellis, terms.lines, terms.twists)
        return sum(int(r.length.sum()) + len(r.rest) for r in runs) + len(terms.hinges)

    if share == 0.0:
        assert elements(part) == elements(full)
    if share == 1.0:
        assert elements(part) == 0
    if patches and share == 0.5:
        assert elements(part) < 0.7 * elements(full)


def test_neighbours_that_creep_wake_what_sleeps():
    """However slowly: what counts is where they lay when it fell asleep."""
    scene = towel()
    model = Model(scene)
    x = scene.garment.start.copy()
    regions = RestingRegions(model, 0.0, x, slowest=2.0, drag=0.0)
    nothing = ContactState.none()
    left = x[:, 0] < -0.1
    beside = ~left & (x[:, 0] < 0.0)
    time, wakes = 0.0, []
    for k in range(60):
        time += 0.051
        x[left, 2] += 1e-4 * (-1) ** k
        x[beside, 0] += 0.04e-6  # less than a tenth of what counts as still
        regions.look(time, x, nothing)
        wakes.append(int(regions.asleep.sum()))
    assert max(wakes) > 0.4 * len(x)
    # About every 25 windows it has gone a micrometre, and the ring around wakes.
    slept = wakes.index(max(wakes))
    assert min(wakes[slept:]) < 0.9 * max(wakes)
    assert not regions.asleep[left].any()


def windows(regions: RestingRegions, time: float, x, contacts, count: int) -> float:
    """Lets so many windows pass in which nothing moves; the time then [s]."""
    for _ in range(count):
        time += 0.051
        regions.look(time, x, contacts)
    return time


def test_what_is_let_go_shortly_before_a_window_ends_stays_awake():
    """Until then it has hardly begun to fall, which looks as if it lay still."""
    scene = towel()
    model = Model(scene)
    x = scene.garment.start.copy()
    held = x[:, 0] > 0.2
    model.inverse_mass[held] = 0.0
    nothing = ContactState.none()
    regions = RestingRegions(model, 0.0, x, slowest=2.0, drag=0.0)
    time = windows(regions, 0.0, x, nothing, 5)
    np.testing.assert_array_equal(regions.asleep, ~held)
    model.inverse_mass[held] = 1.0 / model.mass[held]
    regions.look(time + 0.0499, x, nothing)
    x[held, 2] -= 1e-8
    regions.look(time + 0.0501, x, nothing)
    assert not regions.asleep[x[:, 0] > 0.1].any()  # with the neighbours around
    windows(regions, time + 0.0501, x, nothing, 5)
    assert regions.asleep.all()


def sheet_and_patch(**changes) -> Scene:
    """A sheet and, 5 cm beside it, a patch half as wide."""
    panels = {"sheet": rectangle(0.3, 0.3, at=(0, 0, 0)), "patch": rectangle(0.15, 0.15, at=(0, 0, 0.05))}
    return Scene.build(pattern(panels, []), None, POPLIN, settings=Settings(spacing=0.03), **changes)


def test_what_creeps_along_sleeping_cloth_that_it_touches_wakes_it():
    scene = sheet_and_patch()
    model = Model(scene)
    x = scene.garment.start.copy()
    patch = scene.garment.panel_of_particle == 1
    x[patch, 1] += 0.0485  # 1.5 mm apart
    model.inverse_mass[patch] = 0.0
    assert model.contact is not None
    contacts = model.contact.search(x, 0.002)
    assert contacts.pairs.listed_count[0] > 0
    regions = RestingRegions(model, 0.0, x, slowest=2.0, drag=0.0)
    time = windows(regions, 0.0, x, contacts, 5)
    np.testing.assert_array_equal(regions.asleep, ~patch)
    woken = 0
    for _ in range(60):
        x[patch, 1] += 0.04e-6  # less than a tenth of what counts as still
        time = windows(regions, time, x, contacts, 1)
        woken += not regions.asleep.any()
    assert 2 <= woken <= 20


def test_sleeping_cloth_that_other_cloth_runs_into_gives_way_at_once(monkeypatch):
    ends, slept = [], []
    for awake in (False, True):
        with monkeypatch.context() as patch:
            if awake:
                all_awake(patch)
            simulation = Simulation(sheet_and_patch(air_drag=4.0))
            x, on_sheet = simulation.positions, simulation.scene.garment.panel_of_particle == 0
            simulation.grasp("rail", np.flatnonzero(on_sheet & (x[:, 2] > 0.14)), Pose.of(np.zeros(3)))
            simulation.grasp("hand", np.flatnonzero(~on_sheet), Pose.of(np.zeros(3)))
            assert simulation.settle().settled
            simulation.advance(4.23)
            slept.append(bool(simulation.motion.asleep[simulation.model.number[on_sheet]].mean() > 0.9))
            before = simulation.positions
            simulation.move_grasp("hand", Pose.of([0.0, 0.25, 0.0]))
            simulation.advance(0.09)
            ends.append(simulation.positions)
    assert slept == [True, False]
    assert np.linalg.norm(ends[1] - before, axis=1)[on_sheet].max() > 0.01  # it has been hit
    assert np.linalg.norm(ends[0] - ends[1], axis=1).max() < 1e-3
