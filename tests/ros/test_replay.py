"""A log is enough to simulate its runs again to the last bit, and what was changed in it is found and located."""

import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from mcap.reader import make_reader
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief
from test_worker import Bench

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_sim_ros import log_writer
from cloth_sim_ros.command_line import main
from cloth_sim_ros.log_check import check_log
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_repair import end_log, recover_log
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.messages import decode_marker, decode_string, encode_string
from cloth_sim_ros.replay import ReplayDifference, verify_log
from cloth_sim_ros.run_recorder import RunRecorder
from cloth_sim_ros.scene_inputs import SceneParameters
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation, ScheduleFollower, repeat, schedule_from
from cloth_sim_ros.topics import BODY_MARKER, GARMENT, PARAMETERS, PATTERN, REPORT, SCHEDULE, Topic


@pytest.fixture(scope="module")
def drape(tmp_path_factory):
    """The log of one drape, as the command line records it."""
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    pattern = Pattern.from_json(handkerchief(), "handkerchief")
    scene = Scene.build(pattern, Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES, "box"), quality="draft")
    simulation = ScheduledSimulation(scene)
    texts = [pattern.source]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_writer, "CHUNK_SIZE", 100_000)  # so that a small log has several
        with RunRecorder(path, texts, scene.body, {"fabric": "x"}, patterns=[pattern], scene=scene) as recorder:
            recorder.follow(simulation)
            recorder.finish(simulation, simulation.settle(recorder.follow))
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The log of a node that was ordered about: steps, motion, a halt, drapes, resets, other patterns and values."""
    bench = Bench(tmp_path_factory.mktemp("session"))
    bench.give(handkerchief(0.25))
    bench.worker.step()
    bench.wait_for_state("paused")
    # From here on it is recorded: the run has begun already.
    path = Path(bench.worker.record(True).removeprefix("recording "))
    for _ in range(2):
        bench.worker.step()
        bench.wait_for_state("paused")
    bench.worker.start()
    bench.wait_until_moved()
    bench.worker.pause()
    bench.wait_for_state("paused")
    bench.worker.drape()
    bench.wait_until_moved()
    bench.worker.step()
    bench.worker.drape()
    bench.wait_for_report()
    bench.worker.configure(SceneParameters(quality="draft", fabric="silk", gravity=5.0, air_drag=0.3), bench.settings)
    bench.worker.reset()
    bench.wait_for_state("paused")
    bench.worker.start()
    bench.wait_until_moved()
    bench.give(handkerchief(0.3), box=False)  # the body stays
    bench.worker.drape()
    bench.wait_for_report(2)
    bench.worker.record(False)
    bench.worker.close()
    return path


def test_a_drape_is_repeated_to_the_last_bit(drape):
    found = verify_log(drape)
    with LogReader(drape) as log:
        assert (found.runs, found.frames, found.reports) == (1, log.count(GARMENT), 1)
        assert found.state_sha256 == log.report()["state_sha256"]
        assert found.simulated_time == log.report()["simulated_time"]


def test_a_session_with_a_node_is_repeated_to_the_last_bit(session):
    found = verify_log(session)
    with LogReader(session) as log:
        assert log.count(PARAMETERS) == found.runs == 3
        assert found.frames == log.count(GARMENT)
        assert found.reports == log.count(REPORT) == 2
        texts = [json.loads(decode_string(message.data)) for message in log.messages(SCHEDULE)]
    kinds = [motion["kind"] for change in texts for motion in change["motions"]]
    assert set(kinds) == {"advance", "tick", "settle"}


def test_another_number_of_threads_gives_the_same_bits(drape):
    threads = "2" if numba.config.NUMBA_NUM_THREADS == 1 else "1"
    environment = os.environ | {"NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
    command = [sys.executable, "-m", "cloth_sim_ros.command_line", "replay", str(drape), "--verify"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert "identical" in done.stdout


def test_without_verify_the_runs_are_reported(session, capsys):
    assert main(["replay", str(session)]) == 0
    shown = capsys.readouterr().out
    assert shown.count("pattern on body") == 3
    assert "silk" in shown


def test_a_log_that_was_cut_off_is_repeated_as_far_as_it_goes(session, tmp_path):
    content = session.read_bytes()
    with open(session, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    cut, good = tmp_path / "cut.mcap", tmp_path / "good.mcap"
    for chunk in {0, len(chunks) // 2, len(chunks) - 1}:
        cut.write_bytes(content[: chunks[chunk].chunk_start_offset + chunks[chunk].chunk_length // 2])
        if chunk == 0:
            with pytest.raises(Exception, match="nothing can be recovered"):
                recover_log(cut, good)
            continue
        recover_log(cut, good)
        with LogReader(good) as log:
            assert verify_log(good).frames == log.count(GARMENT) > 0


def test_a_run_that_ends_without_rest_is_repeated_with_its_report(tmp_path):
    """Its report is made after the last tick, when what only serves the way to rest has been put back."""
    pattern = Pattern.from_json(handkerchief(), "handkerchief")
    settings = Settings(spacing=0.025, max_time=0.2)
    scene = Scene.build(pattern, Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES), settings=settings)
    simulation = ScheduledSimulation(scene)
    path = tmp_path / "run.mcap"
    with RunRecorder(path, [pattern.source], scene.body, {}, patterns=[pattern], scene=scene) as recorder:
        recorder.follow(simulation)
        report = simulation.settle(recorder.follow)
        recorder.finish(simulation, report)
    assert not report.settled
    assert verify_log(path).reports == 1
    edit = json_change("report", lambda values: values.update(stable_time_step=1.0))
    with pytest.raises(ReplayDifference, match=r"report 1 .*, stable_time_step: 1\.0 in the log"):
        verify_log(rewritten(path, tmp_path / "changed.mcap", edit))


def test_what_acts_from_outside_ends_the_verification_and_is_named(tmp_path):
    pattern = Pattern.from_json(handkerchief(), "handkerchief")
    scene = Scene.build(pattern, quality="draft")
    simulation = ScheduledSimulation(scene)
    path = tmp_path / "run.mcap"

    def act(simulation):
        recorder.follow(simulation)
        if simulation.time > 0.2:
            simulation.acted_upon("a gust")
            simulation.motion.v[:, 0] += 1.0

    with RunRecorder(path, [pattern.source], None, {}, patterns=[pattern], scene=scene) as recorder:
        recorder.follow(simulation)
        simulation.advance(0.4, act)
    with pytest.raises(
        LogError, match=r"the first [67] frames are identical; then a gust acted on the cloth at 0\.2\d*"
    ):
        verify_log(path)
    assert [motion.kind for motion in simulation.schedule] == ["advance", "outside"]


def rewritten(source, target, change):
    """A log that is sound as a file, with another content: `change` maps a topic's name, a number and its bytes."""
    topics = {}
    with LogReader(source) as log, LogWriter(target) as writer:
        for message in log.messages():
            name = message.topic.rsplit("/", 1)[-1]
            count = topics[name] = topics.get(name, 0) + 1
            own = {"diagnostics": "/diagnostics"}.get(name, name)
            topic = Topic(own, message.message_type, {t.name: t.qos for t in ALL_TOPICS}.get(own, GARMENT.qos))
            data = change(name, count, message.data)
            if data is not None:
                writer.write(topic, message.log_time, data)
    return target


ALL_TOPICS = (PATTERN, PARAMETERS, GARMENT, BODY_MARKER, REPORT, SCHEDULE)


def test_a_changed_position_is_named_with_frame_and_particle(drape, tmp_path):
    with LogReader(drape) as log:
        message = list(log.messages(GARMENT))[6]
    marker = decode_marker(message.data)
    place = message.data.index(marker.points.tobytes()) + 24 * 100
    triangles = Scene.build(Pattern.from_json(handkerchief()), quality="draft").garment.triangles

    def change(name, count, data):
        # The last bit of one number of the seventh frame.
        return data if (name, count) != ("garment", 7) else data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]

    path = rewritten(drape, tmp_path / "changed.mcap", change)
    check_log(path)
    with pytest.raises(ReplayDifference) as caught:
        verify_log(path)
    line = str(caught.value)
    assert re.search(r"run 1, frame 7 \(at 0\.2\d* s, step \d+, /cloth_sim/garment\)", line)
    assert f"particle {triangles.ravel()[100]} of panel 'cloth'" in line
    assert "1 particles differ" in line
    assert "\n" not in line


def json_change(topic, edit):
    def change(name, _, data):
        if name != topic:
            return data
        values = json.loads(decode_string(data))
        edit(values)
        return encode_string(json.dumps(values))

    return change


def gravity(values):
    values["replay"]["gravity"] += 1e-9


def schedule(values):
    for motion in values["motions"]:
        motion["kind"] = "tick"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (json_change("parameters", gravity), r"frame 2 .*, particle \d+ of panel 'cloth': .* apart"),
        (json_change("schedule", schedule), r"frame \d+ "),
        (json_change("report", lambda v: v.update(max_strain=0.5)), "report 1 .*, max_strain: 0.5 in the log"),
        (json_change("report", lambda v: v.update(state_sha256="0" * 64)), "report 1 .*, state_sha256: 0000"),
        (lambda name, count, data: None if (name, count) == ("garment", 1) else data, None),
        (lambda name, _, data: data[:-2] + b"\1\0" if name == "pattern" else data, "topic pattern: no message has"),
        (lambda name, _, data: None if name == "body" else data, "topic body: no message has the checksum"),
        (lambda name, _, data: None if name == "schedule" else data, r"frame 2 \(at 0.03"),
        (lambda name, _, data: None if name == "parameters" else data, "no parameters of a run"),
        (json_change("parameters", lambda v: v.pop("replay")), "does not say what it takes"),
    ],
)
def test_other_changes_of_the_content(drape, tmp_path, capsys, change, complaint):
    path = rewritten(drape, tmp_path / "changed.mcap", change)
    code = main(["replay", str(path), "--verify"])
    errors = capsys.readouterr().err.splitlines()
    if complaint is None:  # a frame less is still the same simulation
        assert code == 0
        return
    assert code == (1 if "frame" in complaint or "report" in complaint else 2)
    assert re.search(complaint, errors[-1]), errors


def test_a_difference_names_the_versions_that_differ(drape, tmp_path):
    def edit(values):
        gravity(values)
        values["replay"]["versions"]["numpy"] = "1.0"

    path = rewritten(drape, tmp_path / "changed.mcap", json_change("parameters", edit))
    with pytest.raises(ReplayDifference, match=r"recorded with numpy 1\.0 \(here "):
        verify_log(path)


@pytest.mark.parametrize("end", ["finished", "repaired"])
def test_any_changed_byte_is_found_and_located(drape, tmp_path, end):
    content = bytearray(drape.read_bytes())
    path = tmp_path / "changed.mcap"
    path.write_bytes(content)
    if end == "repaired":
        with open(path, "rb+") as stream:
            end_log(stream)
        content = bytearray(path.read_bytes())
    original = bytes(content)
    chunks = check_log(path)
    with open(drape, "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert chunks == len(summary.chunk_indexes) > 1
    rng = random.Random(1)
    places = {*range(60), *range(len(content) - 60, len(content)), *rng.sample(range(len(content)), 100)}
    for index in summary.chunk_indexes:  # their heads, and the indexes of messages behind them
        places |= {index.chunk_start_offset + i for i in range(0, 60, 7)}
        places |= {index.chunk_start_offset + index.chunk_length + i for i in range(0, index.message_index_length, 23)}
    for place in sorted(places):
        content[place] ^= 1 << rng.randrange(8)
        path.write_bytes(content)
        with pytest.raises(LogError) as caught:
            check_log(path)
        line = str(caught.value)
        assert "\n" not in line
        first, last = re.search(r": bytes? (\d+)(?: to (\d+))?:", line).groups()
        if last is not None and "chunk" in line and "all chunks" not in line:
            assert int(first) <= place < int(last)
            assert "/cloth_sim/" in line or "/diagnostics" in line or "unknown" in line or "channel" in line
        content[place] = original[place]


def test_schedules_are_put_together_from_their_changes():
    scene = Scene.build(Pattern.from_json(handkerchief(0.2)), quality="draft")
    simulation = ScheduledSimulation(scene)
    follower, changes = ScheduleFollower(), []

    def note():
        change = follower.change(simulation.schedule)
        if change is not None:  # another tick is none
            changes.append(json.loads(json.dumps(change)))
        assert follower.change(simulation.schedule) is None
        assert list(schedule_from(changes)) == simulation.schedule

    assert follower.change(simulation.schedule) is None
    for move in (
        lambda: simulation.advance(0.01),
        lambda: simulation.advance(0.01),
        lambda: simulation.advance(0.02),
        lambda: simulation.advance(0.02, lambda _: True),
        lambda: simulation.advance(0.02),
        simulation.tick,
        simulation.tick,
        lambda: simulation.settle(lambda simulation: simulation.steps % 7 == 0 or simulation.steps > 2000),
        lambda: simulation.settle(lambda _: True),
    ):
        move()
        note()
    assert all(len(change["motions"]) == 1 for change in changes)  # only what is new
    seen = schedule_from(changes)
    kinds = [(motion.kind, motion.count) for motion in seen]
    assert kinds == [("advance", 2), ("advance", 2), ("advance", 1), ("tick", 1), ("settle", 1), ("settle", 1)]
    again = ScheduledSimulation(scene)
    assert repeat(again, seen, lambda other: other.steps == simulation.steps) is None
    assert np.array_equal(again.positions, simulation.positions)
    assert again.state_hash() == simulation.state_hash()
