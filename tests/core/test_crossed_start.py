"""Cloth that passes through itself where it starts: named, and never more than at the start."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, plain_fabric, rectangle, sheet
from naive_geometry import is_edge_intersecting_triangle

from cloth_core.body import Body
from cloth_core.crossed_start import crossing_at_start
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_edges
from cloth_core.mesh_topology import unique_edges
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

SPACING = 0.025
CROSS = {"a": rectangle(0.2, 0.2, turned=(-90, 0, 0)), "b": rectangle(0.2, 0.2, turned=(0, 90, 0))}
"""A level panel and an upright one through it."""


def cross() -> Garment:
    return Garment.from_pattern(pattern(CROSS, name="cross"), SPACING)


def sewn_cross() -> Garment:
    """The same with one side of each sewn to one side of the other."""
    return Garment.from_pattern(pattern(CROSS, [(("a", 1), ("b", 2))], name="cross"), SPACING)


def loop() -> Garment:
    """A strip wound once around, whose ends pass through each other like those of a fish drawn in one line."""
    garment = sheet(0.5, 0.1, SPACING)
    t = 2.0 * np.pi * 0.8 * garment.rest[:, 0] / 0.5
    x = 0.08 * np.column_stack([np.sin(2.0 * t), garment.rest[:, 1] / 0.08, np.cos(t)])
    return replace(garment, start=x)


def loops() -> Garment:
    """A strip in a row of loops (a prolate trochoid), each through itself and its neighbours."""
    garment = sheet(0.5, 0.1, SPACING)
    t = garment.rest[:, 0] / 0.03
    x = np.column_stack([0.01 * t - 0.03 * np.sin(t) + 0.1 * garment.rest[:, 1], garment.rest[:, 1], -0.03 * np.cos(t)])
    return replace(garment, start=x)


STARTS = {"cross": cross, "sewn cross": sewn_cross, "loop": loop, "loops": loops}


def counted_naively(garment: Garment) -> int:
    """Sides that pass through any triangle with which they share no corner, seams taken for sewn."""
    sides, _ = unique_edges(garment.triangles)
    s, t = (k.ravel() for k in np.meshgrid(np.arange(len(sides)), np.arange(len(garment.triangles)), indexing="ij"))
    number = garment.merged_indices
    apart = (number[sides[s]][:, :, None] != number[garment.triangles[t]][:, None, :]).all(axis=(1, 2))
    s, t = s[apart], t[apart]
    ends, corners = garment.start[sides[s]].transpose(1, 0, 2), garment.start[garment.triangles[t]].transpose(1, 0, 2)
    return len(np.unique(s[is_edge_intersecting_triangle(*ends, *corners)]))


@pytest.mark.parametrize("what", STARTS)
def test_number_of_crossings_is_that_of_a_count_by_another_formula(what):
    # A little aside, where nothing just touches: there the formulas may differ.
    garment = STARTS[what]()
    way = 1e-4 * np.random.default_rng(1).standard_normal(garment.start.shape)
    moved = replace(garment, start=garment.start + way)
    assert len(crossing_at_start(moved)) == counted_naively(moved) > 10


@pytest.mark.parametrize("what", STARTS)
def test_cloth_that_starts_crossed_is_warned_about_with_its_panels(what):
    garment = STARTS[what]()
    simulation = Simulation(Scene(garment=garment, fabric=plain_fabric()))
    count = len(crossing_at_start(garment))
    panels = "'a', 'b'" if "cross" in what else "'sheet'"
    expected = f"garment '{garment.name}': {count} sides of panel {panels} pass through the cloth where it starts; what"
    for warnings in (simulation.scene.warnings, simulation.report().warnings, simulation.describe()["warnings"]):
        (found,) = [w for w in warnings if w.startswith(expected)]
        assert found.endswith("place the panels apart")
        assert "\n" not in found
        if "cross" in what:  # a lies level at height 0, b upright across: both are there where y is anything
            for place in found.split(" (")[1:]:
                x, _, z = (float(value) for value in place.split(")")[0].split(","))
                assert max(abs(x), abs(z)) <= 0.5 * SPACING + 0.005


def test_start_that_does_not_cross_is_not_warned_about():
    # Nor do built-in garments, though the panels of the dress touch where they are to be sewn.
    flat = Scene(garment=sheet(0.2, 0.2, SPACING), fabric=plain_fabric())
    assert flat.warnings == ()
    for name in ("tshirt", "skirt", "trousers", "dress"):
        scene = Scene.build(Pattern.load(name), Body.load("young"), settings=Settings(spacing=SPACING))
        assert not [w for w in (*scene.warnings, *scene.disturbed(1).warnings) if "pass through" in w]
    # And panels that a pattern places across each other are moved apart.
    apart = Scene.build(pattern(CROSS), settings=Settings(spacing=SPACING))
    assert len(crossing_at_start(apart.garment)) == 0


BALL = body_of(trimesh.creation.icosphere(2, radius=0.06), move=(0.0, 0.0, -0.25))


WAYS = [(what, way) for what in STARTS for way in ("advance", "settle", "implicit")]
WAYS.remove(("sewn cross", "implicit"))  # implicit steps sew no seams


@pytest.mark.parametrize(("what", "way"), WAYS)
def test_crossings_never_become_more(what, way):
    garment = STARTS[what]()
    settings = Settings(
        spacing=SPACING, max_time=0.3, integrator="implicit" if way == "implicit" else "symplectic", closing_time=0.1
    )
    # Two corners are held, so that what is free swings down and against the rest of it.
    held = np.argsort(garment.start[:, 2])[-2:].astype(np.int32)
    scene = Scene(garment=garment, fabric=Fabric.preset("silk"), pins=held, body=BALL, settings=settings)
    simulation = Simulation(scene)
    counts = [len(crossing_at_start(garment))]

    def look(s: Simulation) -> None:
        assert np.isfinite(s.positions).all()
        counts.append(len(self_crossing_edges(s.positions, s.triangles, garment.merged_indices)))

    if way == "settle":
        simulation.settle(look)
    else:
        simulation.advance(0.25, look)
    assert counts[0] > 10
    assert max(counts) == counts[0]
    assert np.abs(simulation.positions - garment.start).max() > 0.005  # it did move


BALL_AROUND = body_of(trimesh.creation.icosphere(2, radius=0.06), move=(0.0, 0.0, 0.02))


def counted_through(garment: Garment, body: Body) -> int:
    """Sides that pass through any triangle of a body."""
    sides, _ = unique_edges(garment.triangles)
    s, t = (k.ravel() for k in np.meshgrid(np.arange(len(sides)), np.arange(len(body.triangles)), indexing="ij"))
    ends, corners = garment.start[sides[s]].transpose(1, 0, 2), body.vertices[body.triangles[t]].transpose(1, 0, 2)
    return len(np.unique(s[is_edge_intersecting_triangle(*ends, *corners)]))


def test_start_through_the_body_is_named_with_its_number_and_places():
    garment = sheet(0.3, 0.3, SPACING)
    # A little aside, as above: corners of the ball lie in planes of the grid.
    garment = replace(garment, start=garment.start + np.array([0.0031, 0.0017, 0.0011]))
    scene = Scene(garment=garment, fabric=plain_fabric(), body=BALL_AROUND, settings=Settings(spacing=SPACING))
    simulation = Simulation(scene)
    (line,) = [w for w in simulation.report().warnings if "pass through body" in w]
    count = counted_through(garment, BALL_AROUND)
    assert line.startswith(f"garment 'sheet': {count} sides of panel 'sheet' pass through body '{BALL_AROUND.name}' ")
    assert count > 10
    # Where the level sheet cuts the ball, up to the length of a side.
    places = [np.array([float(v) for v in p.split(")")[0].split(",")]) for p in line.split(" (")[1:]]
    assert len(places) >= 1
    for place in places:
        assert np.linalg.norm(place - [0.0, 0.0, 0.02]) == pytest.approx(0.06, abs=SPACING)
        assert place[2] == pytest.approx(garment.start[0, 2], abs=0.005)
    # A body that moves against the cloth later on says nothing of the start.
    above = replace(garment, start=garment.start + np.array([0.0, 0.0, 0.2]))
    simulation = Simulation(replace(scene, garment=above))
    simulation.move_body(BALL_AROUND.vertices + np.array([0.0, 0.0, 0.2]), 0.05)
    simulation.advance(0.01)
    assert not [w for w in simulation.report().warnings if "pass through body" in w or "inside body" in w]


def test_tip_of_the_body_between_particles_is_named():
    garment = sheet(0.12, 0.12, 0.04)
    middle = garment.start[garment.triangles[4]].mean(axis=0)
    cone = body_of(trimesh.creation.cone(0.05, 0.1), move=[middle[0], middle[1], middle[2] + 0.004 - 0.1])
    lines = Simulation(Scene(garment=garment, fabric=plain_fabric(), body=cone)).report().warnings
    (line,) = [w for w in lines if "body" in w]
    assert line.startswith(
        f"garment 'sheet': body '{cone.name}' comes through panel 'sheet' between its particles where it starts, at ("
    )
    place = [float(v) for v in line.split(" (")[1].split(")")[0].split(",")]
    np.testing.assert_allclose(place, middle, atol=0.006)


def test_panel_that_starts_inside_the_body_is_named():
    garment = sheet(0.05, 0.05, SPACING / 2)
    moved = replace(garment, start=garment.start + np.array([0.0, 0.0, 0.02]))
    simulation = Simulation(Scene(garment=moved, fabric=plain_fabric(), body=BALL_AROUND))
    (line,) = [w for w in simulation.report().warnings if "inside body" in w]
    assert line.startswith(f"garment 'sheet': panel 'sheet' starts inside body '{BALL_AROUND.name}' and stays there")
