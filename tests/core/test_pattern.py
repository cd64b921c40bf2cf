"""Reading of GarmentCode patterns: units, axes, curvature, normalisation flags, stitches, warnings and refusals."""

import copy
import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from malformed_patterns import MALFORMED, tube
from scipy.spatial.transform import Rotation

from cloth_core.curves import CircularArc, CubicBezier, Line, QuadraticBezier
from cloth_core.errors import PatternError
from cloth_core.pattern import Pattern, builtin_patterns
from cloth_core.pattern_checks import start_distances


def read(data) -> Pattern:
    return Pattern.from_json(json.dumps(data))


def with_curvature(curvature, **properties) -> Pattern:
    """The tube with a curved edge 2 of its front panel, which runs from (20, 40) to (-20, 40) cm."""
    data = tube(**properties)
    data["pattern"]["panels"]["front"]["edges"][2]["curvature"] = curvature
    return read(data)


def seam_points(pattern: Pattern, stitch) -> list[tuple]:
    """World positions (rounded) that the stitch joins, at the two ends and the middle of the seam."""
    first, second = pattern.panels[stitch.first.panel], pattern.panels[stitch.second.panel]
    a = first.to_world(first.edges[stitch.first.edge].sample(3))
    b = second.to_world(second.edges[stitch.second.edge].sample(3))
    if stitch.start_meets_end:
        b = b[::-1]
    return sorted(sorted([tuple(np.round(p, 9) + 0.0), tuple(np.round(q, 9) + 0.0)]) for p, q in zip(a, b, strict=True))


def reversed_loop(panel, first=0):
    """The panel of a file with its loop the other way round, starting at another edge; new place of each edge."""
    count = len(panel["edges"])
    order = [(first - i) % count for i in range(count)]
    edges = [copy.deepcopy(panel["edges"][i]) for i in order]
    for edge in edges:
        edge["endpoints"].reverse()
        if "curvature" in edge:  # of type quadratic
            (x, y), *_ = edge["curvature"]["params"]
            edge["curvature"]["params"] = [[1 - x, -y]]
    return panel | {"edges": edges}, {old: new for new, old in enumerate(order)}


# ---- a good pattern


def test_world_is_z_up_in_metres_with_the_front_at_negative_y():
    pattern = read(tube())
    front, back = pattern.panels["front"], pattern.panels["back"]
    assert np.allclose(front.to_world([[-0.2, 0.0], [0.2, 0.4]]), [[-0.2, -0.2, 1.0], [0.2, -0.2, 1.4]])
    assert np.allclose(back.to_world([[-0.2, 0.0], [0.2, 0.4]]), [[0.2, 0.2, 1.0], [-0.2, 0.2, 1.4]])
    assert np.array_equal(front.normal, [0.0, -1.0, 0.0])
    assert np.array_equal(back.normal, [0.0, 1.0, 0.0])
    assert front.area == pytest.approx(0.16, rel=1e-14)
    assert pattern.warnings == ()


@pytest.mark.parametrize("units", [1, 39.37, 100, 1000])
def test_every_unit_gives_the_same_garment(units):
    data = tube(units_in_meter=units)
    arc = {"type": "circle", "params": [30 * units / 100, 0, 1]}
    for panel in data["pattern"]["panels"].values():
        panel["vertices"] = [[x * units / 100, y * units / 100] for x, y in panel["vertices"]]
        panel["translation"] = [x * units / 100 for x in panel["translation"]]
        panel["edges"][2]["curvature"] = arc
    for panel, expected in zip(read(data).panels.values(), [(-0.2, 1.0), (0.2, 1.0)], strict=True):
        world = panel.to_world(panel.vertices)
        assert np.allclose(world[0, [0, 2]], expected)
        assert panel.edges[2].length == pytest.approx(0.3 * 2.0 * math.asin(2.0 / 3.0), rel=1e-12)


def test_clockwise_loop_has_negative_area_and_faces_the_other_way():
    data = tube()
    data["pattern"]["stitches"] = []
    panels = data["pattern"]["panels"]
    panels["front"], _ = reversed_loop(panels["front"])
    front = read(data).panels["front"]
    assert front.area == pytest.approx(-0.16, rel=1e-14)
    assert np.array_equal(front.normal, [0.0, 1.0, 0.0])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("degrees", [90.0, -50.483, 180.0, 725.5])
def test_rotation_about_one_axis_is_unambiguous(axis, degrees):
    data = tube()
    rotation = [0.0, 0.0, 0.0]
    rotation[axis] = degrees
    data["pattern"]["panels"]["front"] |= {"rotation": rotation, "translation": [1, 2, 3]}
    data["pattern"]["stitches"] = []
    pattern = read(data)
    x, y, z = Rotation.from_euler("xyz"[axis], degrees, degrees=True).apply([20.0, 40.0, 0.0]) + np.array([1, 2, 3])
    assert np.allclose(pattern.panels["front"].to_world([[0.2, 0.4]]), [[x / 100, -z / 100, y / 100]], atol=1e-15)
    assert pattern.warnings == ()


def test_rotation_about_several_axes_is_rx_ry_rz_with_a_warning():
    data = tube()
    data["pattern"]["panels"]["front"] |= {"rotation": [10, 20, 30], "translation": [0, 0, 0]}
    data["pattern"]["stitches"] = []
    pattern = read(data)
    x, y, z = Rotation.from_euler("XYZ", [10, 20, 30], degrees=True).apply([0.2, 0.4, 0.0])
    assert np.allclose(pattern.panels["front"].to_world([[0.2, 0.4]]), [[x, -z, y]], atol=1e-15)
    assert len(pattern.warnings) == 1
    assert "panel 'front': rotation [10.0, 20.0, 30.0] is about more than one axis" in pattern.warnings[0]


def test_names_labels_order_and_source_are_kept_and_the_unknown_is_ignored():
    data = tube(author="somebody")
    data |= {"parameters": {"length": {"value": float("nan")}}, "parameter_order": ["length"]}
    data["pattern"]["panel_order"] = ["back", "front"]
    front = data["pattern"]["panels"]["front"]
    front["label"] = "body"
    front["edges"][0]["label"] = "lower_interface"
    front["edges"][1]["label"] = ""
    text = json.dumps(data)
    pattern = Pattern.from_json(b"\xef\xbb\xbf" + text.encode(), name="shirt")
    assert pattern.name == "shirt"
    assert pattern.source == text
    assert list(pattern.panels) == ["back", "front"]
    assert pattern.panels["front"].label == "body"
    assert [edge.label for edge in pattern.panels["front"].edges] == ["lower_interface", None, None, None]


def test_panels_missing_in_the_order_come_last_with_a_warning():
    data = tube()
    data["pattern"]["panel_order"] = ["back"]
    pattern = read(data)
    assert list(pattern.panels) == ["back", "front"]
    assert pattern.warnings == ("panel_order lacks 'front'; taken after the others",)


def test_vertices_of_no_edge_are_left_out_with_a_warning():
    data = tube()
    front = data["pattern"]["panels"]["front"]
    front["vertices"].insert(1, [7, 7])
    for edge in front["edges"]:
        edge["endpoints"] = [i + (i > 0) for i in edge["endpoints"]]
    pattern = read(data)
    assert np.allclose(pattern.panels["front"].vertices, read(tube()).panels["front"].vertices)
    assert [(edge.start, edge.end) for edge in pattern.panels["front"].edges] == [(0, 1), (1, 2), (2, 3), (3, 0)]
    assert pattern.warnings == ("panel 'front': no edge uses vertex 1; left out",)


def test_pattern_without_stitches_is_one_of_loose_panels():
    data = tube()
    del data["pattern"]["stitches"]
    assert read(data).stitches == ()


# ---- curvature


def test_edge_without_curvature_is_straight():
    assert with_curvature(None).panels["front"].edges[2].curve == Line((0.2, 0.4), (-0.2, 0.4))


@pytest.mark.parametrize("curvature", [[0.25, -0.5], {"type": "quadratic", "params": [[0.25, -0.5]]}])
def test_relative_control_point_is_in_the_frame_of_the_edge(curvature):
    # the edge runs to -x, so its left is -y: a quarter along, and half its length to the right, which is up
    curve = with_curvature(curvature).panels["front"].edges[2].curve
    assert isinstance(curve, QuadraticBezier)
    assert curve.control == pytest.approx((0.1, 0.6), abs=1e-15)


def test_relative_control_points_of_a_cubic():
    curve = with_curvature({"type": "cubic", "params": [[0.25, -0.5], [0.75, 0.25]]}).panels["front"].edges[2].curve
    assert isinstance(curve, CubicBezier)
    assert curve.first_control == pytest.approx((0.1, 0.6), abs=1e-15)
    assert curve.second_control == pytest.approx((-0.1, 0.3), abs=1e-15)


@pytest.mark.parametrize(
    ("absolute", "relative"),
    [
        ([10, 60], [0.25, -0.5]),
        ({"type": "quadratic", "params": [[10, 60]]}, {"type": "quadratic", "params": [[0.25, -0.5]]}),
        ({"type": "cubic", "params": [[10, 60], [-10, 30]]}, {"type": "cubic", "params": [[0.25, -0.5], [0.75, 0.25]]}),
        ({"type": "circle", "params": [30, 0, 1]}, {"type": "circle", "params": [30, 0, 1]}),
    ],
)
@pytest.mark.parametrize("centred", [False, True])
def test_absolute_control_points_are_panel_coordinates_in_file_units(absolute, relative, centred):
    one = with_curvature(absolute, curvature_coords="absolute", normalize_panel_translation=centred)
    other = with_curvature(relative, normalize_panel_translation=centred)
    for ours, theirs in zip(one.panels["front"].edges, other.panels["front"].edges, strict=True):
        assert np.allclose(ours.sample(9), theirs.sample(9), rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(("large_arc", "right"), [(0, 1), (0, 0), (1, 1), (False, True)])
def test_arc_bulges_to_the_side_that_its_flag_says(large_arc, right):
    curve = with_curvature({"type": "circle", "params": [25, large_arc, right]}).panels["front"].edges[2].curve
    assert isinstance(curve, CircularArc)
    sagitta = 0.25 + 0.15 if large_arc else 0.25 - 0.15  # the 3-4-5 triangle of half chord and radius
    assert curve.point(0.5) == pytest.approx((0.0, 0.4 + sagitta if right else 0.4 - sagitta), abs=1e-15)


def test_radius_that_rounding_made_too_small_is_a_half_circle():
    edge = with_curvature({"type": "circle", "params": [20 - 1e-5, 0, 1]}).panels["front"].edges[2]
    assert edge.length == pytest.approx(0.2 * math.pi, rel=1e-12)


def test_area_of_a_curved_panel_is_exact():
    panel = with_curvature({"type": "circle", "params": [20, 0, 1]}).panels["front"]
    assert panel.area == pytest.approx(0.16 + 0.5 * math.pi * 0.2**2, rel=1e-14)


def test_curves_that_meet_at_a_sharp_tip_are_no_crossing():
    # a crescent: arcs of almost the same radius, which meet at an angle of less than a degree
    data = tube()
    data["pattern"]["stitches"] = []
    front = data["pattern"]["panels"]["front"]
    sag = 21 * (1 - math.cos(math.asin(20 / 21)))
    front["vertices"] = [[0, 0], [20, -sag], [40, 0]]
    front["edges"] = [
        {"endpoints": [0, 1], "curvature": {"type": "circle", "params": [21, 0, 1]}},
        {"endpoints": [1, 2], "curvature": {"type": "circle", "params": [21, 0, 1]}},
        {"endpoints": [2, 0], "curvature": {"type": "circle", "params": [21.01, 0, 0]}},
    ]

    def segment(radius):
        angle = 2.0 * math.asin(20 / radius)
        return 0.5 * radius**2 * (angle - math.sin(angle))

    assert read(data).panels["front"].area == pytest.approx((segment(21) - segment(21.01)) / 1e4, rel=1e-9)


# ---- normalisation flags


def test_normalised_translation_centres_the_vertices_and_moves_the_offset_to_the_translation():
    data = tube(normalize_panel_translation=True)
    plain = read(tube()).panels["front"]
    centred = read(data).panels["front"]
    assert np.allclose(centred.vertices.mean(axis=0), 0.0, atol=1e-15)
    assert np.allclose(centred.to_world(centred.vertices), plain.to_world(plain.vertices), atol=1e-15)
    assert np.allclose(centred.edges[1].sample(5), plain.edges[1].sample(5) - (0.0, 0.2), atol=1e-15)
    assert np.allclose(centred.translation, [0.0, -0.2, 1.2])


def unlike_panels(**properties):
    """The tube with a front whose four edges all differ, so that mixing them up shows."""
    data = tube(**properties)
    front = data["pattern"]["panels"]["front"]
    front["vertices"] = [[-22, -1], [18, 0], [20, 40], [-20, 38]]
    front["edges"][1]["curvature"] = {"type": "quadratic", "params": [[0.3, 0.1]]}
    return data


def test_loop_that_starts_elsewhere_starts_at_the_lower_left_and_stitches_follow():
    expected = read(unlike_panels())
    data = unlike_panels(normalized_edge_loops=False)
    front = data["pattern"]["panels"]["front"]
    front["edges"] = front["edges"][3:] + front["edges"][:3]
    for stitch in data["pattern"]["stitches"]:
        stitch[0]["edge"] = (stitch[0]["edge"] + 1) % 4
    pattern = read(data)
    assert pattern.panels["front"].edges[0].start == 0
    assert [edge.file_index for edge in pattern.panels["front"].edges] == [1, 2, 3, 0]
    assert pattern.stitches == expected.stitches
    assert [edge.curve for edge in pattern.panels["front"].edges] == [
        edge.curve for edge in expected.panels["front"].edges
    ]


@pytest.mark.parametrize("names", [("front",), ("back",), ("front", "back")])
def test_reversed_loops_are_made_counter_clockwise_and_stitches_follow(names):
    expected = read(unlike_panels())
    data = unlike_panels(normalized_edge_loops=False)
    panels = data["pattern"]["panels"]
    for name in names:
        panels[name], place = reversed_loop(panels[name], first=2)
        for stitch in data["pattern"]["stitches"]:
            for side in stitch:
                if side["panel"] == name:
                    side["edge"] = place[side["edge"]]
    pattern = read(data)
    assert pattern.warnings == ()
    for name, panel in pattern.panels.items():
        assert panel.area == pytest.approx(expected.panels[name].area, rel=1e-14)
        assert np.allclose(panel.normal, expected.panels[name].normal)
        assert panel.edges[0].start == 0
        for edge, same in zip(panel.edges, expected.panels[name].edges, strict=True):
            assert np.allclose(edge.sample(5), same.sample(5), rtol=0.0, atol=1e-12)
    for stitch, same in zip(pattern.stitches, expected.stitches, strict=True):
        assert seam_points(pattern, stitch) == seam_points(expected, same)


def test_panel_drawn_from_its_other_side_is_turned_over_in_place():
    # a back that is not rotated but drawn clockwise, so that its seams run against those of the front
    data = unlike_panels()
    back = data["pattern"]["panels"]["back"] | {"rotation": [0, 0, 0]}
    back["edges"][2]["curvature"] = {"type": "quadratic", "params": [[0.3, 0.1]]}
    data["pattern"]["panels"]["back"], place = reversed_loop(back)
    for stitch in data["pattern"]["stitches"]:
        stitch[1]["edge"] = place[{1: 3, 3: 1}[stitch[1]["edge"]]]
    as_drawn = read(data)
    assert as_drawn.warnings == ()
    data["properties"]["normalized_edge_loops"] = False
    pattern = read(data)
    assert pattern.warnings == ()
    drawn, turned = as_drawn.panels["back"], pattern.panels["back"]
    assert turned.area == pytest.approx(-drawn.area, rel=1e-14)
    assert turned.area > 0.0
    assert np.array_equal(turned.normal, [0.0, 1.0, 0.0])
    assert np.allclose(turned.vertices[turned.edges[0].start], turned.vertices.min(axis=0))
    for edge in turned.edges:
        same = drawn.edges[edge.file_index]
        assert np.allclose(turned.to_world(edge.sample(5)), drawn.to_world(same.sample(5)), rtol=0.0, atol=1e-12)
    for stitch, same in zip(pattern.stitches, as_drawn.stitches, strict=True):
        assert seam_points(pattern, stitch) == seam_points(as_drawn, same)


# ---- stitches


def test_start_meets_end_unless_right_wrong():
    data = tube()
    assert [stitch.start_meets_end for stitch in read(data).stitches] == [True, True]
    for flag, expected in [("right_wrong", False), (True, False), (False, True)]:
        turned = copy.deepcopy(data)
        del turned["pattern"]["stitches"][1]
        turned["pattern"]["stitches"][0].append(flag)
        assert [stitch.start_meets_end for stitch in read(turned).stitches] == [expected]


def with_dart() -> dict:
    """The tube with a dart in the bottom of its front, 4 cm wide and 12 cm deep."""
    data = tube()
    front = data["pattern"]["panels"]["front"]
    front["vertices"] = [[-20, 0], [-2, 0], [0, 12], [2, 0], [20, 0], [20, 40], [-20, 40]]
    front["edges"] = [{"endpoints": [i, (i + 1) % 7]} for i in range(7)]
    data["pattern"]["stitches"] = [
        [{"panel": "front", "edge": 1}, {"panel": "front", "edge": 2}],
        [{"panel": "front", "edge": 4}, {"panel": "back", "edge": 3}],
        [{"panel": "front", "edge": 6}, {"panel": "back", "edge": 1}],
    ]
    return data


def test_dart_is_a_stitch_within_one_panel():
    pattern = read(with_dart())
    assert pattern.warnings == ()
    assert pattern.panels["front"].area == pytest.approx(0.16 - 0.04 * 0.12 / 2, rel=1e-13)
    tip = [points for points in seam_points(pattern, pattern.stitches[0]) if points[0] == points[1]]
    assert len(tip) == 1


def test_dart_with_right_wrong_would_join_the_ends_of_its_edges():
    data = with_dart()
    data["pattern"]["stitches"][0].append("right_wrong")
    with pytest.raises(PatternError, match=r"panel 'front', edge 1: sewing would join .* of stitch 0"):
        read(data)


def test_tube_of_one_panel_may_have_a_ring_for_a_hem():
    data = tube()
    del data["pattern"]["panels"]["back"]
    data["pattern"]["stitches"] = [[{"panel": "front", "edge": 1}, {"panel": "front", "edge": 3}]]
    pattern = read(data)
    assert len(pattern.stitches) == 1


def test_corner_that_several_seams_share():
    # the upper edges of a tube, halved, sewn to two sleeves: four panels meet in each corner of the seam
    data = tube()
    panels = data["pattern"]["panels"]
    for name in ("front", "back"):
        panels[name + "_top"] = copy.deepcopy(panels[name])
        panels[name + "_top"]["translation"][1] += 40
        data["pattern"]["stitches"].append([{"panel": name, "edge": 2}, {"panel": name + "_top", "edge": 0}])
    data["pattern"]["stitches"] += [
        [{"panel": "front_top", "edge": 1}, {"panel": "back_top", "edge": 3}],
        [{"panel": "front_top", "edge": 3}, {"panel": "back_top", "edge": 1}],
    ]
    pattern = read(data)
    assert len(pattern.stitches) == 6
    assert pattern.warnings == ()


def test_seam_of_very_different_lengths_is_warned_about():
    data = tube()
    data["pattern"]["panels"]["front"]["vertices"][2:] = [[20, 65], [-20, 40]]
    warnings = read(data).warnings
    assert len(warnings) == 1
    assert "stitch 0 (panel 'front', edge 1 and panel 'back', edge 3): lengths 0.65 m and 0.4 m differ" in warnings[0]


def test_twisted_seam_is_warned_about():
    data = tube()
    stitches = data["pattern"]["stitches"]
    stitches[:] = [[*stitches[0], "right_wrong"]]
    (warning,) = read(data).warnings
    assert "stitch 0 (panel 'front', edge 1 and panel 'back', edge 3): seems twisted" in warning
    assert "perhaps 'right_wrong' is one too many" in warning

    data["pattern"]["panels"]["back"]["rotation"] = [0, 0, 0]  # then the edge over there is 1, and runs up like ours
    stitches[:] = [[{"panel": "front", "edge": 1}, {"panel": "back", "edge": 1}]]
    (warning,) = read(data).warnings
    assert "stitch 0 (panel 'front', edge 1 and panel 'back', edge 1): seems twisted" in warning
    assert "perhaps 'right_wrong' is missing" in warning

    stitches[0].append("right_wrong")
    assert read(data).warnings == ()


def wrapped(*, wrong: bool = False) -> dict:
    """A skirt whose front goes 2 cm round to the back, under a bodice: the narrow edge there runs the other way."""

    def box(width: float, height: float, x: float, y: float, z: float, top: list[float], bottom: list[float]) -> dict:
        corners = [[c, 0.0] for c in (0.0, *bottom, width)] + [[c, height] for c in (width, *reversed(top), 0.0)]
        edges = [{"endpoints": [k, (k + 1) % len(corners)]} for k in range(len(corners))]
        return {"translation": [x, y, z], "rotation": [0, 0, 0], "vertices": corners, "edges": edges}

    def turned(panel: dict) -> dict:
        """The same seen from behind: the loop the other way round."""
        edges = [{"endpoints": e["endpoints"][::-1]} for e in reversed(panel["edges"])]
        return panel | {"edges": edges}

    panels = {
        "bodice_front": box(40, 40, -20, 100, 30, [], []),
        "bodice_back": turned(box(40, 40, -20, 100, -25, [], [38])),
        "skirt_front": box(42, 60, -20, 30, 30, [40], []),
        "skirt_back": turned(box(38, 60, -20, 30, -25, [], [])),
    }
    # Loops of the backs are reversed: edge k of n becomes edge n - 1 - k.
    stitches: list[list] = [
        [{"panel": "bodice_front", "edge": 1}, {"panel": "bodice_back", "edge": 2}],
        [{"panel": "bodice_front", "edge": 3}, {"panel": "bodice_back", "edge": 0}],
        [{"panel": "bodice_front", "edge": 0}, {"panel": "skirt_front", "edge": 3}],
        [{"panel": "bodice_back", "edge": 4}, {"panel": "skirt_back", "edge": 1}],
        [{"panel": "bodice_back", "edge": 3}, {"panel": "skirt_front", "edge": 2}],
        [{"panel": "skirt_front", "edge": 4}, {"panel": "skirt_back", "edge": 0}],
    ]
    if wrong:
        stitches[4].append("right_wrong")
    return {
        "pattern": {"panels": panels, "stitches": stitches},
        "properties": {"units_in_meter": 100, "curvature_coords": "relative", "normalize_panel_translation": False,
                       "normalized_edge_loops": True},
    }  # fmt: skip


def test_edge_that_goes_round_the_body_is_not_taken_for_twisted():
    # By the distances at the start alone it would be: the other stitches show where its ends belong.
    pattern = read(wrapped())
    given, flipped = start_distances(pattern.panels, pattern.stitches[4])
    assert given > flipped
    assert not any("twisted" in line for line in pattern.warnings)
    with pytest.raises(PatternError, match=r"edge 3: sewing would join its two ends.*stitch 0 and 3 and 4"):
        read(wrapped(wrong=True))


# ---- loading


def test_file_is_loaded_under_its_stem(tmp_path):
    path = tmp_path / "tube_specification.json"
    path.write_text(json.dumps(tube()), encoding="utf-8")
    assert Pattern.load(path).name == "tube"
    assert Pattern.load(str(path)).source == path.read_text(encoding="utf-8")


def test_malformed_file_is_named(tmp_path):
    path = tmp_path / "bad.json"
    path.write_text("{", encoding="utf-8")
    with pytest.raises(PatternError, match=r"bad\.json: not JSON"):
        Pattern.load(path)


def test_unknown_name_lists_the_built_in_patterns(tmp_path):
    with pytest.raises(PatternError) as caught:
        Pattern.load("no_such_garment")
    assert "no pattern file or built-in pattern 'no_such_garment'" in str(caught.value)
    assert all(name in str(caught.value) for name in builtin_patterns())


def test_directory_and_overlong_file_and_impossible_path_are_refused(tmp_path):
    with pytest.raises(PatternError, match="is not a file"):
        Pattern.load(tmp_path)
    path = tmp_path / "long.json"
    with path.open("wb") as file:
        file.truncate(4 * 1024 * 1024 + 1)
    with pytest.raises(PatternError, match="more than 4 MiB"):
        Pattern.load(path)
    for name in ("a\0b", "x" * 5000, os.devnull):
        with pytest.raises(PatternError):
            Pattern.load(name)


def test_built_in_patterns_load_without_a_warning():
    names = builtin_patterns()
    assert names == sorted(names)
    for name in names:
        pattern = Pattern.load(name)
        assert pattern.name == name
        assert pattern.warnings == ()


def test_import_is_cheap():
    code = "import sys, cloth_core.pattern_reader; print('scipy' in sys.modules, 'shapely' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False False\n"


# ---- malformed


@pytest.mark.parametrize("what", MALFORMED)
def test_malformed_pattern_is_refused_in_one_line_that_says_what_is_wrong(what):
    text, message = MALFORMED[what]
    with pytest.raises(PatternError) as caught:
        Pattern.from_json(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from([0, 1, -1, 1e9, 10**400, "", "front", "right_wrong", "cubic", "circle"])
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def full_pattern():
    """A pattern that uses every part of the format."""
    data = with_dart()
    data["pattern"]["panel_order"] = ["back", "front"]
    data["properties"] |= {"normalize_panel_translation": False, "normalized_edge_loops": False}
    edges = data["pattern"]["panels"]["back"]["edges"]
    edges[0] |= {"curvature": [0.5, 0.1], "label": "hem"}
    edges[1]["curvature"] = {"type": "cubic", "params": [[0.3, 0.1], [0.6, 0.1]]}
    edges[2]["curvature"] = {"type": "circle", "params": [30, 0, 1]}
    return data


def places(value, path=()):
    yield path
    if isinstance(value, (dict, list)):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*path, key))


def outcome(text):
    """The pattern read from the text and "", or None and the message of its refusal."""
    try:
        return Pattern.from_json(text), ""
    except PatternError as error:
        return None, str(error)


PLACES = [path for path in places(full_pattern()) if path]


def test_the_full_pattern_is_good():
    assert len(read(full_pattern()).stitches) == 3


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(PLACES), st.sampled_from(["replace", "delete", "repeat"]), json_values), max_size=3
    )
)
def test_mutated_patterns_raise_nothing_but_pattern_errors(mutations):
    data = full_pattern()
    for path, kind, value in mutations:
        try:
            parent = data
            for key in path[:-1]:
                parent = parent[key]
            if kind == "delete":
                del parent[path[-1]]
            elif kind == "repeat" and isinstance(parent, list):
                parent.append(parent[path[-1]])
            else:
                parent[path[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # an earlier mutation took that place away
    pattern, message = outcome(json.dumps(data))
    assert "\n" not in message
    if pattern is not None:
        for panel in pattern.panels.values():
            assert np.isfinite(panel.to_world(panel.vertices)).all()
            assert all(math.isfinite(edge.length) and edge.length > 0.0 for edge in panel.edges)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=60), st.integers(0, 2000), st.integers(0, 60))
def test_arbitrary_bytes_raise_nothing_but_pattern_errors(noise, position, cut):
    text = json.dumps(full_pattern()).encode()
    position %= len(text)
    for garbage in (noise, text[:position] + noise + text[position + cut :]):
        _, message = outcome(garbage)
        assert "\n" not in message
