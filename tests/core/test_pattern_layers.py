"""Several patterns in one text, as a message brings them: read, joined, and draped like the same ones given apart."""

import json
from pathlib import Path

import numpy as np
import pytest

from cloth_core.body import Body
from cloth_core.errors import PatternError
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene

NAMES = ("trousers", "tshirt")


def listed(*names: str, called: bool = True) -> str:
    entries = [json.loads(Pattern.load(name).source) for name in names]
    return json.dumps([{**e, "name": name} if called else e for name, e in zip(names, entries, strict=True)])


def test_list_of_patterns_is_read_in_its_order():
    text = listed(*NAMES)
    both = Pattern.from_json(text, "outfit")
    assert both.name == "outfit"
    assert both.source == text
    assert [layer.name for layer in both.layers] == list(NAMES)
    alone = [Pattern.load(name) for name in NAMES]
    assert list(both.panels) == [f"{p.name}/{key}" for p in alone for key in p.panels]
    assert [panel.name for panel in both.panels.values()] == list(both.panels)
    assert len(both.stitches) == sum(len(p.stitches) for p in alone)
    assert sum(panel.area for panel in both.panels.values()) == pytest.approx(
        sum(panel.area for p in alone for panel in p.panels.values())
    )


def test_scene_of_a_list_is_that_of_its_patterns():
    body = Body.load("young")
    one = Scene.build(Pattern.from_json(listed(*NAMES)), body, quality="draft")
    other = Scene.build([Pattern.load(name) for name in NAMES], body, quality="draft")
    np.testing.assert_array_equal(one.garment.start, other.garment.start)
    np.testing.assert_array_equal(one.garment.triangles, other.garment.triangles)
    assert one.garment.panel_names == other.garment.panel_names
    assert one.warnings == other.warnings


def test_combined_pattern_has_all_panels_and_seams_of_its_layers():
    both = Pattern.from_json(listed(*NAMES))
    whole = Garment.from_pattern(both, 0.05)
    apart = Garment.joined([Garment.from_pattern(layer, 0.05) for layer in both.layers])
    np.testing.assert_array_equal(whole.start, apart.start)
    np.testing.assert_array_equal(whole.merged_indices, apart.merged_indices)
    assert whole.panel_names == apart.panel_names


def test_patterns_without_a_name_or_with_the_same_one_are_told_apart():
    unnamed = Pattern.from_json(listed("tshirt", "tshirt", called=False), "message")
    assert [layer.name for layer in unnamed.layers] == ["message 1", "message 2"]
    same = Pattern.from_json(listed("tshirt", "tshirt"))
    assert [layer.name for layer in same.layers] == ["tshirt", "tshirt 2"]
    scene = Scene.build([Pattern.load("tshirt"), Pattern.load("tshirt")], settings=None, quality="draft")
    assert len(set(scene.garment.panel_names)) == len(scene.garment.panel_names)


def test_list_of_one_is_that_one(tmp_path: Path):
    file = tmp_path / "outfit.json"
    file.write_text(listed("skirt"))
    scene = Scene.build(Pattern.load(file), quality="draft")
    np.testing.assert_array_equal(
        scene.garment.start, Scene.build(Pattern.load("skirt"), quality="draft").garment.start
    )


def test_fault_names_the_pattern_of_the_list():
    entries = json.loads(listed(*NAMES))
    panel = next(iter(entries[1]["pattern"]["panels"].values()))
    panel["edges"][0]["endpoints"] = [0, 99]
    with pytest.raises(PatternError, match=r"^pattern 2 of the list: panel 'front', edge 0"):
        Pattern.from_json(json.dumps(entries))
