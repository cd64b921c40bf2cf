"""Runs on which grippers and a moving body act are repeated from their log to the last bit, and changes are found."""

import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief
from test_replay import json_change, rewritten
from test_worker import PATIENCE, Bench

from cloth_core.body import Body
from cloth_core.grasp import Pose
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import decode_string
from cloth_sim_ros.replay import ReplayDifference, replay_log, verify_log
from cloth_sim_ros.run_recorder import RunRecorder
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation, repeat
from cloth_sim_ros.topics import BODY_MARKER, GARMENT, REPORT, SCHEDULE


def acts(path):
    """How often each kind is in the schedule of a log."""
    with LogReader(path) as log:
        changes = [json.loads(decode_string(message.data)) for message in log.messages(SCHEDULE)]
    return Counter(motion["kind"] for change in changes for motion in change["motions"])


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture(scope="module")
def handled(tmp_path_factory):
    """A node's log: cloth is taken up by two grippers, carried and dropped, before, within and between motions."""
    bench = Bench(tmp_path_factory.mktemp("handled"))
    worker = bench.worker
    bench.give(handkerchief(0.25))
    worker.move_gripper("one", Pose.of((0.1, 0.1, 0.15)))
    worker.grasp("one")  # before anything has moved
    wait_until(lambda: worker.describe()["grippers"])
    path = Path(worker.record(True).removeprefix("recording "))
    worker.step(3)
    bench.wait_for_state("paused")
    worker.drape()
    bench.wait_until_moved()
    for k in range(5):  # within settle
        worker.move_gripper("one", Pose.of((0.1, 0.1 + 0.01 * k, 0.16), (0.0, 0.0, 0.02 * k, 1.0)))
        bench.wait_until_moved()
    worker.configure(worker._builder.parameters, replace(bench.settings, grasp_speed=0.2))
    bench.wait_for_report()
    worker.move_gripper("two", Pose.of((*bench.last_points()[0],)))
    worker.grasp("two")  # the run goes on by itself
    wait_until(lambda: len(worker.describe()["grippers"]) == 2)
    worker.move_gripper("two", Pose.of((0.0, 0.0, 0.3)))
    bench.wait_until_moved()
    worker.release("one")
    worker.save()
    bench.wait_for_report(2)
    worker.step(2)
    bench.wait_for_state("paused")
    worker.release("two")
    worker.step()
    bench.wait_for_state("paused")
    worker.save()
    bench.wait_for_report(3)
    worker.record(False)
    worker.close()
    return path


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """A node's log: the body under the cloth moves, also before it has arrived, and then the run is reset."""
    bench = Bench(tmp_path_factory.mktemp("pushed"))
    worker = bench.worker
    bench.give(handkerchief(0.25))
    path = Path(worker.record(True).removeprefix("recording "))
    worker.drape()
    bench.wait_for_report()
    for k in range(1, 4):
        worker.load_body(BOX_VERTICES + np.array([0.004 * k, 0.0, 0.003 * k]), BOX_TRIANGLES)
        bench.wait_until_moved()
    wait_until(lambda: not worker.describe()["body_moves"])
    worker.pause()
    bench.wait_for_state("paused")
    worker.reset()
    bench.wait_for_state("paused")
    worker.step()
    bench.wait_for_state("paused")
    worker.save()
    bench.wait_for_report(2)
    worker.record(False)
    worker.close()
    return path


def test_a_run_with_grippers_is_repeated_to_the_last_bit(handled):
    found = verify_log(handled)
    with LogReader(handled) as log:
        assert found.frames == log.count(GARMENT)
        assert found.reports == log.count(REPORT) == 3
    counts = acts(handled)
    assert counts["grasp"] == counts["release"] == 2
    assert counts["move_grasp"] >= 5
    assert counts["grasp_speed"] == 1
    assert [report.state_sha256 for report in replay_log(handled)] == [found.state_sha256]


def test_a_run_with_a_moving_body_is_repeated_to_the_last_bit(pushed):
    found = verify_log(pushed)
    with LogReader(pushed) as log:
        assert found.frames == log.count(GARMENT)
        assert found.runs == 2
        assert log.count(BODY_MARKER) > 3
    assert acts(pushed)["move_body"] == 3


def first_act(kind, edit):
    """Changes the first act of a kind."""
    done = []

    def change(values):
        for motion in values["motions"]:
            if motion["kind"] == kind and not done:
                done.append(motion)
                edit(motion)

    return json_change("schedule", change)


def shift(motion):
    motion["values"]["position"][2] = float(np.nextafter(motion["values"]["position"][2], 1.0))


@pytest.mark.parametrize(
    ("edit", "error", "complaint"),
    [
        (first_act("move_grasp", shift), ReplayDifference, r"frame \d+ .*particle \d+ of panel 'cloth'"),
        (first_act("grasp", lambda m: m["values"]["particles"].pop()), ReplayDifference, r"frame \d+ "),
        (
            first_act("grasp", lambda m: m["values"]["particles"].append(10**6)),
            LogError,
            "grasp one .*cannot be repeat",
        ),
        (
            first_act("grasp", lambda m: m["values"].pop("position")),
            LogError,
            "grasp one after step 0 cannot be repeat",
        ),
        (first_act("release", lambda m: m.update(what="none")), LogError, "none: it holds nothing"),
        (first_act("release", lambda m: m.update(steps=m["steps"] + 1)), ReplayDifference, r"(frame|report) \d+ "),
        (first_act("grasp_speed", lambda m: m["values"].update(speed=0.3)), ReplayDifference, r"frame \d+ "),
    ],
)
def test_a_changed_act_of_a_gripper_is_found(handled, tmp_path, edit, error, complaint):
    with pytest.raises(error, match=complaint) as caught:
        verify_log(rewritten(handled, tmp_path / "changed.mcap", edit))
    assert "\n" not in str(caught.value)


def nth_message(topic, number, edit):
    return lambda name, count, data: edit(data) if (name, count) == (topic, number) else data


def one_bit(data):
    """Of a coordinate, in a mesh and in a marker."""
    place = len(data) * 2 // 3
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


@pytest.mark.parametrize(
    ("edit", "error", "complaint"),
    [
        (nth_message("body", 3, one_bit), LogError, "move_body after step .*no message of topic body has vertices"),
        (nth_message("body", 3, lambda _: None), LogError, "no message of topic body has vertices"),
        (nth_message("body_marker", 3, one_bit), ReplayDifference, "body_marker .*it is not the body of the run"),
        (first_act("move_body", lambda m: m["values"].update(duration=0.11)), ReplayDifference, "body|frame"),
        (first_act("move_body", lambda m: m["values"].update(max_speed=None)), None, None),  # it was not as fast
    ],
)
def test_a_changed_move_of_a_body_is_found(pushed, tmp_path, edit, error, complaint):
    path = rewritten(pushed, tmp_path / "changed.mcap", edit)
    if error is None:
        verify_log(path)
        return
    with pytest.raises(error, match=complaint) as caught:
        verify_log(path)
    assert "\n" not in str(caught.value)


def test_acts_within_a_coarse_start_are_repeated():
    """A run to rest begins with a coarser mesh; what acts meanwhile acts at the same place of it."""
    scene = Scene.build(
        Pattern.from_json(handkerchief(0.3)), Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES),
        settings=Settings(spacing=0.02, max_time=0.5),
    )  # fmt: skip
    simulation = ScheduledSimulation(scene)
    chosen = np.array([0, 1], dtype=np.int32)

    def act(running):
        if not running.schedule[1:]:
            running.grasp("g", chosen, Pose.of(running.positions[0]))
        return running.time > 0.3

    simulation.settle(act)
    again = ScheduledSimulation(scene)
    assert repeat(again, simulation.schedule, lambda other: other.steps >= simulation.steps) is None
    assert again.state_hash() == simulation.state_hash()


def test_terms_that_are_switched_off_stay_off_when_a_log_is_repeated(tmp_path):
    pattern = Pattern.from_json(handkerchief(), "handkerchief")
    body = Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES)
    scene = Scene.build(pattern, body, quality="draft", without=("friction", "shear springs"))
    simulation = ScheduledSimulation(scene)
    path = tmp_path / "run.mcap"
    with RunRecorder(path, [pattern.source], body, {}, patterns=[pattern], scene=scene) as recorder:
        recorder.follow(simulation)
        simulation.advance(0.3, recorder.follow)
        recorder.finish(simulation, simulation.report())
    assert verify_log(path).reports == 1
    edit = json_change("parameters", lambda values: values["replay"].update(without=["friction"]))
    with pytest.raises(ReplayDifference, match="frame"):
        verify_log(rewritten(path, tmp_path / "changed.mcap", edit))
