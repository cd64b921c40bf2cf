"""Runs that are measured and kept: what they depend on, not run twice, the same in processes of their own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cloth_core import measured_run
from cloth_core.errors import ClothError, SimulationError
from cloth_core.measured_run import RunRequest, measure, stored_run
from cloth_core.quality import Settings
from cloth_core.run_series import run_series
from cloth_core.scene_recipe import SceneRecipe

# The built-in square metre, upright, held at its upper corners.
CURTAIN = SceneRecipe(("rectangle",), pinned=((-0.5, 0.0, 1.0), (0.5, 0.0, 1.0)))
COARSE = Settings(spacing=0.25)
MOTION = RunRequest(CURTAIN, COARSE, times=(0.02, 0.05))


@pytest.fixture
def no_more_runs(monkeypatch):
    """From here on, whatever would simulate fails."""

    def refuse(*_):
        pytest.fail("a run was started although its result was there")

    return lambda: monkeypatch.setattr(measured_run, "Simulation", refuse)


def test_result_is_kept_and_not_run_again(tmp_path, no_more_runs):
    first = measure(MOTION, tmp_path)
    assert first.failed is None
    assert first.cpu_seconds > 0.0
    no_more_runs()
    again = measure(MOTION, tmp_path)
    assert again.facts == first.facts
    for a, b in zip(first.frames, again.frames, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
        np.testing.assert_array_equal(a.triangles, b.triangles)
    assert len(first.frames) == 2
    assert again.drape.panel_names == first.drape.panel_names


def test_file_that_is_cut_off_counts_as_not_there(tmp_path):
    whole = measure(MOTION, tmp_path)
    for suffix in (".json", ".npz"):
        place = (tmp_path / MOTION.key()).with_suffix(suffix)
        place.write_bytes(place.read_bytes()[:100])
        assert stored_run(MOTION, tmp_path) is None
        np.testing.assert_array_equal(measure(MOTION, tmp_path).drape.positions, whole.drape.positions)


@pytest.mark.parametrize(
    "other",
    [
        replace(MOTION, seed=1),
        replace(MOTION, times=(0.02,)),
        replace(MOTION, settings=replace(COARSE, safety=0.5)),
        replace(MOTION, recipe=replace(CURTAIN, fabric="silk")),
        replace(MOTION, recipe=replace(CURTAIN, gravity=1.6)),
        replace(MOTION, recipe=replace(CURTAIN, pinned=())),
        replace(MOTION, recipe=replace(CURTAIN, body="young")),
        replace(MOTION, recipe=replace(CURTAIN, patterns=("skirt",))),
    ],
)
def test_whatever_changes_the_result_changes_the_key(other):
    assert other.key() != MOTION.key()


def test_what_is_only_quoted_does_not_change_the_key():
    quoted = replace(COARSE, tolerance=0.005, expected_error=0.004, expected_error_source="somewhere")
    assert replace(MOTION, settings=quoted).key() == MOTION.key()


def test_key_goes_by_what_is_in_a_file_not_by_its_name(tmp_path):
    source = Path(measured_run.__file__).parent / "data" / "patterns" / "rectangle.json"
    copy = tmp_path / "copy.json"
    copy.write_bytes(source.read_bytes())
    same = replace(MOTION, recipe=replace(CURTAIN, patterns=(str(copy),)))
    assert same.key() == MOTION.key()


def test_run_without_rest_is_a_result_with_the_reason(tmp_path):
    falling = RunRequest(replace(CURTAIN, pinned=()), COARSE)
    run = measure(falling, tmp_path)
    assert "nothing supports the garment" in run.failed
    assert stored_run(falling, tmp_path).failed == run.failed


def test_scene_that_cannot_be_built_is_a_result_with_the_reason(tmp_path):
    too_fine = RunRequest(CURTAIN, Settings(spacing=1e-4))
    run = measure(too_fine, tmp_path)
    assert "use a larger spacing" in run.failed
    assert run.frames == ()
    assert stored_run(too_fine, tmp_path).failed == run.failed


def test_disturbance_is_a_tenth_of_a_millimetre_for_each_particle_and_repeats():
    still, moved, again, other = (CURTAIN.build(COARSE, seed).garment.start for seed in (0, 1, 1, 2))
    np.testing.assert_allclose(np.linalg.norm(moved - still, axis=1), 1e-4, rtol=1e-6)
    np.testing.assert_array_equal(moved, again)
    assert np.abs(moved - other).max() > 5e-5


@pytest.mark.parametrize("spacing", [0.25, 0.09])
def test_pins_hold_the_same_places_at_any_spacing(spacing):
    scene = CURTAIN.build(Settings(spacing=spacing))
    held = scene.garment.start[scene.pins]
    corners = scene.garment.start[[np.argmin(((scene.garment.start - p) ** 2).sum(1)) for p in CURTAIN.pinned]]
    np.testing.assert_array_equal(np.sort(held, axis=0), np.sort(corners, axis=0))
    assert np.ptp(held[:, 0]) == pytest.approx(1.0)


def test_processes_give_the_bits_of_one_process_and_do_only_what_is_missing(tmp_path):
    requests = [MOTION, replace(MOTION, seed=1), MOTION, replace(MOTION, seed=2)]
    alone, series, seen = tmp_path / "alone", tmp_path / "series", []
    for folder in (alone, series):
        folder.mkdir()
    expected = [measure(request, alone) for request in requests]
    measure(requests[1], series)
    before = (series / f"{requests[1].key()}.json").stat().st_mtime_ns
    found = run_series(requests, series, processes=2, on_progress=lambda *progress: seen.append(progress))
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_array_equal(a.drape.positions, b.drape.positions)
    assert (series / f"{requests[1].key()}.json").stat().st_mtime_ns == before
    # The third request is the first one again, and the second one is there already.
    assert [(runs, whole) for _, _, runs, whole in seen] == [(1, 3), (2, 3), (3, 3)]
    assert seen[-1][0] == seen[-1][1]


def test_series_can_be_stopped_and_what_is_done_stays(tmp_path):
    requests = [replace(MOTION, seed=seed) for seed in range(3)]
    measure(requests[0], tmp_path)
    with pytest.raises(SimulationError, match=r"stopped with [1-3] of 3 runs done"):
        run_series(requests, tmp_path, processes=1, should_stop=lambda: True)
    assert stored_run(requests[0], tmp_path) is not None
    json.loads((tmp_path / f"{requests[0].key()}.json").read_text())


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ClothError, match=r"file/runs': .*; choose another directory"):
        run_series([MOTION], tmp_path / "file" / "runs")
