"""`cloth-sim stability`: table, JSON and picture of what it measured; exit code 1 where a prediction is off."""

import json

import imageio.v3 as imageio
import pytest

import cloth_core.stability_cases
from cloth_core.blow_up import BlowUp
from cloth_core.stability_cases import StabilityCase
from cloth_sim_ros.command_line import main


def cases(ratio: float):
    return lambda quick=False: [
        StabilityCase("stiffness [N/m]", k, f"{k:g} N/m", lambda: BlowUp(ratio * 1e-3, 1e-3, 0.1, 121))
        for k in (1.0, 1e4)
    ]


def test_writes_table_json_and_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cloth_core.stability_cases, "stability_cases", cases(0.9))
    assert main(["stability", "-o", str(tmp_path / "map")]) == 0
    assert "2 cases: predicted / measured from 0.900 to 0.900" in capsys.readouterr().out
    rows = json.loads((tmp_path / "map" / "stability.json").read_text())["cases"]
    assert [row["value"] for row in rows] == [1.0, 1e4]
    assert rows[0]["predicted"] == pytest.approx(9e-4)
    assert "| stiffness [N/m] | 1 N/m | 121 |" in (tmp_path / "map" / "stability.md").read_text()
    assert imageio.imread(tmp_path / "map" / "stability.png").std() > 1.0


@pytest.mark.parametrize("ratio", [1.01, 0.7])
def test_prediction_that_is_off_exits_with_1_and_keeps_the_results(ratio, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cloth_core.stability_cases, "stability_cases", cases(ratio))
    assert main(["stability", "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("cloth-sim: error: stiffness [N/m], 1 N/m: predicted")
    assert (tmp_path / "stability.json").exists()


def test_directory_that_cannot_be_made_exits_with_2(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["stability", "-o", str(tmp_path / "file" / "map")]) == 2
    assert "name a directory that can be made" in capsys.readouterr().err
