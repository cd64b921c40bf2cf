"""`cloth-sim` as a user meets it: results, exit codes, one line for each error, and no need of ROS."""

import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from PIL import Image

import cloth_core
from cloth_core.body import builtin_bodies
from cloth_core.fabric import fabric_presets
from cloth_core.pattern import builtin_patterns
from cloth_sim_ros.command_line import main

# A flat sheet without gravity lies still from the start: the quickest run that ends well.
SHEET_AT_REST = ["drape", "rectangle", "--quality", "draft", "--gravity", "0"]
FROM_ANYWHERE = {**os.environ, "PYTHONPATH": str(Path(cloth_core.__file__).parents[1])}
CONTRACT_KEYS = {
    "particles",
    "triangles",
    "springs",
    "terms",
    "time_step",
    "stable_time_step",
    "steps",
    "simulated_time",
    "wall_time",
    "settled",
    "rest_reason",
    "max_strain",
    "mean_strain",
    "max_seam_gap",
    "body_intersections",
    "self_intersections",
    "max_penetration",
    "state_sha256",
}


def one_line_of_error(capsys: pytest.CaptureFixture[str]) -> str:
    lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1
    assert lines[0].startswith("cloth-sim: error: ")
    return lines[0]


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with everything that `drape` can write about the sheet at rest."""
    directory = tmp_path_factory.mktemp("run")
    outputs = {"--output": "sheet.glb", "--record": "run.mcap", "--picture": "sheet.png", "--report": "report.json"}
    options = [part for option, name in outputs.items() for part in (option, str(directory / name))]
    assert main([*SHEET_AT_REST, *options, "--size", "320x240"]) == 0
    return directory


def test_mesh_is_the_unmoved_sheet_with_y_up(finished_run: Path) -> None:
    mesh = trimesh.load_mesh(finished_run / "sheet.glb")
    # The built-in rectangle: 1 m by 1 m; that it lies flat shows in its area, that nothing moved in its size.
    assert mesh.area == pytest.approx(1.0, abs=1e-6)
    assert sorted(mesh.extents) == pytest.approx([0.0, 1.0, 1.0], abs=1e-6)


def test_report_has_the_keys_that_tools_rely_on(finished_run: Path) -> None:
    report = json.loads((finished_run / "report.json").read_text())
    assert set(report) >= CONTRACT_KEYS
    assert report["settled"] is True
    assert report["max_strain"] == pytest.approx(0.0, abs=1e-9)
    mesh = trimesh.load_mesh(finished_run / "sheet.glb")
    assert (report["particles"], report["triangles"]) == (len(mesh.vertices), len(mesh.faces))


def test_picture_has_the_size_asked_for_and_shows_the_sheet(finished_run: Path) -> None:
    picture = np.asarray(Image.open(finished_run / "sheet.png").convert("RGB"), dtype=int)
    assert picture.shape == (240, 320, 3)
    blue = picture[..., 2] - picture[..., 0] > 40
    # It lies flat and is seen from slightly above, in two views.
    assert 0.005 < blue.mean() < 0.5


def test_log_holds_pattern_frames_and_report(finished_run: Path) -> None:
    with (finished_run / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    channels = {channel.topic: number for number, channel in summary.channels.items()}
    counts = summary.statistics.channel_message_counts
    report = json.loads((finished_run / "report.json").read_text())
    assert counts[channels["/cloth_sim/pattern"]] == 1
    assert counts[channels["/cloth_sim/report"]] == 1
    # 30 frames per simulated second, and the last state.
    assert abs(counts[channels["/cloth_sim/garment"]] - 30 * report["simulated_time"]) <= 2


def test_log_can_be_rendered(finished_run: Path, tmp_path: Path) -> None:
    assert main(["render", str(finished_run / "run.mcap"), "-o", str(tmp_path / "log.png"), "--size", "320x240"]) == 0
    assert Image.open(tmp_path / "log.png").size == (320, 240)


def test_same_run_twice_gives_the_same_state(finished_run: Path, tmp_path: Path) -> None:
    assert main([*SHEET_AT_REST, "--report", str(tmp_path / "again.json")]) == 0
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["state_sha256"] == json.loads((finished_run / "report.json").read_text())["state_sha256"]


def test_run_that_does_not_come_to_rest_exits_with_1_and_keeps_its_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "report.json"
    assert main([*SHEET_AT_REST, "--max-time", "0.01", "--report", str(report)]) == 1
    assert "not at rest after 0.01" in one_line_of_error(capsys)
    assert json.loads(report.read_text())["settled"] is False


def test_garment_without_support_exits_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drape", "rectangle", "--quality", "draft"]) == 1
    assert "nothing supports the garment" in one_line_of_error(capsys)


def test_results_that_cannot_be_written_after_the_run_exit_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from cloth_core.simulation import Simulation

    directory = tmp_path / "gone"
    directory.mkdir()
    settle = Simulation.settle

    def settle_and_remove_the_directory(simulation: Simulation, *arguments: object) -> object:
        directory.rmdir()
        return settle(simulation, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulation, "settle", settle_and_remove_the_directory)
    assert main([*SHEET_AT_REST, "--report", str(directory / "report.json")]) == 1
    assert "report.json" in one_line_of_error(capsys)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "command"),
        (["sew"], "sew"),
        (["drape"], "PATTERN"),
        (["drape", "no_such_pattern"], "no_such_pattern"),
        (["drape", "rectangle", "--body", "nobody"], "nobody"),
        (["drape", "rectangle", "--fabric", "steel"], "steel"),
        (["drape", "rectangle", "--quality", "best"], "best"),
        (["drape", "rectangle", "--quality", "fine", "--tolerance", "1"], "--tolerance"),
        (["drape", "rectangle", "--tolerance", "-1"], "-1"),
        (["drape", "rectangle", "--gravity", "nan"], "--gravity"),
        (["drape", "rectangle", "--gravity", "earth"], "earth"),
        (["drape", "rectangle", "--air-drag", "inf"], "--air-drag"),
        (["drape", "rectangle", "--max-time", "0"], "--max-time"),
        (["drape", "rectangle", "--size", "big"], "big"),
        (["drape", "rectangle", "--size", "4x4"], "4x4"),
        (["drape", "rectangle", "--output", "garment.stl"], ".ply"),
        (["drape", "rectangle", "--output", "no_such_directory/garment.glb"], "no_such_directory"),
        (["drape", "rectangle", "--record", "run.bag"], ".mcap"),
        (["drape", "rectangle", "--picture", "picture.jpg"], ".png"),
        (["drape", "rectangle", "--report", "report.txt"], ".json"),
        (["explain", "no_such_pattern"], "no_such_pattern"),
        (["render", "no_such_log.mcap", "-o", "film.gif"], "no_such_log.mcap"),
        (["render", "no_such_log.mcap"], "--output"),
        (["play", "no_such_log.mcap", "--rate", "0"], "--rate"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_exits_with_2_and_one_line(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert named in one_line_of_error(capsys)


def test_malformed_files_exit_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pattern, body = tmp_path / "pattern.json", tmp_path / "body.ply"
    pattern.write_text("{")
    assert main(["drape", str(pattern)]) == 2
    assert str(pattern) in one_line_of_error(capsys)
    body.write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    assert main(["drape", "rectangle", "--body", str(body)]) == 2
    assert str(body) in one_line_of_error(capsys)


def test_no_output_overwrites_an_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    body = tmp_path / "body.ply"
    trimesh.creation.icosphere().export(body)
    before = body.read_bytes()
    assert main(["drape", "rectangle", "--body", str(body), "--output", f"{tmp_path}/./body.ply"]) == 2
    assert "both read and written" in one_line_of_error(capsys)
    assert body.read_bytes() == before


def test_defect_is_one_line_too(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from cloth_core.pattern import Pattern

    def broken(name: str) -> Pattern:
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr(Pattern, "load", broken)
    assert main(["explain", "rectangle"]) == 1
    assert "ZeroDivisionError: division by zero" in one_line_of_error(capsys)


def test_explain_counts_what_the_run_has(finished_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", *SHEET_AT_REST[1:], "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    report = json.loads((finished_run / "report.json").read_text())
    for key in ("particles", "triangles", "springs", "time_step", "stable_time_step"):
        # The run has measured its stable time step again meanwhile.
        assert facts[key] == pytest.approx(report[key], rel=1e-3)
    assert {name: term["active"] for name, term in facts["terms"].items()} == {
        name: term["active"] for name, term in report["terms"].items()
    }
    assert facts["simulated_time"] == 0.0
    assert facts["seconds_per_simulated_second"] == pytest.approx(facts["seconds_per_step"] / facts["time_step"])


def test_explain_prints_every_term_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", *SHEET_AT_REST[1:]]) == 0
    shown = capsys.readouterr().out
    for words in ("gravity is 0", "structural springs", "there is no body", "stable time step"):
        assert words in shown


def test_terms_can_be_switched_off_and_what_is_needed_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--quality", "draft", "--without", "gravity", "--without", "self contact"]
    assert main(["explain", "rectangle", *options, "--json"]) == 0
    out = capsys.readouterr()
    terms = json.loads(out.out)["terms"]
    assert not terms["gravity"]["active"]
    assert not terms["self contact"]["active"]
    # The level square metre of cotton at rest: its weight is missed, its layers are not close.
    assert terms["gravity"]["missed"].startswith("gravity is off and 0.124 kg of cloth do not weigh")
    assert terms["self contact"]["missed"] is None
    assert terms["self contact"]["reason"] == "switched off by hand"


def test_term_that_cannot_be_switched_off_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "rectangle", "--without", "magic"]) == 2
    assert "without 'magic': no term that can be switched off; use some of gravity," in one_line_of_error(capsys)


def test_explain_shows_shares_and_what_to_expect(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", *SHEET_AT_REST[1:]]) == 0
    shown = capsys.readouterr().out
    assert "share" in shown
    assert "(time:" in shown
    assert "expected error" in shown


@pytest.mark.parametrize("command", ["drape", "explain", "render", "play", "tradeoff"])
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    assert "Usage: cloth-sim " + command in capsys.readouterr().out


def test_help_names_all_that_is_built_in(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drape", "--help"]) == 0
    words = capsys.readouterr().out.replace(",", " ").replace(".", " ").replace(":", " ").replace(")", " ").split()
    words = [word.strip("(") for word in words]
    assert set(builtin_patterns()) | set(builtin_bodies()) | set(fabric_presets()) <= set(words)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_run_writes_what_there_is(number: signal.Signals, tmp_path: Path) -> None:
    program = "import sys; from cloth_sim_ros.command_line import main; sys.exit(main())"
    outputs = ["--report", "report.json", "--record", "run.mcap", "--output", "sheet.ply"]
    run = subprocess.Popen(
        [sys.executable, "-c", program, "drape", "tshirt", "--quality", "draft", "--max-time", "1000", *outputs],
        cwd=tmp_path,
        env=FROM_ANYWHERE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stderr is not None
    for line in run.stderr:
        if line.startswith("sewing: "):
            break
    run.send_signal(number)
    rest = run.stderr.read()
    assert run.wait() == 1
    assert "stopped before it came to rest" in rest
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["settled"] is False
    assert report["simulated_time"] < 1.0
    assert len(trimesh.load_mesh(tmp_path / "sheet.ply").faces) == report["triangles"]
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None


def test_draping_recording_and_rendering_need_no_ros(tmp_path: Path) -> None:
    program = textwrap.dedent(
        """
        import importlib.abc, sys

        class NoRos(importlib.abc.MetaPathFinder):
            def find_spec(self, name, path=None, target=None):
                root = name.partition(".")[0]
                if root.startswith(("rclpy", "rcl_", "ament_", "rosidl_", "builtin_interfaces", "launch")) or (
                    root.endswith(("_msgs", "_srvs"))
                ):
                    raise ModuleNotFoundError(f"No module named '{name}'", name=name)
                return None

        sys.meta_path.insert(0, NoRos())
        from cloth_sim_ros.command_line import main

        assert main(["drape", "rectangle", "--quality", "draft", "--gravity", "0", "--record", "run.mcap"]) == 0
        assert main(["render", "run.mcap", "-o", "run.png", "--size", "320x240"]) == 0
        sys.exit(main(["play", "run.mcap"]))
        """
    )
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, env=FROM_ANYWHERE, check=False
    )
    assert run.returncode == 2
    assert "pip install 'cloth_sim_ros[ros]'" in run.stderr.splitlines()[-1]
    assert (tmp_path / "run.png").stat().st_size > 1000
