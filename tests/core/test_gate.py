"""GarmentCode's gate: each criterion by itself, at its limit and beyond, by both sets of limits; and on runs."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from apparatus import throw

from cloth_core.errors import SimulationError
from cloth_core.gate import FRAME, frame_movement, judge
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros.command_line import main

SHEET_AT_REST = ["drape", "rectangle", "--quality", "draft", "--gravity", "0"]


@cache
def good_report() -> Report:
    scene = Scene.build(Pattern.load("rectangle"), settings=Settings(spacing=0.1), gravity=0.0)
    report = Simulation(scene).settle()
    assert report.settled
    return report


STILL = np.zeros(1000)


def moving(share: float, distance: float = 0.00031) -> np.ndarray:
    return np.where(np.arange(1000) < 1000 * share, distance, 0.0003)


# What is changed in a good report, the movement, and whether our gate and the published one let it pass.
CASES = {
    "good": ({}, STILL, True, True),
    "one edge through the body": ({"body_intersections": 1}, STILL, False, True),
    "35 edges through the body": ({"body_intersections": 35}, STILL, False, True),
    "36 edges through the body": ({"body_intersections": 36}, STILL, False, False),
    "one edge of the body through the cloth": ({"body_edges_through_cloth": 1}, STILL, False, True),
    "one edge through the cloth": ({"self_intersections": 1}, STILL, False, True),
    "300 edges through the cloth": ({"self_intersections": 300}, STILL, False, True),
    "301 edges through the cloth": ({"self_intersections": 301}, STILL, False, False),
    "a seam that is open": ({"open_seams": {"panel 'a', edge 0 - panel 'b', edge 2": 0.0123}}, STILL, False, True),
    "1.4 % moving": ({}, moving(0.014), True, True),
    "1.5 % moving": ({}, moving(0.015), False, False),
    "all moving by 0.3 mm": ({}, moving(0.0), True, True),
    "2400 frames": ({"simulated_time": 2400 / 60}, STILL, True, True),
    "2401 frames": ({"simulated_time": 2401 / 60}, STILL, False, False),
    "600 s": ({"wall_time": 600.0}, STILL, True, True),
    "601 s": ({"wall_time": 601.0}, STILL, False, False),
}


@pytest.mark.parametrize("case", CASES)
def test_each_criterion_has_its_limit(case):
    changes, movement, ours, theirs = CASES[case]
    verdict = judge(replace(good_report(), **changes), movement)
    assert verdict["passed"] is ours
    assert verdict["garmentcode_passed"] is theirs
    assert len(verdict["failed"]) == (0 if ours else 1)
    assert json.loads(json.dumps(verdict, allow_nan=False)) == verdict


def test_our_limits_stand_beside_the_published_ones():
    criteria = judge(good_report(), STILL)["criteria"]
    assert (criteria["body_intersections"]["limit"], criteria["body_intersections"]["garmentcode_limit"]) == (0, 35)
    assert (criteria["self_intersections"]["limit"], criteria["self_intersections"]["garmentcode_limit"]) == (0, 300)


def test_open_seams_are_named_with_their_gaps():
    verdict = judge(replace(good_report(), open_seams={"side": 0.0123, "shoulder": 0.2}), STILL)
    assert verdict["failed"][0].startswith("seams still open: side (12.3 mm), shoulder (200.0 mm)")
    assert verdict["criteria"]["open_seams"]["value"] == 2


def test_crash_fails_whatever_else_is_good():
    verdict = judge(good_report(), None, "particle 3 left all bounds")
    assert not verdict["passed"]
    assert verdict["failed"][0] == "crash: particle 3 left all bounds"
    assert verdict["criteria"]["moving_share"]["value"] is None


def test_movement_is_that_of_the_next_frame_and_does_not_touch_the_run():
    # Free flight without air: every particle goes v t, or falls g t^2 / 2.
    scene = Scene.build(Pattern.load("rectangle"), settings=Settings(spacing=0.1), gravity=0.0, air_drag=0.0)
    simulation = Simulation(scene)
    throw(simulation, [0.3, 0.0, 0.4])
    before, state = simulation.state_hash(), (simulation.time, simulation.steps)
    np.testing.assert_allclose(frame_movement(simulation), 0.5 * FRAME, rtol=1e-9)
    assert simulation.state_hash() == before
    assert (simulation.time, simulation.steps) == state
    again = Simulation(scene)
    throw(again, [0.3, 0.0, 0.4])
    simulation.advance(0.02)
    again.advance(0.02)
    assert simulation.state_hash() == again.state_hash()


def test_command_judges_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert (
        main(
            [*SHEET_AT_REST, "--gate", "--report", str(tmp_path / "report.json"), "--record", str(tmp_path / "r.mcap")]
        )
        == 0
    )
    gate = json.loads((tmp_path / "report.json").read_text())["gate"]
    assert gate["passed"] is True
    assert gate["failed"] == []
    assert "passed" in capsys.readouterr().out
    assert main([*SHEET_AT_REST, "--report", str(tmp_path / "plain.json")]) == 0
    assert json.loads((tmp_path / "plain.json").read_text())["gate"] is None


def test_command_fails_with_all_reasons_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    # Nothing holds it: it falls, which is not static.
    fall = ["drape", "rectangle", "--quality", "draft", "--air-drag", "0", "--gate"]
    assert main([*fall, "--report", str(tmp_path / "report.json")]) == 1
    [line] = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert "the gate is not passed: never static: 100.00 % of the particles" in line
    assert json.loads((tmp_path / "report.json").read_text())["gate"]["passed"] is False


def test_command_reports_a_crash_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def crash(simulation: Simulation, *arguments: object) -> object:
        raise SimulationError("particle 7 left all bounds")

    monkeypatch.setattr(Simulation, "settle", crash)
    assert main([*SHEET_AT_REST, "--gate", "--report", str(tmp_path / "report.json")]) == 1
    gate = json.loads((tmp_path / "report.json").read_text())["gate"]
    assert gate["failed"][0] == "crash: particle 7 left all bounds"
