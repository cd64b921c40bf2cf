"""Starts that are crossed, garments that are too small, skirts that hold or fall, garments over each other."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, pattern, rectangle

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_edges, self_crossing_pairs
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


def tube(front: float, width: float, height: float, at: float) -> dict:
    """Two panels in front of and behind the z axis, `front` away from it; the middle at height `at` [m]."""
    return {
        "front": rectangle(width, height, at=(0, at, front)),
        "back": rectangle(width, height, at=(0, at, -front), turned=(0, 180, 0)),
    }


def sewn_numbers(simulation: Simulation) -> np.ndarray:
    """What each particle of the sewn mesh is once everything is sewn: what meets at a seam does not cross."""
    numbers = np.zeros(simulation.model.particle_count, dtype=np.int32)
    numbers[simulation.model.number] = simulation.scene.garment.merged_indices
    return numbers


def own_crossings(simulation: Simulation) -> int:
    return len(self_crossing_edges(*simulation.sewn_mesh(), sewn_numbers(simulation)))


def settled_without_crossing(scene: Scene, every: float = 0.05) -> tuple[Simulation, Report]:
    """Run to rest; nothing crosses on the way, looked at every so many simulated seconds."""
    simulation = Simulation(scene)
    looked = [-1.0]

    def look(s: Simulation) -> None:
        if s.time < looked[0] + every:
            return
        looked[0] = s.time
        assert own_crossings(s) == 0
        assert scene.body is not None
        assert crossings(*s.sewn_mesh(), scene.body) == 0

    report = simulation.settle(look)
    assert report.body_intersections == 0
    return simulation, report


# ---- crossed starts

CROSS = {"one": rectangle(0.3, 0.3, at=(0, 1, 0)), "other": rectangle(0.3, 0.3, at=(0.05, 1, 0), turned=(0, 90, 0))}
PLATE = body_of(trimesh.creation.box(extents=[2, 2, 0.1]), move=[0, 0, 0.7])


@pytest.mark.parametrize("touching", [True, False], ids=["sides upon sides", "nothing upon anything"])
def test_no_crossing_is_added_to_a_crossed_start(touching):
    panels = CROSS if touching else CROSS | {"other": rectangle(0.3, 0.3, at=(0.043, 1.0071, 0), turned=(3, 85, 2))}
    garment = Garment.from_pattern(pattern(panels), 0.03)
    simulation = Simulation(Scene(garment=garment, body=PLATE, fabric=Fabric.preset("cotton_poplin")))

    def crossed() -> set[tuple[int, ...]]:
        x, triangles = simulation.sewn_mesh()
        edges, pairs = self_crossing_pairs(x, triangles)
        return {(*edges[e].tolist(), int(t)) for e, t in pairs.tolist()}

    before = crossed()
    assert len(before) > 30
    while simulation.time < 0.5:
        simulation.tick()
        now = crossed()
        assert now <= before
        before = now
    if not touching:  # what starts at no distance at all is not moved: rounding would decide where it ends up
        assert simulation.positions[:, 2].min() < 0.845  # slowly, as parts that are crossed leave each other no way
    assert simulation.report().self_intersections > 0


def test_crossed_panels_are_separated_before_the_run_and_named():
    scene = Scene.build(pattern(CROSS), PLATE, Fabric.preset("cotton_poplin"), settings=Settings(spacing=0.05))
    assert any("'one'" in w and "'other'" in w and "moved" in w for w in scene.warnings)
    simulation = Simulation(scene)
    while simulation.time < 0.4:
        simulation.tick()
        assert own_crossings(simulation) == 0
    assert simulation.report().self_intersections == 0


def test_panels_that_cannot_be_separated_are_named_in_the_report_and_cross_no_more_than_before():
    wide = {"one": rectangle(5, 5, at=(0, 3, 0)), "other": rectangle(5, 5, at=(0, 3, 0), turned=(0, 90, 0))}
    scene = Scene.build(pattern(wide), settings=Settings(spacing=0.5))
    simulation = Simulation(scene)
    before = own_crossings(simulation)
    assert before > 20
    simulation.advance(0.3)
    report = simulation.report()
    assert 0 < report.self_intersections <= before
    assert any("panel 'one': starts across panel 'other' and cannot be moved clear of it" in w for w in report.warnings)


# ---- size and hold

RADIUS = 0.12
CYLINDER = body_of(trimesh.creation.cylinder(RADIUS, 0.5, sections=48), move=[0, 0, 0.75])


def skirt(around: float, body: Body, friction: float = 0.4, height: float = 0.2, longest: float = 8.0) -> Scene:
    """A tube of that circumference [m] around the body, for at most so many seconds."""
    panels = pattern(tube(0.2, around / 2, height, 0.8), SIDES, name="tube")
    fabric = Fabric.preset("cotton_poplin", friction=friction)
    return Scene.build(panels, body, fabric, settings=Settings(spacing=0.04, max_time=longest))


def test_tight_tube_is_stretched_and_the_report_says_so():
    girth = 2 * np.pi * (RADIUS + Settings().contact_offset)
    around = 0.94 * girth
    simulation, report = settled_without_crossing(skirt(around, CYLINDER, height=0.12))
    assert report.settled
    assert not report.open_seams
    assert report.self_intersections == 0
    assert any("the garment is too tight" in w for w in report.warnings)
    # As much longer as the way around the body is; along one row, by its own polygon.
    assert report.max_strain > 0.04
    assert np.hypot(*simulation.positions[:, :2].T).min() > RADIUS


def test_tube_that_is_far_too_small_reports_its_open_seams():
    around = 0.7 * 2 * np.pi * RADIUS
    _, report = settled_without_crossing(skirt(around, CYLINDER))
    assert len(report.open_seams) == 2
    assert all(gap > 0.05 for gap in report.open_seams.values())
    for name in report.open_seams:
        assert "front" in name
        assert any(name in w and "stays open" in w for w in report.warnings)


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_skirt_with_ease_slides_down_a_cylinder(friction):
    scene = skirt(1.1 * 2 * np.pi * RADIUS, CYLINDER, friction)
    simulation, report = settled_without_crossing(scene)
    assert not report.open_seams
    assert report.self_intersections == 0
    assert not report.settled
    assert report.rest_reason.startswith("not supported by the body")
    assert simulation.positions[:, 2].max() < 0.5


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_the_same_skirt_is_held_by_a_cone(friction):
    cone = body_of(trimesh.creation.cone(0.25, 0.6, sections=48), move=[0, 0, 0.5])
    around = 1.1 * 2 * np.pi * RADIUS
    # Without friction only the air stops it from turning about the cone: 3 to 11 s, by the rounding of its start.
    simulation, report = settled_without_crossing(skirt(around, cone, friction, longest=8.0 if friction else 30.0))
    assert report.settled
    assert report.self_intersections == 0
    # Its upper rim is where the cone has its girth: 0.25 m in radius at z = 0.5, none at 1.1. Slack cloth hangs lower.
    rim = 1.1 - 0.6 * (around / (2 * np.pi)) / 0.25
    assert simulation.positions[:, 2].max() == pytest.approx(rim + 0.2, abs=0.25)
    assert simulation.positions[:, 2].min() > 0.5


# ---- layers


def test_a_wide_tube_over_trousers_stays_outside_of_them():
    body = Body.load("young")
    over = pattern(tube(0.25, 0.56, 0.35, 0.85), SIDES, name="tube")
    fabric = Fabric.preset("cotton_poplin")
    scene = Scene.build([Pattern.load("trousers"), over], body, fabric, settings=Settings(spacing=0.03, max_time=2.0))
    simulation, _ = settled_without_crossing(scene, every=0.2)
    garment, x = scene.garment, simulation.positions
    outer = [k for k, name in enumerate(garment.panel_names) if name.startswith("tube/")]
    is_outer = np.isin(garment.panel_of_triangle, outer)
    # From the body's middle outwards what is met last is the tube, wherever there is both: below its upper rim.
    of_tube = np.isin(garment.panel_of_particle, outer)
    rim = of_tube & (garment.start[:, 2] > garment.start[of_tube, 2].max() - 1e-6)
    inside = x[~of_tube]
    inside = inside[(inside[:, 2] > 0.7) & (inside[:, 2] < x[rim, 2].min())]
    assert len(inside) > 50
    away = (inside - [*body.vertices[:, :2].mean(axis=0), 0.0]) * [1, 1, 0]
    tube_mesh = trimesh.Trimesh(x, garment.triangles[is_outer], process=False)
    assert tube_mesh.ray.intersects_any(inside, away).mean() > 0.95
