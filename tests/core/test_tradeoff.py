"""What a trade-off concludes, from runs whose errors and costs are known; and the command, end to end."""

import json
import math
import re
from dataclasses import asdict, replace

import numpy as np
import pytest

from cloth_core.drape_error import Drape
from cloth_core.errors import ClothError, SimulationError
from cloth_core.measured_run import MeasuredRun, RunRequest, measure
from cloth_core.quality import Settings
from cloth_core.scene_recipe import SceneRecipe
from cloth_core.tradeoff import DIALS, evaluate, front, plan_tradeoff
from cloth_core.tradeoff_files import as_dict, as_markdown, write_tradeoff
from cloth_sim_ros.command_line import main

RECIPE = SceneRecipe(("rectangle",))
SPACINGS = (0.04, 0.02, 0.01)
SAFETY = next(dial for dial in DIALS if dial.name == "safety")


def level_sheet(z: float) -> Drape:
    corners = np.array([[0, 0, z], [0.1, 0, z], [0.1, 0.1, z], [0, 0.1, z]])
    return Drape.of_surface(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))


def run_of(request: RunRequest, height: float, cpu: float, failed: str | None = None) -> MeasuredRun:
    """A sheet that came to rest at a height [m]: the distance of two runs is the difference of their heights."""
    facts = {
        "scene_name": RECIPE.name,
        "settings": asdict(request.settings),
        "cpu_seconds": cpu,
        "wall_seconds": 1.1 * cpu,
        "load": 0.5,
        "failed": failed,
        "particles": 4,
        "steps": 10,
    }
    frames = tuple(level_sheet(height) for _ in request.times or (0.0,))
    return MeasuredRun(facts, frames)


def tradeoff_of(height, cpu=lambda r: r.settings.spacing**-3, failed=lambda r: None, dials=(SAFETY,)):
    plan = plan_tradeoff(RECIPE, spacings=SPACINGS, dials=dials)
    return evaluate(plan, [run_of(r, height(r), cpu(r), failed(r)) for r in plan.requests])


def first_order(request: RunRequest) -> float:
    """Error 0.1 h at rest, and of the motion 2 mm times the share of the stable step; the start matters by 0.2 mm."""
    if request.times:
        return 0.002 * request.settings.safety
    return 0.1 * request.settings.spacing + 0.0002 * (request.seed == 1)


def test_errors_are_distances_to_the_finest():
    found = tradeoff_of(first_order)
    assert found.reference_spacing == 0.01
    errors = {r.name: r.error for r in found.results}
    assert errors["spacing 40 mm"] == pytest.approx(0.003)
    assert errors["spacing 20 mm"] == pytest.approx(0.001)
    assert "spacing 10 mm" not in errors
    assert errors["spacing 20 mm, safety 0.5"] == pytest.approx(0.001)


def test_orders_and_what_the_reference_lacks():
    found = tradeoff_of(first_order)
    assert found.spacing_convergence.order == pytest.approx(1.0, abs=0.1)
    assert found.reference_left == pytest.approx(0.001, rel=0.1)
    assert found.time_step_convergence.order == pytest.approx(1.0, abs=0.02)


def test_spread_is_that_of_starts_and_of_spacings():
    found = tradeoff_of(first_order)
    # Of four starts one is 0.2 mm off: three of six pairs.
    assert found.spread_of_starts == pytest.approx(0.0002 * np.sqrt(3 / 6))
    # 2 % of 20 mm to either side, times 0.1: pairs 0.04, 0.04 and 0.08 mm apart.
    assert found.spread_of_spacings == pytest.approx(1e-5 * np.sqrt((16 + 16 + 64) / 3))
    assert found.spread == found.spread_of_starts


def test_stated_error_has_what_the_reference_lacks_and_is_at_least_the_spread():
    found = tradeoff_of(first_order)
    middle = next(r for r in found.results if r.name == "spacing 20 mm")
    assert found.bound(middle) == pytest.approx(middle.error + found.reference_left)
    chance = tradeoff_of(lambda r: 0.004 * (r.seed == 1))
    assert all(chance.bound(r) == chance.spread > 0.001 for r in chance.results)


def test_what_is_nearer_by_chance_is_not_said_to_be():
    # 20 mm came out worse than 40 mm, and 40 mm with the dial turned better by less than the spread, or by more.
    heights = {0.04: 0.005, 0.02: 0.006, 0.01: 0.0}

    def chance(gain):
        def height(request):
            turned = gain if request.settings.safety == 0.5 else 0.0
            return heights.get(request.settings.spacing, 0.006) + 0.003 * (request.seed == 1) - turned

        return height

    for gain, turned in ((0.001, 0.006), (0.004, 0.001)):
        found = tradeoff_of(chance(gain))
        assert 0.001 < found.spread < 0.004
        assert found.reference_left == 0.0
        stated = {r.name: found.bound(r) for r in found.results}
        assert stated["spacing 20 mm"] == pytest.approx(0.006)
        assert stated["spacing 40 mm"] == pytest.approx(0.006)
        assert stated["spacing 40 mm, safety 0.5"] == pytest.approx(max(turned, found.spread))
        chosen = "spacing 40 mm" + (", safety 0.5" if gain > found.spread else "")
        assert found.cheapest(0.0065).name == "spacing 40 mm"
        assert [r.name for r in found.results if r.on_front] == [chosen]


def test_advice_is_the_cheapest_that_is_good_enough():
    def cost(request):
        return request.settings.spacing**-3 * (0.5 if request.settings.safety == 0.5 else 1.0)

    found = tradeoff_of(first_order, cost)
    assert found.cheapest(0.0045).name == "spacing 40 mm, safety 0.5"
    assert found.cheapest(0.0025).name == "spacing 20 mm, safety 0.5"
    assert found.cheapest(0.0015) is None
    assert "cheapest setting is spacing 20 mm, safety 0.5" in found.advice(0.0025)
    assert "none of the settings tried meets it" in found.advice(0.0015)
    assert all("\n" not in found.advice(t) for t in (None, 0.0045, 0.0015, 1e-6))


def test_no_tolerance_below_the_spread_is_promised():
    found = tradeoff_of(lambda r: 0.004 * (r.seed == 1))
    assert "no setting can promise less" in found.advice(0.5 * found.spread)
    assert "no setting can promise less" not in found.advice(1.1 * found.spread)


def test_front_has_what_nothing_cheaper_equals():
    points = [(1.0, 5.0), (2.0, 5.0), (2.0, 3.0), (3.0, 4.0), (4.0, 1.0), (0.5, math.inf), (4.0, 0.9)]
    naive = {
        i
        for i, (c, e) in enumerate(points)
        if e < math.inf and not any(c2 <= c and e2 <= e and (c2, e2) != (c, e) for c2, e2 in points)
    }
    assert front([(*point, 1) for point in points]) == naive == {0, 2, 6}


def test_noise_of_processor_time_and_chance_put_nothing_on_the_front():
    # 8 % cheaper with a dial turned: not to be told apart from the plain setting. 40 % cheaper: it is.
    assert front([(0.92, 5.0, 2), (1.0, 5.0, 1)]) == {1}
    assert front([(0.60, 5.0, 2), (1.0, 5.0, 1)]) == {0}
    # Of the same cost and a smaller stated error is a reason.
    assert front([(1.0, 4.0, 2), (1.0, 5.0, 1)]) == {0}

    def cost(request):
        return request.settings.spacing**-3 * (0.93 if request.settings.safety == 0.5 else 1.0)

    def chance(request):  # all errors are below the spread, and smaller where it costs more
        return 0.004 * (request.seed == 1) + 0.03 * request.settings.spacing

    found = tradeoff_of(chance, cost)
    assert found.spread > max(r.error for r in found.results)
    assert [r.name for r in found.results if r.on_front] == ["spacing 40 mm"]
    for tolerance in (None, 0.003):
        advice = found.advice(tolerance)
        assert "spacing 40 mm, error " in advice
        assert "nothing dearer is measurably nearer" in advice
        assert advice.endswith("in Python Settings(spacing=0.04)")
    assert "nothing dearer" not in tradeoff_of(first_order, cost).advice(0.0045)
    # Without an order nothing is said to be left.
    text = as_markdown(found)
    assert "- Spacing: no order can be told" in text or "- Spacing: the distances follow no power" in text
    assert "left at the finest" not in text.split("- Spacing: ")[1].split("\n")[0]


def test_run_without_rest_is_listed_with_its_reason_and_never_advised():
    found = tradeoff_of(first_order, failed=lambda r: "fell off" if r.settings.safety == 0.5 else None)
    lost = [r for r in found.results if r.failed]
    assert {r.name for r in lost} == {"spacing 40 mm, safety 0.5", "spacing 20 mm, safety 0.5"}
    assert all(r.error is None and not r.on_front for r in lost)
    assert list(found.results[-2:]) == lost  # behind those that have an error, however cheap
    assert "fell off" in as_markdown(found)
    json.dumps(as_dict(found, 0.003), allow_nan=False)


def test_reference_without_rest_ends_it():
    with pytest.raises(SimulationError, match="the reference at 10 mm spacing: fell off"):
        tradeoff_of(first_order, failed=lambda r: "fell off" if r.settings.spacing == 0.01 else None)


def test_two_spacings_are_not_enough():
    with pytest.raises(ClothError, match="at least three spacings"):
        plan_tradeoff(RECIPE, spacings=(0.04, 0.02, 0.02))


def test_every_dial_is_a_setting_and_its_values_are_allowed():
    for dial in DIALS:
        for value in dial.values:
            assert getattr(replace(Settings(), **{dial.field: value}), dial.field) == value
            assert value != getattr(Settings(), dial.field)


def test_files_say_the_same(tmp_path):
    found = tradeoff_of(first_order)
    paths = write_tradeoff(found, tmp_path, 0.0025)
    assert {path.name for path in paths} == {"tradeoff.json", "tradeoff.md", "tradeoff.png"}
    facts = json.loads((tmp_path / "tradeoff.json").read_text())
    assert facts["cheapest"]["spacing"] == 0.02
    assert facts["advice"] in (tmp_path / "tradeoff.md").read_text()
    rows = {s["name"]: s for s in facts["settings"]}
    table = (tmp_path / "tradeoff.md").read_text()
    for name, row in rows.items():
        cells = re.search(rf"^\| {re.escape(name)} \|(.*)\|$", table, re.MULTILINE).group(1).split("|")
        assert float(cells[4]) == pytest.approx(1000 * row["error"], abs=0.005)


# ---- the command

# A sheet without gravity lies still from the start; its drapes differ by nothing but the start's disturbance.
AT_REST = ["tradeoff", "rectangle", "--gravity", "0", "--spacings", "250,200,150", "--vary", "none"]


def in_this_process(requests, folder, **_):
    """What `run_series` does, without processes: those are tested in test_measured_run.py and take seconds to start."""
    folder.mkdir(parents=True, exist_ok=True)
    return [measure(request, folder) for request in requests]


def test_command_measures_once_and_goes_on_from_what_is_there(tmp_path, capsys):
    folder = tmp_path / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cloth_sim_ros.tradeoff_command.run_series", in_this_process)
        assert main([*AT_REST, "-o", str(folder), "--tolerance", "5"]) == 0
    out = capsys.readouterr().out
    facts = json.loads((folder / "tradeoff.json").read_text())
    assert out.splitlines()[-1] == facts["advice"]
    # Whichever took the least time here: all of them are exact.
    fastest = min(facts["settings"], key=lambda s: s["cpu_seconds"])
    assert f"spacing {1000 * facts['cheapest']['spacing']:g} mm" == fastest["name"]
    assert 0.0 < facts["spread"]["start_moved_by_0.1_mm"] < 2e-4
    assert all(s["error"] < 1e-6 and s["cpu_seconds"] > 0.0 and s["wall_seconds"] > 0.0 for s in facts["settings"])
    before = {path: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()}
    assert main([*AT_REST, "-o", str(folder), "--tolerance", "0.0001"]) == 0
    assert {path: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()} == before
    assert "no setting can promise less" in capsys.readouterr().out


def test_command_without_matplotlib_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cloth_core.tradeoff_files.find_spec", lambda name: None)
    monkeypatch.setattr("cloth_sim_ros.tradeoff_command.run_series", lambda requests, *_, **__: [
        run_of(r, first_order(r), r.settings.spacing**-3) for r in requests
    ])  # fmt: skip
    assert main(["tradeoff", "rectangle", "--spacings", "250,200,150", "-o", str(tmp_path)]) == 0
    assert "pip install 'cloth_sim_ros[plots]'" in capsys.readouterr().err
    assert not (tmp_path / "tradeoff.png").exists()
    assert (tmp_path / "tradeoff.md").exists()


@pytest.mark.parametrize(("vary", "tried"), [([], False), (["--vary", "integrator"], True)])
def test_command_tries_implicit_steps_on_sewn_garments_only_when_told(vary, tried, tmp_path, monkeypatch):
    asked = []

    def run_series(requests, *_, **__):
        asked.extend(requests)
        return [run_of(r, first_order(r), r.settings.spacing**-3) for r in requests]

    monkeypatch.setattr("cloth_sim_ros.tradeoff_command.run_series", run_series)
    for pattern, body in (("skirt", ["--body", "young"]), ("rectangle", [])):
        asked.clear()
        assert main(["tradeoff", pattern, *body, *vary, "--spacings", "80,70,60", "-o", str(tmp_path)]) == 0
        assert any(r.settings.integrator == "implicit" for r in asked) == (tried or pattern == "rectangle")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--spacings", "40,x"], "--spacings '40,x': not a list of numbers"),
        (["--spacings", "40,20,-1"], "must be a positive number of millimetres"),
        (["--spacings", "40,20"], "at least three spacings"),
        (["--vary", "colour"], "--vary 'colour': not known; use some of safety,"),
        (["--quality", "draft"], "--quality: a trade-off tries all of them"),
        (["--body", "nobody"], "body 'nobody': not known"),
    ],
)
def test_bad_options_are_one_line_before_anything_runs(options, line, tmp_path, capsys):
    assert main(["tradeoff", "rectangle", "-o", str(tmp_path), *options]) == 2
    assert line in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
