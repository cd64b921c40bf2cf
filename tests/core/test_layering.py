"""Starts that are wrong or that several garments share: panels across each other, outer garments behind inner ones."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, pattern, rectangle, sides_through

from cloth_core.body import Body
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_edges
from cloth_core.layering import separate_panels
from cloth_core.pattern import Pattern
from cloth_core.placement import clear_of_body
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

GAP = 0.01


def garment(panels: dict, stitches=(), spacing: float = 0.05) -> Garment:
    return Garment.from_pattern(pattern(panels, stitches), spacing)


def of_panel(of: Garment, name: str) -> np.ndarray:
    return of.start[of.panel_of_particle == of.panel_names.index(name)]


def panels_cross(of: Garment) -> bool:
    """Whether any panel crosses another, by another formula than the package's."""
    parts = [of.triangles[of.panel_of_triangle == k] for k in range(len(of.panel_names))]
    return any(sides_through(of.start, a, of.start, b) > 0 for a in parts for b in parts if a is not b)


# ---- one garment


def test_panels_that_cross_are_moved_apart_and_named():
    # Two sheets facing the front, the second one turned by 20 degrees about the vertical axis and through the first.
    crossed = garment(
        {"front": rectangle(0.4, 0.5, at=(0, 1, 0.3)), "pocket": rectangle(0.3, 0.2, at=(0, 1, 0.3), turned=(0, 20, 0))}
    )
    assert panels_cross(crossed)
    apart = separate_panels(crossed, GAP)
    assert not panels_cross(apart)
    assert len(apart.warnings) == 1
    assert "front" in apart.warnings[0]
    assert "pocket" in apart.warnings[0]
    # One of them moved, along its normal, as far as it had to: the pocket's rim was 5 cm behind the front.
    for k, name in enumerate(apart.panel_names):
        move = of_panel(apart, name) - of_panel(crossed, name)
        np.testing.assert_allclose(move, np.broadcast_to(move[0], move.shape), atol=1e-12)
        np.testing.assert_allclose(np.cross(move[0], crossed.panel_normals[k]), 0.0, atol=1e-12)
        assert move[0] @ crossed.panel_normals[k] >= 0.0
    moved = np.abs(apart.start - crossed.start).max()
    assert 0.15 * np.sin(np.radians(20)) <= moved <= 0.2 * np.sin(np.radians(20)) + 2 * GAP


def test_panels_that_lie_on_each_other_are_moved_apart():
    flat = {"lower": rectangle(0.4, 0.4, at=(0, 1, 0.3)), "upper": rectangle(0.3, 0.3, at=(0.2, 1, 0.3))}
    apart = separate_panels(garment(flat), GAP)
    distance = abs(of_panel(apart, "upper")[0, 1] - of_panel(apart, "lower")[0, 1])
    assert distance == pytest.approx(GAP)
    assert "moved 10 mm outwards" in apart.warnings[0]


def side_by_side(distance: float = 0.0) -> dict:
    """Two panels with a line in common, or with a gap."""
    return {"left": rectangle(0.4, 0.4, at=(-0.2, 1, 0.3)), "right": rectangle(0.4, 0.4, at=(0.2 + distance, 1, 0.3))}


def test_panels_side_by_side_stay_where_they_are():
    for given in (garment(side_by_side(), [(("left", 1), ("right", 3))]), garment(side_by_side(1e-4))):
        assert separate_panels(given, GAP) is given


def test_panels_that_touch_and_are_not_sewn_are_moved_apart_and_free_to_fall():
    # At no distance at all, contact could let neither of them move.
    scene = Scene.build(pattern(side_by_side()), settings=Settings(spacing=0.05), air_drag=0.0)
    assert len(scene.warnings) == 1
    assert "panel 'right': starts across or behind panel 'left'; moved 10 mm outwards" in scene.warnings[0]
    simulation = Simulation(scene)
    simulation.advance(0.1)
    fallen = (scene.garment.start - simulation.positions)[:, 2]
    np.testing.assert_allclose(fallen, GRAVITY * 0.1**2 / 2, rtol=0.02)


def test_seam_that_starts_with_a_small_overlap_is_no_crossing():
    # The sides to be sewn have swapped places by a millimetre, on panels at an angle.
    folded = {
        "left": rectangle(0.4, 0.4, at=(-0.2, 1, 0.3)),
        "right": rectangle(0.4, 0.4, at=(0.199, 1, 0.2999), turned=(0, 0.2, 0)),
    }
    given = garment(folded, [(("left", 1), ("right", 3))])
    apart = separate_panels(given, GAP)
    assert np.abs(apart.start - given.start).max() < 0.02


def test_panels_that_cannot_be_moved_apart_are_named_and_left():
    cross = {"one": rectangle(5, 5, at=(0, 1, 0)), "other": rectangle(5, 5, at=(0, 1, 0), turned=(0, 90, 0))}
    given = garment(cross, spacing=0.5)
    apart = separate_panels(given, GAP)
    np.testing.assert_array_equal(apart.start, given.start)
    assert len(apart.warnings) == 1
    assert "panel 'one': starts across panel 'other' and cannot be moved clear of it" in apart.warnings[0]


# ---- garments over each other


def tube(front: float, width: float = 0.5, height: float = 0.5, at: float = 1.0, turned: float = 0.0) -> dict:
    return {
        "front": rectangle(width, height, at=(0, at, front), turned=(0, turned, 0)),
        "back": rectangle(width, height, at=(0, at, -front), turned=(0, 180 + turned, 0)),
    }


SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


def test_outer_garment_that_starts_inside_the_inner_one_is_moved_outside():
    inner, outer = garment(tube(0.2), SIDES), garment(tube(0.15, at=1.3), SIDES)
    both = Garment.joined([replace(inner, name="inner"), replace(outer, name="outer")])
    assert not panels_cross(both)  # they are wrong all the same
    apart = separate_panels(both, GAP)
    np.testing.assert_array_equal(apart.start[: inner.particle_count], both.start[: inner.particle_count])
    assert of_panel(apart, "outer/front")[:, 1] == pytest.approx(-0.2 - GAP)
    assert of_panel(apart, "outer/back")[:, 1] == pytest.approx(0.2 + GAP)
    assert apart.warnings[-2:] == (
        "panel 'outer/front': starts across or behind panel 'inner/front'; moved 60 mm outwards",
        "panel 'outer/back': starts across or behind panel 'inner/back'; moved 60 mm outwards",
    )


def test_outer_garment_is_outside_a_slanting_one():
    inner, outer = garment(tube(0.2, turned=25), SIDES), garment(tube(0.18), SIDES)
    both = Garment.joined([replace(inner, name="inner"), replace(outer, name="outer")])
    apart = separate_panels(both, GAP)
    assert not panels_cross(apart)
    # The inner front reaches out to 0.2 + 0.25 sin 25 deg, where the outer one (cos 25 deg narrower there) covers it.
    reach = 0.2 + 0.25 * np.sin(np.radians(25))
    assert of_panel(apart, "outer/front")[:, 1] == pytest.approx(-reach - GAP, abs=1e-6)


def test_garments_that_do_not_cover_each_other_stay():
    inner, outer = garment(tube(0.2, at=0.5), SIDES), garment(tube(0.15, at=1.3), SIDES)
    both = Garment.joined([replace(inner, name="inner"), replace(outer, name="outer")])
    assert separate_panels(both, GAP) is both


BUILT_IN = [("trousers", "tshirt"), ("tshirt", "trousers"), ("tshirt", "tshirt"), ("dress", "tshirt")]


@pytest.mark.parametrize("names", BUILT_IN)
def test_built_in_garments_start_over_each_other_and_clear_of_the_body(names):
    body = Body.load("young")
    scene = Scene.build([Pattern.load(name) for name in names], body, quality="draft")
    given = scene.garment
    assert len(self_crossing_edges(given.start, given.triangles, given.merged_indices)) == 0
    assert body.signed_distance(given.start).min() > 0.002
    first, second = given.name.split(" + ")
    assert len({first, second}) == 2
    for facing, inwards in (("front", 1.0), ("back", -1.0)):
        panels = {
            name: [k for k, n in enumerate(given.panel_names) if n.startswith(f"{name}/") and facing in n]
            for name in (first, second)
        }
        covers = given.triangles[np.isin(given.panel_of_triangle, panels[second])]
        outer = trimesh.Trimesh(given.start, covers, process=False)
        points = given.start[np.isin(given.panel_of_particle, panels[first])]
        way = np.tile([0.0, inwards, 0.0], (len(points), 1))
        assert outer.ray.intersects_any(points, -way).sum() > 10  # some of the inner garment is covered
        # Between the inner garment and the middle of the body there is nothing of the outer one.
        places, ray, _ = outer.ray.intersects_location(points, way)
        assert (np.abs(places[:, 1] - points[ray, 1]) > np.abs(points[ray, 1])).all()


# ---- panels and the body


def test_panel_of_a_sleeve_is_moved_to_its_own_side_of_the_arm():
    # The front panel starts behind the middle of the arm, nearer to its back.
    arm = body_of(trimesh.creation.capsule(0.6, 0.05, count=[16, 16]), move=(0, 0, 0.5))
    sleeve = {
        "front": rectangle(0.3, 0.3, at=(0, 0.8, -0.03)),
        "back": rectangle(0.3, 0.3, at=(0, 0.8, -0.12), turned=(0, 180, 0)),
    }
    sewn = clear_of_body(garment(sleeve, SIDES), arm, 0.003)
    assert of_panel(sewn, "front")[0, 1] == pytest.approx(-0.06)
    assert "moved 90 mm outwards" in sewn.warnings[0]
    # A sheet that is not sewn to anything has no side of its own and goes where it is nearer.
    loose = clear_of_body(garment({"front": sleeve["front"]}), arm, 0.003)
    assert of_panel(loose, "front")[0, 1] == pytest.approx(0.06)


def test_single_garments_are_left_as_their_patterns_place_them():
    for name in ("tshirt", "skirt", "trousers", "dress"):
        alone = Garment.from_pattern(Pattern.load(name), 0.03)
        assert separate_panels(alone, GAP) is alone
