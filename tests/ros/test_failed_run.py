"""A run whose state would no longer be finite: no frame shows it, and a reset goes on."""

import math

import numpy as np
import pytest
from small_scenes import handkerchief
from test_worker import Bench

import cloth_core.motion
from cloth_core.errors import ClothError
from cloth_sim_ros.messages import decode_marker
from cloth_sim_ros.topics import GARMENT


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    bench.worker.close()


@pytest.mark.parametrize("command", ["start", "step", "drape"])
def test_no_frame_is_ever_not_finite_and_the_last_is_the_last_good_state(bench, monkeypatch, command):
    good = cloth_core.motion.run_steps
    calls = 0

    def breaks_later(x, v, *rest):
        nonlocal calls
        calls += 1
        done = good(x, v, *rest)
        if calls > 40:
            x[3] = v[5] = math.nan
        return done

    bench.give(handkerchief())
    with monkeypatch.context() as patch:
        patch.setattr(cloth_core.motion, "run_steps", breaks_later)
        while not bench.listener.warnings:
            getattr(bench.worker, command)()
            bench.listener.wait(
                lambda: bench.listener.warnings or bench.worker.describe()["state"] in ("paused", "rest")
            )
    assert bench.listener.warnings[0].startswith("the run failed: particle ")
    assert "left all bounds at" in bench.listener.warnings[0]
    frames = [decode_marker(data).points for data in bench.listener.of(GARMENT)]
    assert all(np.isfinite(points).all() for points in frames)
    description = bench.worker.describe()
    assert description["progress"]["phase"] == "failed"
    assert math.isfinite(description["progress"]["simulated_time"])
    assert description["progress"]["simulated_time"] > 0.0
    with pytest.raises(ClothError, match="reset it"):
        bench.worker.start()
    # What was sent last is where it stayed, and after a reset it is at its start again and moves.
    stayed = frames[-1]
    bench.worker.reset()
    bench.listener.wait(lambda: not np.array_equal(bench.last_points(), stayed))
    np.testing.assert_array_equal(bench.last_points(), frames[0])
    bench.worker.step()
    bench.listener.wait(lambda: not np.array_equal(bench.last_points(), frames[0]))
    assert np.isfinite(bench.last_points()).all()
