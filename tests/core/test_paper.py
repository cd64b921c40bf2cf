"""The founding paper, step by step (Dong and Yuan, 3D Garment Simulation ... Based on Particle Spring Model).

One test, or a few, for each of its nine steps; the other files of this folder go into depth.
"""

import numpy as np
import pytest
import trimesh
from apparatus import (
    body_of,
    by_axis,
    chain,
    crossings,
    do_steps,
    pattern,
    plain_fabric,
    rectangle,
    sheet,
    spring_force,
)

from cloth_core.aabb_tree import build_tree, overlapping_pairs, refit_tree
from cloth_core.body import Body, builtin_bodies
from cloth_core.contact import Contact
from cloth_core.euler import semi_implicit_euler
from cloth_core.fabric import Fabric, fabric_presets
from cloth_core.garment import Garment
from cloth_core.gravity_and_air import air_drag_forces, gravity_forces
from cloth_core.intersections import self_crossing_edges
from cloth_core.model import Model
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.springs import SpringFamily, build_springs


def test_step_1_each_panel_is_discretised_into_a_square_grid_whose_quads_get_diagonals():
    nx, ny, h = 6, 4, 0.05
    garment = sheet(nx * h, ny * h, h)
    assert len(garment.rest) == (nx + 1) * (ny + 1)
    assert len(garment.quads) == nx * ny
    assert len(garment.triangles) == 2 * nx * ny
    sides = garment.rest[garment.quads[:, [1, 2, 3, 0]]] - garment.rest[garment.quads]
    np.testing.assert_allclose(np.linalg.norm(sides, axis=2), h, rtol=1e-9)  # squares
    for quad, halves in zip(garment.quads, garment.triangles.reshape(-1, 2, 3), strict=True):
        assert set(halves.ravel()) == set(quad)


def test_step_2_three_spring_families_with_initial_positions_and_rest_lengths_by_a_fixed_rule():
    nx, ny, h = 6, 4, 0.05
    garment = sheet(nx * h, ny * h, h)
    springs = build_springs(garment, plain_fabric(bending_spring=1.0))
    count = {family: int((springs.family == family).sum()) for family in SpringFamily}
    assert count == {
        SpringFamily.STRUCTURAL: nx * (ny + 1) + ny * (nx + 1),  # neighbours along rows and columns
        SpringFamily.SHEAR: 2 * nx * ny,  # diagonals
        SpringFamily.BENDING: (nx - 1) * (ny + 1) + (ny - 1) * (nx + 1),  # two apart along rows and columns
    }
    lengths = {f: set(np.round(springs.rest_length[springs.family == f], 9)) for f in SpringFamily}
    assert lengths[SpringFamily.STRUCTURAL] == {h}
    assert lengths[SpringFamily.SHEAR] == {round(h * 2**0.5, 9)}
    assert lengths[SpringFamily.BENDING] == {2 * h}
    # At the start every spring has its rest length: the panels are flat.
    start = np.linalg.norm(garment.start[springs.pairs[:, 1]] - garment.start[springs.pairs[:, 0]], axis=1)
    np.testing.assert_allclose(start, springs.rest_length, rtol=1e-12)
    again = build_springs(sheet(nx * h, ny * h, h), plain_fabric(bending_spring=1.0))
    np.testing.assert_array_equal(springs.pairs, again.pairs)


def test_step_3_gravity_air_resistance_and_hookes_law_add_up_to_m_a():
    # Particle 0 between two neighbours: F = m g - m k_a v + sum k (1 - L0 / |d|) d.
    m, k_a, k, length0, g = 2.0, 0.5, 30.0, 1.0, 10.0
    x = np.array([[0.0, 0, 0], [1.5, 0, 0], [0, 0.8, 0.6]])
    v = np.array([[1.0, -2.0, 0.5], [0, 0, 0], [0, 0, 0]])
    by_axes = np.zeros((3, 3))
    gravity_forces(np.full(3, m), np.array([0.0, 0, -g]), by_axes)
    air_drag_forces(by_axis(v), np.full(3, m), k_a, by_axes)
    force = by_axes.T + spring_force(x, v, [[0, 1], [0, 2]], np.full(2, length0), np.full(2, k), 0.0)
    expected = np.array([0, 0, -m * g]) - m * k_a * v[0]
    for neighbour in (1, 2):
        d = x[neighbour] - x[0]
        expected = expected + k * (1 - length0 / np.linalg.norm(d)) * d
    np.testing.assert_allclose(force[0], expected, rtol=1e-12, atol=1e-12)


def test_step_4_euler_takes_acceleration_then_velocity_then_position():
    x, v, force, m, dt = np.array([[1.0, 2, 3]]), np.array([[0.1, 0, -0.1]]), np.array([[4.0, -2, 8]]), 2.0, 0.1
    a = force / m  # a = F(t) / m
    v_next = v + dt * a  # v(t + dt) = v(t) + dt a
    x_next = x + dt * v_next  # x(t + dt) = x(t) + dt v(t + dt)
    x, v = by_axis(x), by_axis(v)
    semi_implicit_euler(x, v, by_axis(force), np.array([1 / m]), dt)
    np.testing.assert_allclose(v.T, [v_next[0]], rtol=1e-15)
    np.testing.assert_allclose(x.T, [x_next[0]], rtol=1e-15)


def test_step_5_repeats_until_every_displacement_tends_to_a_constant():
    garment = sheet(0.3, 0.2, 0.05)
    upper = np.flatnonzero(garment.rest[:, 1] > 0.099).astype(np.int32)
    scene = Scene(garment=garment, fabric=Fabric.preset("cotton_poplin"), pins=upper)
    simulation = Simulation(scene)
    displacement, times = [], []

    def note(running: Simulation) -> None:
        displacement.append(running.positions - garment.start)
        times.append(running.time)

    simulation.settle(note)
    assert simulation.settled
    # From one window before the end nothing has moved by more than the criterion says, of a way of many centimetres.
    window, last = scene.settings.rest_window, displacement[-1]
    since = next(d for d, t in zip(displacement, times, strict=True) if t >= times[-1] - window + 0.02)
    assert np.linalg.norm(last - since, axis=1).max() <= 1.01 * scene.settings.rest_displacement
    assert np.abs(last).max() > 0.1
    # And it stays a constant: what comes later is within millimetres of it.
    simulation.advance(1.0)
    assert np.abs(simulation.positions - garment.start - last).max() < 0.005


def test_step_6_two_aabb_trees_are_traversed_together():
    rng = np.random.default_rng(6)
    body = trimesh.creation.icosphere(2, radius=0.1)
    bx, bt = np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32)
    garment = sheet(0.2, 0.2, 0.02, z=0.08)
    body_tree, panel_tree = build_tree(bx, bt), build_tree(garment.start, garment.triangles)
    moved, margin = garment.start + 0.01 * rng.standard_normal(garment.start.shape), 0.004
    refit_tree(panel_tree, moved, garment.triangles, margin)  # the cloth's boxes are enlarged
    pairs = np.zeros((len(bt) * len(garment.triangles), 2), dtype=np.int32)
    found = {tuple(p) for p in pairs[: overlapping_pairs(body_tree, panel_tree, pairs)].tolist()}
    low, high = moved[garment.triangles].min(axis=1) - margin, moved[garment.triangles].max(axis=1) + margin
    meet = (low[:, None] <= bx[bt].max(axis=1)[None]) & (bx[bt].min(axis=1)[None] <= high[:, None])
    assert found == {tuple(p) for p in np.argwhere(meet.all(axis=2)).tolist()}
    assert 0 < len(found) < len(bt) * len(garment.triangles) / 10


def test_step_6_the_bodys_tree_is_built_once():
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    scene = Scene(garment=sheet(0.2, 0.2, 0.05, z=0.12), body=ball, fabric=Fabric.preset("wool"))
    simulation = Simulation(scene)
    tree = ball.tree
    boxes = tree.lower.copy(), tree.upper.copy()
    simulation.advance(0.3)
    assert ball.tree is tree
    np.testing.assert_array_equal(tree.lower, boxes[0])
    np.testing.assert_array_equal(tree.upper, boxes[1])
    assert isinstance(simulation.model.contact, Contact)


def test_step_6_a_collision_response_follows():
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    scene = Scene(garment=sheet(0.2, 0.2, 0.05, z=0.12), body=ball, fabric=Fabric.preset("wool"))
    simulation = Simulation(scene)
    for _ in range(30):
        simulation.advance(0.02)
        assert crossings(simulation.positions, simulation.triangles, ball) == 0
    assert simulation.positions[:, 2].max() > 0.09  # it has been caught


def test_step_6_crossings_of_the_panels_with_themselves_are_found_by_the_same_trees():
    garment = sheet(0.2, 0.1, 0.05)
    x = garment.start.copy()
    assert len(self_crossing_edges(x, garment.triangles)) == 0
    x[x[:, 0] > 0.06, 0] -= 0.17  # the right end is folded back and down through the left one
    x[garment.rest[:, 0] > 0.06, 2] -= 0.01
    x[garment.rest[:, 0] < -0.06, 2] += np.where(garment.rest[garment.rest[:, 0] < -0.06, 1] > 0, 0.03, -0.03)
    assert len(self_crossing_edges(x, garment.triangles)) > 0


def test_step_7_flat_panels_are_sewn_around_the_body():
    pillar = body_of(trimesh.creation.cylinder(radius=0.1, height=1.0, sections=24))
    panels = {
        "front": rectangle(0.36, 0.3, at=(0, 0, 0.15)),
        "back": rectangle(0.36, 0.3, at=(0, 0, -0.15), turned=(0, 180, 0)),
    }
    tube = pattern(panels, [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))])
    scene = Scene.build(tube, pillar, Fabric.preset("cotton_poplin"), settings=Settings(spacing=0.04))
    simulation = Simulation(scene)
    seams = scene.garment.seams
    widest = []
    while simulation.phase == "sewing":
        x = simulation.positions
        widest.append(max(np.linalg.norm(x[s.first] - x[s.second], axis=1).max() for s in seams))
        assert crossings(x, simulation.triangles, pillar) == 0  # collisions are handled all the while
        simulation.tick()
    assert widest[0] == pytest.approx(0.3)
    assert widest[len(widest) // 2] < 0.6 * widest[0]  # step by step
    assert widest[-1] < 0.002
    x = simulation.positions
    assert max(np.abs(x[s.first] - x[s.second]).max() for s in seams) == 0.0  # one particle each
    angle = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
    assert len(np.unique(np.floor((angle + 360) / 45) % 8)) == 8  # all around


def test_step_8_the_papers_parameters_are_a_preset_in_scaled_units():
    name = next(n for n in fabric_presets() if "paper" in n)
    fabric = Fabric.preset(name)
    assert fabric.strain_limit == 0.05  # elongation at most 5 %
    assert fabric.bending_spring > 0.0  # its third family
    # In its own units, m = 1, k = 10 and g = 10, a column of N rows stretches its top spring by N lengths.
    rows = 3
    x, terms = chain(rows, 1.0, 10.0, 1.0, gravity=[0.0, 0.0, -10.0], air_drag=2.0)
    do_steps(x, np.zeros_like(x), terms, 0.1, 600)
    assert -x[1, 2] - 1.0 == pytest.approx(rows, rel=1e-6)
    # As a preset its sheet keeps to 5 %.
    garment = sheet(0.2, 0.3, 0.05)
    upper = np.flatnonzero(garment.rest[:, 1] > 0.149).astype(np.int32)
    scene = Scene(garment=garment, fabric=fabric, pins=upper, gravity=(0.0, 0.0, -10.0))
    simulation = Simulation(scene)
    simulation.advance(2.0)
    assert simulation.report().max_strain <= 0.05


def test_step_9_one_garment_for_three_women():
    heights = {"young": 1.660, "middle_aged": 1.600, "elderly": 1.610}
    assert set(builtin_bodies()) == set(heights)
    skirt = Garment.from_pattern(Pattern.load("skirt"), 0.05)
    for name, height in heights.items():
        body = Body.load(name)
        assert np.ptp(body.vertices[:, 2]) == pytest.approx(height, abs=0.01)
        scene = Scene.build(Pattern.load("skirt"), body, settings=Settings(spacing=0.05))
        np.testing.assert_array_equal(scene.garment.triangles, skirt.triangles)  # the same garment
        simulation = Simulation(scene)
        simulation.advance(0.9)
        report = simulation.report()
        assert simulation.phase != "sewing"
        assert report.open_seams == {}  # dressed
        assert report.body_intersections == 0
        waist = simulation.positions[:, 2].max()
        assert 0.5 * height < waist < 0.8 * height
    assert Model(scene).particle_count == skirt.particle_count
