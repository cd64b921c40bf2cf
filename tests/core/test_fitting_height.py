"""A garment whose pattern was placed for a taller or a shorter body starts where its shoulders are over the body's."""

import json

import numpy as np
import pytest
import trimesh

from cloth_core import fitting_height
from cloth_core.body import Body
from cloth_core.errors import SceneError
from cloth_core.fitting_height import fitting_lift
from cloth_core.garment import Garment
from cloth_core.gate import frame_movement, judge
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.start_around_body import started_around

GAP = 0.003


def placed(name: str, height: float, size: float = 1.0) -> Pattern:
    """A built-in pattern that was drawn for a body so much higher [m], all of it in another size."""
    content = json.loads(Pattern.load(name).source)
    for panel in content["pattern"]["panels"].values():
        panel["translation"][1] += 100.0 * height
        panel["translation"] = (size * np.array(panel["translation"])).tolist()
        panel["vertices"] = (size * np.array(panel["vertices"])).tolist()
    return Pattern.from_json(json.dumps(content), name)


def shoulders_through_body(garment: Garment, body: Body) -> int:
    """Straight lines along which the shoulder seams close that pass through the body, by another library."""
    seams = [s for s in garment.seams if "'front', edge 3 " in s.name or "'front', edge 6 " in s.name]
    assert len(seams) == 2
    first, second = (garment.start[np.concatenate([getattr(s, side) for s in seams])] for side in ("first", "second"))
    way = second - first
    mesh = trimesh.Trimesh(body.vertices, body.triangles, process=False)
    places, rays, _ = mesh.ray.intersects_location(first, way / np.linalg.norm(way, axis=1)[:, None])
    reached = np.linalg.norm(places - first[rays], axis=1) < np.linalg.norm(way, axis=1)[rays]
    return len(np.unique(rays[reached]))


@pytest.mark.parametrize("body", ["young", "middle_aged", "elderly"])
@pytest.mark.parametrize("name", ["tshirt", "dress", "skirt", "trousers"])
def test_a_pattern_that_fits_its_body_stays_where_it_is(name, body):
    assert fitting_lift(Pattern.load(name), Body.load(body), GAP) == 0.0


@pytest.mark.parametrize("body", ["young", "elderly"])
@pytest.mark.parametrize("name", ["tshirt", "dress"])
@pytest.mark.parametrize("height", [-0.3, -0.2, -0.1])
def test_what_starts_too_low_is_lifted_to_where_it_belongs(name, body, height):
    lift = fitting_lift(placed(name, height), Body.load(body), GAP)
    assert height + lift == pytest.approx(0.0, abs=0.04)


@pytest.mark.parametrize("body", ["young", "elderly"])
def test_what_starts_far_too_high_is_lowered(body):
    lift = fitting_lift(placed("tshirt", 0.3), Body.load(body), GAP)
    assert 0.3 + lift == pytest.approx(0.0, abs=0.06)


def test_a_doll_is_dressed_as_a_grown_woman_is():
    body = Body.load("young")
    doll = Body.from_arrays(0.2 * body.vertices, body.triangles)
    full, small = (fitting_lift(placed("tshirt", -0.2, size), b, size * GAP) for size, b in ((1.0, body), (0.2, doll)))
    assert full > 0.1
    assert small == pytest.approx(0.2 * full, abs=0.2 * 0.03)


def test_shoulders_are_clear_of_the_body():
    body, pattern = Body.load("young"), placed("tshirt", -0.2)
    low, scene = Scene.build(pattern, body, lifts=[0.0]), Scene.build(pattern, body)
    assert shoulders_through_body(low.garment, body) > 3
    assert shoulders_through_body(scene.garment, body) == 0
    assert scene.lifts[0] > 0.0
    line = (
        f"garment 'tshirt': starts {1000 * scene.lifts[0]:.0f} mm above where its pattern puts it, to fit body 'young'"
    )
    assert line in scene.warnings
    assert not any("where its pattern puts it" in line for line in low.warnings)


def test_it_starts_equally_high_at_any_spacing():
    scene = Scene.build(placed("tshirt", -0.1), Body.load("young"), quality="draft")
    finer = scene.with_spacing(0.5 * scene.settings.spacing)
    assert finer.lifts == scene.lifts
    assert finer.garment.start[:, 2].max() == pytest.approx(scene.garment.start[:, 2].max(), abs=1e-6)


def test_each_garment_is_moved_by_itself():
    trousers, body = Pattern.load("trousers"), Body.load("young")
    scene = Scene.build([placed("tshirt", -0.2), trousers], body, quality="draft")
    lift, of_trousers = scene.lifts
    assert lift > 0.1
    assert of_trousers == 0.0
    same = Scene.build([placed("tshirt", lift - 0.2), trousers], body, quality="draft", lifts=(0.0, 0.0))
    assert scene.garment.start == pytest.approx(same.garment.start, abs=1e-9)


def test_nothing_is_moved_that_is_pinned_or_has_no_body():
    pattern = placed("tshirt", -0.1)
    assert Scene.build(pattern, quality="draft").lifts == (0.0,)
    assert Scene.build(pattern, Body.load("young"), quality="draft", pins=[0]).lifts == (0.0,)


def test_a_search_that_takes_too_many_tests_moves_nothing(monkeypatch):
    monkeypatch.setattr(fitting_height, "_MOST_TESTS", 100)
    assert fitting_lift(placed("tshirt", -0.2), Body.load("young"), GAP) == 0.0


@pytest.mark.parametrize("body", [None, "young"])
def test_lifts_can_be_given(body):
    worn = None if body is None else Body.load(body)
    scene = Scene.build(Pattern.load("skirt"), worn, quality="draft", lifts=np.array([-0.05]))
    plain = Scene.build(Pattern.load("skirt"), worn, quality="draft")
    assert scene.lifts == (-0.05,)
    assert (scene.garment.start - plain.garment.start)[:, 2] == pytest.approx(-0.05, abs=1e-9)
    assert any("starts 50 mm below where its pattern puts it" in line for line in scene.warnings)


@pytest.mark.parametrize("places", [0, 1])
def test_where_it_cannot_be_put_is_no_place_for_it(monkeypatch, places):
    """Nowhere but at the heights below, or nowhere at all."""
    tried = []

    def refuses(garment, body, gap):
        tried.append(garment)
        if len(tried) == 1 or places == 0:
            raise SceneError("there is no room")
        return started_around(garment, body, gap)

    monkeypatch.setattr(fitting_height, "started_around", refuses)
    lift = fitting_lift(placed("tshirt", 0.3), Body.load("young"), GAP)
    assert len(tried) > 1
    assert 0.3 + lift == pytest.approx(0.0 if places else 0.3, abs=0.06)


@pytest.mark.parametrize("lifts", [[], [0.1, 0.1], [float("nan")], [float("inf")]])
def test_lifts_that_do_not_fit_are_refused(lifts):
    with pytest.raises(SceneError, match="are not 1 finite numbers; give one for each garment in m"):
        Scene.build(Pattern.load("tshirt"), Body.load("young"), quality="draft", lifts=lifts)


@pytest.mark.parametrize("height", [-0.2, 0.2])
def test_the_drape_is_that_of_a_garment_that_started_there(height):
    """Without the lift it hangs around the chest or is stuck on the head."""
    body, pattern = Body.load("young"), placed("tshirt", height)
    scenes = {
        "elsewhere": Scene.build(pattern, body, quality="draft", lifts=[0.0]),
        "lifted": Scene.build(pattern, body, quality="draft"),
        "fitting": Scene.build(Pattern.load("tshirt"), body, quality="draft"),
    }
    tops = {}
    for which, scene in scenes.items():
        simulation = Simulation(scene)
        report = simulation.settle()
        assert which == "elsewhere" or judge(report, frame_movement(simulation))["passed"]
        tops[which] = simulation.positions[:, 2].max()
    assert tops["lifted"] == pytest.approx(tops["fitting"], abs=0.01)
    assert abs(tops["elsewhere"] - tops["fitting"]) > 0.1
