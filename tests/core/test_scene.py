"""Scenes and settings: what is refused before anything runs, and panels that start inside the body."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, pattern, placed, plain_fabric, rectangle, sheet

from cloth_core.body import Body
from cloth_core.errors import ClothError, GarmentError, PatternError, SceneError
from cloth_core.fabric import Fabric
from cloth_core.pattern import Pattern
from cloth_core.placement import clear_of_body
from cloth_core.quality import QUALITIES, Settings, settings_for
from cloth_core.scene import Scene

DRAFT = Settings(spacing=0.04)


def scaled(name: str, factor: float) -> Body:
    body = Body.load(name)
    return Body.from_arrays(factor * body.vertices, body.triangles, name)


# ---- units


@pytest.mark.parametrize("garment", ["tshirt", "dress"])
@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres")])
def test_body_in_another_unit_is_refused_with_the_likely_unit(factor, unit, garment):
    with pytest.raises(SceneError) as caught:
        Scene.build(Pattern.load(garment), scaled("young", factor), settings=DRAFT)
    text = str(caught.value)
    assert text.startswith("scale: ")
    assert f"body 'young' was probably given in {unit} and taken for metres" in text


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres")])
def test_garment_in_another_unit_is_refused_with_the_likely_unit(factor, unit):
    # A pattern of 1.2 m whose file forgot to say that it is not in metres.
    with pytest.raises(PatternError, match=f"panel 'p': is .* m large .*; the numbers look like {unit}"):
        pattern({"p": rectangle(1.2 * factor, 1.2 * factor, at=(0, 0, 5 * factor))})


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres")])
def test_garment_that_is_too_large_for_the_body_is_refused_with_the_likely_unit(factor, unit):
    with pytest.raises(SceneError, match=f"the garment was probably given in {unit} and taken for metres"):
        Scene.build(Pattern.load("dress"), scaled("young", 1.0 / factor), settings=DRAFT)


def test_small_things_on_large_bodies_are_no_mistake_of_units():
    scarf = pattern({"p": rectangle(0.15, 0.15, at=(0, 1, 2))})
    assert Scene.build(scarf, Body.load("young"), settings=DRAFT).garment.particle_count > 4
    tent = pattern({"p": rectangle(8.0, 8.0, at=(0, 1, 9))})
    assert Scene.build(tent, Body.load("young"), settings=Settings(spacing=1.0)).garment.particle_count > 4


# ---- refusals


@pytest.mark.parametrize(("pins", "named"), [([0, 16], "16"), ([-1], "-1"), ([3, 10**6], "1000000"), ([-5, 3], "-5")])
def test_pins_out_of_range_are_refused_with_their_number(pins, named):
    with pytest.raises(SceneError, match=f"pins: particle {named} does not exist, there are 9"):
        Scene.build(pattern({"p": rectangle(0.08, 0.08)}), pins=pins, settings=DRAFT)


def test_pins_are_sorted_and_each_counts_once():
    scene = Scene.build(pattern({"p": rectangle(0.08, 0.08)}), pins=[4, 2, 4, 0], settings=DRAFT)
    assert scene.pins.tolist() == [0, 2, 4]


@pytest.mark.parametrize("gravity", [math.nan, math.inf, -math.inf])
def test_gravity_that_is_no_number_is_refused(gravity):
    with pytest.raises(SceneError, match=r"gravity: .* is not three finite numbers"):
        Scene.build(pattern({"p": rectangle(0.1, 0.1)}), gravity=gravity, settings=DRAFT)


@pytest.mark.parametrize("gravity", [(0.0, 0.0), (0.0, 0.0, -9.8, 1.0), (math.nan, 0.0, 0.0)])
def test_gravity_that_is_no_vector_is_refused(gravity):
    with pytest.raises(SceneError, match=r"gravity"):
        Scene(garment=sheet(0.1, 0.1, 0.05), fabric=plain_fabric(), gravity=gravity)


@pytest.mark.parametrize("air_drag", [-0.1, math.nan, math.inf])
def test_impossible_air_drag_is_refused(air_drag):
    with pytest.raises(SceneError, match=r"air drag: .* at least 0; give it in 1/s"):
        Scene.build(pattern({"p": rectangle(0.1, 0.1)}), air_drag=air_drag, settings=DRAFT)


def test_scene_without_a_pattern_is_refused():
    with pytest.raises(SceneError, match="scene: there is no pattern; give at least one"):
        Scene.build([])


def test_defaults_are_poplin_and_standard_gravity_downwards():
    scene = Scene.build(pattern({"p": rectangle(0.1, 0.1)}))
    assert scene.fabric == Fabric.preset("cotton_poplin")
    assert scene.gravity == (0.0, 0.0, -9.80665)
    assert scene.body is None
    assert len(scene.pins) == 0
    plain = settings_for("normal")
    # What is promised depends on the garment.
    assert replace(scene.settings, expected_error=plain.expected_error) == plain


def test_several_patterns_become_one_scene():
    one = pattern({"p": rectangle(0.1, 0.1)}, name="one")
    two = pattern({"p": rectangle(0.1, 0.1, at=(0, 1, 0))}, name="two")
    scene = Scene.build([one, two], settings=DRAFT)
    assert scene.garment.panel_names == ("one/p", "two/p")


# ---- settings


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize(
    "key",
    [k for k, v in Settings().__dict__.items() if v is None or (isinstance(v, float) and not isinstance(v, bool))],
)
def test_setting_that_is_not_positive_is_refused_with_its_name(key, value):
    with pytest.raises(SceneError, match=f"settings, {key}: .* is not a positive number"):
        Settings(**{key: value})


def test_safety_above_one_is_refused():
    with pytest.raises(SceneError, match=r"settings, safety: 1.5 is above 1"):
        Settings(safety=1.5)
    assert Settings(safety=1.0).safety == 1.0


def test_qualities_are_ordered_and_unknown_ones_refused():
    assert QUALITIES["draft"] > QUALITIES["normal"] > QUALITIES["fine"]
    for name, spacing in QUALITIES.items():
        assert settings_for(name).spacing == spacing
    with pytest.raises(SceneError, match="quality 'best': not known; use one of draft, normal, fine"):
        settings_for("best")


# ---- panels that start inside the body


def test_panel_that_touches_nothing_stays_where_it_is():
    body = body_of(trimesh.creation.icosphere(3, radius=0.2))
    garment = sheet(0.3, 0.3, 0.05, z=0.21)
    assert clear_of_body(garment, body, 0.003) is not garment
    np.testing.assert_array_equal(clear_of_body(garment, body, 0.003).start, garment.start)
    assert clear_of_body(garment, body, 0.003).warnings == ()


@pytest.mark.parametrize("z", [0.0, 0.1, 0.199])
def test_panel_inside_the_body_is_moved_straight_out_and_the_user_told(z):
    body = body_of(trimesh.creation.icosphere(3, radius=0.2))
    garment = sheet(0.6, 0.6, 0.05, z=z)
    clear = clear_of_body(garment, body, 0.003)
    moved = clear.start - garment.start
    np.testing.assert_allclose(moved - moved[0], 0.0, atol=1e-12)
    assert moved[0, :2] == pytest.approx([0.0, 0.0], abs=1e-12)
    # In steps of 1 cm, as soon as it is clear; the ball has a corner at its top.
    assert 0.203 - z <= moved[0, 2] <= 0.203 - z + 0.0101
    assert crossings(clear.start, clear.triangles, body) == 0
    assert body.signed_distance(clear.start).min() >= 0.003
    assert clear.warnings == (f"panel 'sheet': starts inside the body; moved {1000 * moved[0, 2]:.0f} mm outwards",)


def test_panel_goes_inwards_where_that_is_nearer():
    body = body_of(trimesh.creation.icosphere(3, radius=0.2))
    clear = clear_of_body(sheet(0.6, 0.6, 0.05, z=-0.1), body, 0.003)
    assert clear.start[0, 2] < -0.2
    assert "inwards" in clear.warnings[0]


def test_coarse_panel_pierced_between_its_particles_is_moved_too():
    # No particle of the sheet is anywhere near the needle that goes through it.
    needle = body_of(trimesh.creation.cone(0.005, 0.3, sections=8))
    garment = placed(sheet(0.4, 0.4, 0.4, z=0.1), move=(0.05, 0.03, 0.0))
    assert crossings(garment.start, garment.triangles, needle) > 0
    clear = clear_of_body(garment, needle, 0.003)
    assert crossings(clear.start, clear.triangles, needle) == 0


def test_panel_that_cannot_be_cleared_is_refused_with_its_name():
    block = body_of(trimesh.creation.box(extents=[3, 3, 3]))
    for size in (4.0, 0.2):  # one that sticks out of it on all sides, and one that is wholly inside
        with pytest.raises(SceneError, match=r"panel 'sheet': lies inside the body and is not clear of it within 1 m"):
            clear_of_body(sheet(size, size, size / 2), block, 0.003)


def test_small_panel_that_is_wholly_inside_the_body_is_moved_out():
    body = body_of(trimesh.creation.icosphere(3, radius=0.2))
    clear = clear_of_body(sheet(0.05, 0.05, 0.025), body, 0.003)
    assert body.signed_distance(clear.start).min() >= 0.003
    assert "starts inside the body" in clear.warnings[0]


@pytest.mark.parametrize("name", ["tshirt", "skirt", "trousers", "dress"])
@pytest.mark.parametrize("body", ["young", "middle_aged", "elderly"])
def test_builtin_garments_start_clear_of_the_builtin_bodies(name, body):
    scene = Scene.build(Pattern.load(name), Body.load(body), settings=Settings(spacing=0.05))
    assert not any("starts inside" in w for w in scene.warnings)
    assert scene.body is not None
    assert scene.body.signed_distance(scene.garment.start).min() >= 0.003


def test_refusals_are_one_base_error_of_one_line():
    for wrong in (
        lambda: Scene.build([]),
        lambda: settings_for("x"),
        lambda: Fabric.preset("x"),
        lambda: Settings(spacing=-1.0),
    ):
        with pytest.raises(ClothError) as caught:
            wrong()
        assert "\n" not in str(caught.value)
    with pytest.raises(GarmentError):
        Scene.build(pattern({"p": rectangle(0.1, 0.1)}), settings=Settings(spacing=1e-7))


def test_scene_is_plain_data_that_can_be_changed_by_a_copy():
    scene = Scene.build(pattern({"p": rectangle(0.1, 0.1)}), settings=DRAFT)
    other = replace(scene, gravity=(1.0, 2.0, 3.0))
    assert other.gravity == (1.0, 2.0, 3.0)
    assert scene.gravity[2] < 0
    with pytest.raises(AttributeError):
        scene.gravity = (0.0, 0.0, 0.0)


# ---- garments that start below the body


@pytest.mark.parametrize("garment", ["tshirt", "skirt", "trousers", "dress"])
def test_garment_whose_origin_is_not_on_the_ground_is_warned_about(garment):
    body = Body.load("young")
    at_home = Scene.build(Pattern.load(garment), body, settings=DRAFT)
    assert not any("below body" in line for line in at_home.warnings)
    lifted = Body.from_arrays(body.vertices + np.array([0.0, 0.0, 1.5]), body.triangles, "lifted")
    (line,) = (w for w in Scene.build(Pattern.load(garment), lifted, settings=DRAFT).warnings if "below body" in w)
    depth = 1.5 + body.vertices[:, 2].min() - at_home.garment.start[:, 2].min()
    assert f"body 'lifted', up to {depth:.2f} m below its lowest point" in line


def test_share_of_a_garment_that_starts_below_the_body():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    body = Body.from_arrays(ball.vertices + np.array([0.0, 0.0, 0.2]), ball.faces, "ball")

    def lines(height: float) -> list[str]:
        cloth = pattern({"p": rectangle(0.4, 1.0, at=(0, height, 1))})
        return [w for w in Scene.build(cloth, body, settings=Settings(spacing=0.02)).warnings if "below body" in w]

    lowest = pattern({"p": rectangle(0.4, 1.0, at=(0, 0, 1))}).panels["p"]
    bottom = float(lowest.to_world(lowest.vertices)[:, 2].min())
    assert lines(-bottom - 0.05) == []  # 5 % of it
    assert lines(-bottom - 0.29)[0].startswith(("29 % of the garment", "30 % of the garment"))
