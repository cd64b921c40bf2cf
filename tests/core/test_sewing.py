"""Seams pull flat panels together, without gravity, and merge; what cannot close is named."""

from dataclasses import replace

import naive_geometry
import numpy as np
import pytest
import trimesh
from apparatus import (
    GRAVITY,
    body_of,
    by_axis,
    crossings,
    panel,
    pattern,
    plain_fabric,
    rectangle,
    sides_through,
    throw,
)

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.model import Model
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.seam_closing import SeamClosing
from cloth_core.sewing import SeamPull, seam_forces, seam_gaps
from cloth_core.simulation import Simulation

POPLIN = Fabric.preset("cotton_poplin")


def tube(width: float = 0.4, apart: float = 0.1, name: str = "tube", x: float = 0.0, y: float = 1.0) -> Pattern:
    """Front and back of a tube, flat and apart, 0.3 m high, sewn along their upright edges."""
    panels = {
        "front": rectangle(width, 0.3, at=(x, y, apart / 2)),
        "back": rectangle(width, 0.3, at=(x, y, -apart / 2), turned=(0, 180, 0)),
    }
    return pattern(panels, [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))], name=name)


def scene_of(
    patterns: Pattern | list[Pattern], body: Body | None = None, fabric: Fabric = POPLIN, **settings: float
) -> Scene:
    return Scene.build(patterns, body, fabric, settings=Settings(**({"spacing": 0.04} | settings)))


def gaps(simulation: Simulation) -> dict[str, float]:
    x = simulation.positions
    return {
        s.name: float(np.linalg.norm(x[s.first] - x[s.second], axis=1).max()) for s in simulation.scene.garment.seams
    }


def sewn(simulation: Simulation) -> Simulation:
    while simulation.phase == "sewing":
        simulation.tick()
    return simulation


def test_panels_close_to_a_millimetre_and_merge():
    simulation = Simulation(scene_of(tube()))
    garment = simulation.scene.garment
    assert simulation.phase == "sewing"
    assert max(gaps(simulation).values()) == pytest.approx(0.1)
    assert simulation.model.particle_count == garment.particle_count
    before = gaps(simulation)
    while simulation.phase == "sewing":
        before = gaps(simulation)
        simulation.tick()
    assert max(before.values()) <= 0.002  # a tick before the merge they are nearly closed
    assert simulation.phase == "draping"
    assert simulation.time == pytest.approx(simulation.scene.settings.closing_time, abs=0.02)
    assert max(gaps(simulation).values()) == 0.0
    assert simulation.model.particle_count == garment.merged_indices.max() + 1
    np.testing.assert_array_equal(simulation.model.number, garment.merged_indices)
    assert simulation.model.seam_pull is None  # no seam springs any more
    report = simulation.report()
    assert report.max_seam_gap == 0.0
    assert report.open_seams == {}
    assert not any("seam" in w for w in report.warnings)


def test_sewn_springs_lie_across_the_seam():
    simulation = sewn(Simulation(scene_of(tube())))
    garment, model = simulation.scene.garment, simulation.model
    panels_of = [set() for _ in range(model.particle_count)]
    for particle, number in enumerate(model.number):
        panels_of[number].add(int(garment.panel_of_particle[particle]))
    on_seam = [i for i, p in enumerate(panels_of) if len(p) == 2]
    assert len(on_seam) == sum(len(s.first) for s in garment.seams)
    for i in on_seam:  # each has neighbours in the front and in the back
        neighbours = model.springs.pairs[(model.springs.pairs == i).any(axis=1)].ravel()
        assert {p for j in neighbours for p in panels_of[j]} == {0, 1}
        assert any(panels_of[j] == {0} for j in neighbours)
        assert any(panels_of[j] == {1} for j in neighbours)


def test_gravity_waits_until_the_seams_have_closed():
    simulation = Simulation(scene_of(tube()))
    mass = simulation.model.mass
    start = mass @ simulation.positions
    while simulation.phase == "sewing":
        x, v = simulation.positions, simulation.motion.v.copy()
        np.testing.assert_allclose(mass @ x, start, atol=1e-9)
        np.testing.assert_allclose(mass @ v, 0.0, atol=1e-9)
        simulation.tick()
    height = simulation.motion.x[:, 2] @ simulation.model.mass / simulation.model.mass.sum()
    simulation.advance(0.1)
    fallen = height - simulation.motion.x[:, 2] @ simulation.model.mass / simulation.model.mass.sum()
    k_a = simulation.scene.air_drag
    exact = GRAVITY / k_a * (0.1 - (1 - np.exp(-k_a * 0.1)) / k_a)
    assert fallen == pytest.approx(exact, rel=0.01)


def test_merging_keeps_momentum_and_the_centre_of_mass():
    simulation = Simulation(scene_of(tube()))
    while max(gaps(simulation).values()) > 0.0009:
        simulation.tick()
    assert simulation.phase == "sewing"
    throw(simulation, np.random.default_rng(2).standard_normal(simulation.motion.v.shape))
    mass = simulation.model.mass
    momentum, centre = mass @ simulation.motion.v, mass @ simulation.motion.x
    simulation.motion.time = simulation.scene.settings.closing_time
    simulation._sew(simulation.time)
    assert simulation.phase == "draping"
    assert len(simulation.motion.x) < len(mass)
    np.testing.assert_allclose(simulation.model.mass @ simulation.motion.v, momentum, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(simulation.model.mass @ simulation.motion.x, centre, rtol=1e-12, atol=1e-15)
    assert simulation.model.mass.sum() == pytest.approx(mass.sum(), rel=1e-12)


def test_unequal_masses_merge_by_their_weights():
    # A narrow strip sewn to a wide panel: the merged particle lies nearer to the heavier one.
    two = pattern(
        {"wide": rectangle(0.4, 0.2, at=(-0.2, 0, 0)), "thin": rectangle(0.02, 0.2, at=(0.02, 0, 0))},
        [(("wide", 1), ("thin", 3))],
    )
    scene = scene_of(two, spacing=0.1)
    apart = Model(scene)
    number = scene.garment.merged_indices
    together = Model(scene, closed=scene.garment.seams)
    found = together.gather(scene.garment.start, scene.garment.particle_areas)
    for k in range(together.particle_count):
        members = np.flatnonzero(number == k)
        np.testing.assert_allclose(
            found[k], np.average(scene.garment.start[members], axis=0, weights=apart.mass[members]), atol=1e-12
        )


def test_dart_closes_within_its_panel():
    corners = [(0, 0), (0.17, 0), (0.2, 0.15), (0.23, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)]
    darted = pattern({"piece": panel(corners)}, [(("piece", 1), ("piece", 2))])
    simulation = Simulation(scene_of(darted, spacing=0.03))
    assert max(gaps(simulation).values()) == pytest.approx(0.06)
    sewn(simulation)
    assert max(gaps(simulation).values()) == 0.0
    assert simulation.report().open_seams == {}


@pytest.mark.parametrize("ratio", [1.1, 1.3])
def test_unequal_edges_close_by_gathering(ratio):
    panels = {"a": rectangle(0.3, 0.3, at=(-0.16, 0, 0)), "b": rectangle(0.3, 0.3 * ratio, at=(0.16, 0, 0))}
    gathered = pattern(panels, [(("a", 1), ("b", 3))])
    simulation = sewn(Simulation(scene_of(gathered, spacing=0.03)))
    assert simulation.report().open_seams == {}
    assert max(gaps(simulation).values()) == 0.0


# ---- what cannot close


def block(x: float = 0.0) -> Body:
    """A column of 0.5 by 0.3 m, 2 m high: much more around than a tube of two times 0.4 m."""
    return body_of(trimesh.creation.box(extents=[0.5, 0.3, 2.0]), move=[x, 0.0, 1.0])


def test_seam_that_a_body_holds_open_is_named():
    scene = scene_of(tube(apart=0.4), block(), fabric=Fabric.preset("denim"), sewing_time=1.5, max_time=1.6)
    simulation = Simulation(scene)
    report = simulation.settle()
    names = [s.name for s in scene.garment.seams]
    assert names == ["panel 'front', edge 1 - panel 'back', edge 3", "panel 'front', edge 3 - panel 'back', edge 1"]
    assert list(report.open_seams) == names
    for name in names:
        gap = report.open_seams[name]
        assert gap > 0.1  # (1.6 - 0.8) / 2 = 0.4 m are missing at each, less what the cloth stretches
        (line,) = [w for w in report.warnings if w.startswith(f"seam {name}: still ")]
        assert float(line.split(" still ")[1].split(" mm open")[0]) == pytest.approx(1000 * gap, abs=30.0)
        # And where: on the side of the column that the seam is on.
        place = [float(value) for value in line.split("the body lies in it at (")[1].split(") m")[0].split(",")]
        x = simulation.positions[scene.garment.seams[names.index(name)].first]
        assert block().signed_distance(np.array([place]))[0] == pytest.approx(0.0, abs=0.16)
        assert np.sign(place[0]) == np.sign(x[:, 0].mean())
    assert report.max_seam_gap > 0.1
    assert not report.settled
    assert report.body_intersections == 0
    x, triangles = simulation.sewn_mesh()
    assert crossings(x, triangles, block()) == 0
    assert simulation.time >= 1.5


def test_other_seams_close_all_the_same():
    free, held = tube(name="free", x=-2.0), tube(name="held", apart=0.4)
    simulation = sewn(Simulation(scene_of([free, held], block(), sewing_time=1.2)))
    found = gaps(simulation)
    assert [found[s.name] == 0.0 for s in simulation.scene.garment.seams] == [True, True, False, False]
    report = simulation.report()
    assert list(report.open_seams) == [s.name for s in simulation.scene.garment.seams[2:]]
    assert all(name.startswith("held: ") for name in report.open_seams)


def test_seam_whose_lines_cross_closes():
    # The lines between the two points at each side meet in the middle, as they do where a narrow edge goes round a
    # corner: what touches nothing but these lines is free to go.
    strips = {
        "front": rectangle(0.025, 0.15, at=(0, 1, 0.1)),
        "back": rectangle(0.025, 0.15, at=(0, 1, -0.1), turned=(0, 180, 0)),
    }
    simulation = sewn(Simulation(scene_of(pattern(strips, [(("front", 0), ("back", 0), "right_wrong")]))))
    assert simulation.report().open_seams == {}
    assert simulation.report().self_intersections == 0
    assert simulation.time < 1.0


def ribbon_between() -> Scene:
    """Two sheets, 6 mm apart where they are to be sewn, and a ribbon of 60 mm that stands upright in between."""
    panels = {
        "left": rectangle(0.3, 0.3, at=(-0.153, 0, 0)),
        "right": rectangle(0.3, 0.3, at=(0.153, 0, 0)),
        "ribbon": rectangle(0.06, 0.1, at=(0, 0, 0), turned=(0, 90, 0)),
    }
    stitches = [(("left", 1), ("right", 3))]
    scene = scene_of(pattern(panels, stitches), spacing=0.03)
    start = scene.garment.start.copy()
    ribbon = scene.garment.panel_of_particle == 2
    start[ribbon] = start[ribbon] * [0.0, 1.0, 1.0] + [0.001, 0.004, 0.002]  # no corner lies in another plane
    return replace(scene, garment=replace(scene.garment, start=start))


def crossing_sides(x: np.ndarray, triangles: np.ndarray) -> int:
    """Sides that cross a triangle with which they share no corner, by the textbook."""
    sides = np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    own = (sides[:, None, :, None] == triangles[None, :, None, :]).any(axis=(2, 3))
    p, q = (x[sides[:, k], None] for k in range(2))
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return int((naive_geometry.is_edge_intersecting_triangle(p, q, a, b, c) & ~own).any(axis=1).sum())


def test_late_merge_leaves_open_what_would_cross():
    scene = ribbon_between()
    settings, garment = scene.settings, scene.garment
    (seam,) = garment.seams
    model = Model(scene, sewing=True)
    assert crossing_sides(garment.start, garment.triangles) == 0
    everything = Model(scene, closed=garment.seams)
    assert crossing_sides(everything.gather(garment.start, garment.particle_areas), everything.triangles) > 0
    closing = SeamClosing()
    merged = closing.merged(scene, model, garment.start, settings.sewing_time, settings.sewing_time)
    assert merged is not None
    assert crossing_sides(merged.gather(garment.start, garment.particle_areas), merged.triangles) == 0
    # Beside the ribbon, 0.1 m of 0.3, the seam is closed.
    (part,) = merged.closed
    beside = np.abs(garment.start[seam.first][:, 2]) > 0.05 + settings.spacing
    assert set(seam.first[beside]) <= set(part.first) < set(seam.first)
    assert closing.open_seams == {seam.name: pytest.approx(0.006)}


def test_late_merge_leaves_a_needle_of_the_body_outside():
    # Two sheets 6 mm apart and a needle upright in between: once merged, it would stand in the middle of a triangle,
    # with no side of the cloth through it.
    needle = trimesh.creation.cone(0.002, 0.2, sections=16)
    needle.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    panels = {"left": rectangle(0.3, 0.3, at=(-0.153, 0, 0)), "right": rectangle(0.3, 0.3, at=(0.153, 0, 0))}
    scene = scene_of(pattern(panels, [(("left", 1), ("right", 3))]), spacing=0.03)
    settings, garment = scene.settings, scene.garment
    (seam,) = garment.seams
    start = garment.start
    height = np.sort(start[seam.first][:, 2])
    body = body_of(needle, move=[0.0016, -0.12, height[4:6].mean()])
    scene = replace(scene, body=body)
    assert crossings(start, garment.triangles, body) == 0
    everything = Model(scene, closed=garment.seams)
    together = everything.gather(start, garment.particle_areas)
    assert sides_through(together, everything.triangles, body.vertices, body.triangles) == 0
    assert sides_through(body.vertices, body.triangles, together, everything.triangles) > 0
    closing = SeamClosing()
    merged = closing.merged(scene, Model(scene, sewing=True), start, settings.sewing_time, settings.sewing_time)
    assert merged is not None
    assert crossings(merged.gather(closing.positions, garment.particle_areas), merged.triangles, body) == 0
    (part,) = merged.closed
    assert len(seam.first) - 4 <= len(part.first) < len(seam.first)


def test_where_every_merge_would_cross_all_stays_open(monkeypatch):
    # No choice of points and no nudge helps: crossings never rise, also when the time for sewing is over.
    monkeypatch.setattr("cloth_core.seam_closing._placed", lambda scene, x, which, present: (x, present + 1))
    monkeypatch.setattr("cloth_core.seam_closing._nudged", lambda scene, x, which, present: (x, present + 1))
    simulation = Simulation(scene_of(tube()))
    x = simulation.positions
    closing = SeamClosing()
    model = closing.merged(simulation.scene, simulation.model, x, 100.0, 100.0)
    assert model is not None
    np.testing.assert_array_equal(closing.positions, x)
    assert len(np.unique(model.number)) == simulation.scene.garment.particle_count
    assert set(closing.open_seams) == {seam.name for seam in simulation.scene.garment.seams}


def test_points_that_had_to_stay_two_hold_on_to_each_other_and_merge_when_the_way_is_free():
    scene = ribbon_between()
    garment = scene.garment
    (seam,) = garment.seams
    closing = SeamClosing()
    late = scene.settings.sewing_time
    merged = closing.merged(scene, Model(scene, sewing=True), garment.start, late, late)
    assert merged is not None
    two = merged.number[seam.first] != merged.number[seam.second]
    assert 0 < two.sum() < len(two)
    assert merged.seam_pull is not None
    wanted = np.stack([merged.number[seam.first], merged.number[seam.second]], axis=1)[two]
    assert {frozenset(pair) for pair in merged.seam_pull.pairs.tolist()} == {
        frozenset(pair) for pair in wanted.tolist()
    }
    # As long as the ribbon is there, no more than what it leaves room for; when it has gone sideways, all is one.
    time = late
    while (more := closing.merged_later(scene, merged, closing.positions, time := time + 0.21)) is not None:
        assert more.particle_count < merged.particle_count
        assert crossing_sides(more.gather(closing.positions, garment.particle_areas), more.triangles) == 0
        merged = more
    assert (merged.number[seam.first] != merged.number[seam.second]).any()
    gone = closing.positions + np.outer(garment.panel_of_particle == 2, [0.0, 0.5, 0.0])
    whole = closing.merged_later(scene, merged, gone, time + 0.21)
    assert whole is not None
    assert (whole.number[seam.first] == whole.number[seam.second]).all()
    assert closing.open_seams == {}
    assert whole.seam_pull is None or len(whole.seam_pull.pairs) == 0
    assert closing.merged_later(scene, whole, gone, time + 0.42) is None


def test_points_that_cannot_merge_are_let_go_after_a_while():
    scene = ribbon_between()
    closing = SeamClosing()
    late = scene.settings.sewing_time
    merged = closing.merged(scene, Model(scene, sewing=True), scene.garment.start, late, late)
    assert merged is not None
    free = closing.merged_later(scene, merged, closing.positions, late + 2.0)
    assert free is not None
    assert free.seam_pull is None
    assert np.array_equal(free.number, merged.number)
    assert list(closing.open_seams) == [scene.garment.seams[0].name]
    assert closing.merged_later(scene, free, closing.positions, late + 4.0) is None


def test_hopeless_seams_are_given_up_early_and_nothing_rushes():
    # A tube of two times 0.4 m around a column of 1.6 m, twice as far as its fabric reaches.
    scene = scene_of(tube(apart=0.4), block(), fabric=Fabric.preset("denim"))
    simulation = Simulation(scene)
    fastest = 0.0

    def look(run: Simulation) -> bool:
        nonlocal fastest
        fastest = max(fastest, run.progress.largest_speed)
        return run.phase != "sewing"

    simulation.settle(look)
    assert scene.settings.closing_time + 0.1 < simulation.time < scene.settings.sewing_time - 0.5
    assert len(simulation.report().open_seams) == 2
    assert fastest <= 3.0 + 1e-9


def test_garment_without_seams_does_not_sew():
    simulation = Simulation(scene_of(pattern({"p": rectangle(0.2, 0.2)})))
    assert simulation.phase == "draping"
    assert simulation.model.seam_pull is None


def test_an_outer_garment_is_sewn_once_the_inner_one_is_closed():
    scene = scene_of([tube(name="inner"), tube(width=0.5, apart=0.2, name="outer")])
    once = scene.settings.closing_time
    assert (scene.closing_time, scene.sewing_time) == (2.0 * once, once + scene.settings.sewing_time)
    simulation = Simulation(scene)
    while simulation.time < 0.98 * once:
        simulation.tick()
    now = gaps(simulation)
    assert max(gap for name, gap in now.items() if name.startswith("inner")) < 0.005
    assert min(gap for name, gap in now.items() if name.startswith("outer")) == pytest.approx(0.2, abs=0.005)
    sewn(simulation)
    assert simulation.time == pytest.approx(2.0 * once, abs=0.02)
    assert max(gaps(simulation).values()) == 0.0


# ---- the pull itself


@pytest.mark.parametrize("openness", [0.0, 0.5, 1.0, 1.25, 2.0])
def test_pull_is_a_limited_spring_that_shortens(openness):
    rng = np.random.default_rng(9)
    x, v = rng.standard_normal((2, 8, 3))
    pairs = np.array([[0, 1], [2, 3], [4, 5], [6, 7]], dtype=np.int32)
    x[5] = x[4]  # closed already
    start = np.array([0.5, 2.0, 1.0, 0.1])
    sooner = np.array([0.0, 1.0, 0.0, 1.0])
    seam = SeamPull(pairs, start, np.full(len(pairs), 0.2), sooner, stiffness=3.0, largest_force=2.5)
    by_axes = np.zeros((3, len(x)))
    seam_forces(by_axis(x), by_axis(v), seam, openness, by_axes)
    force = by_axes.T
    for (i, j), length0 in zip(pairs, np.clip(openness - sooner, 0.0, 1.0) * start, strict=True):
        d = x[j] - x[i]
        length = float(np.linalg.norm(d))
        pull = min(3.0 * max(length - length0, 0.0), 2.5)
        expected = (pull * d / length if length > 0 else 0.0) + 0.2 * (v[j] - v[i])
        np.testing.assert_allclose(force[i], expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(force[j], -force[i], rtol=1e-12)


def test_seam_pull_hardly_shortens_the_stable_time_step():
    scene = scene_of(tube())
    sewing, plain = Model(scene, sewing=True), Model(scene)
    x = scene.garment.start
    assert sewing.stable_step(x, 1.0).time_step >= 0.75 * plain.stable_step(x, 1.0).time_step


def test_gaps_are_measured_at_the_worst_point():
    garment = scene_of(tube()).garment
    x = garment.start.copy()
    for seam in garment.seams:
        x[seam.second] = x[seam.first]
    assert set(seam_gaps(garment, x).values()) == {0.0}
    x[garment.seams[1].second[2]] += [0.003, 0.004, 0.0]
    assert seam_gaps(garment, x) == pytest.approx({garment.seams[0].name: 0.0, garment.seams[1].name: 0.005})


def test_unsewn_and_sewn_positions_belong_together():
    simulation = sewn(Simulation(scene_of(tube(), fabric=plain_fabric(damping_time=1e-4))))
    x, triangles = simulation.sewn_mesh()
    np.testing.assert_array_equal(simulation.positions, x[simulation.model.number])
    np.testing.assert_array_equal(triangles, simulation.model.number[simulation.triangles])
    assert len(simulation.positions) == simulation.scene.garment.particle_count
