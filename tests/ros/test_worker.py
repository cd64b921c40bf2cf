"""The worker behind the node, without a ROS graph: what it accepts, what it refuses, and what it sends meanwhile."""

import json
import re
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_core.body import Body
from cloth_core.errors import ClothError, SimulationError
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.messages import decode_marker, decode_string
from cloth_sim_ros.run_sender import RunSender
from cloth_sim_ros.scene_inputs import Limits, SceneParameters
from cloth_sim_ros.topics import BODY_MARKER, CLOCK, DIAGNOSTICS, GARMENT, REPORT
from cloth_sim_ros.worker import SimulationWorker, WorkerSettings

DRAFT = SceneParameters(quality="draft")
PATIENCE = 120.0
"""How long a test waits for what must happen, compilation included [s]."""


class Listener:
    """Keeps all that it hears."""

    def __init__(self):
        self.changed = threading.Condition()
        self.messages = []
        self.lines = []
        self.warnings = []
        self.subscribed = True

    def wants_frames(self):
        return self.subscribed

    def send(self, topic, message):
        self._keep(self.messages, (topic, message))

    def inform(self, line):
        self._keep(self.lines, line)

    def warn(self, line):
        self._keep(self.warnings, line)

    def _keep(self, where, what):
        with self.changed:
            where.append(what)
            self.changed.notify_all()

    def wait(self, condition):
        with self.changed:
            assert self.changed.wait_for(condition, PATIENCE), (self.lines, self.warnings)

    def of(self, topic):
        return [bytes(message) for found, message in list(self.messages) if found is topic]


class Bench:
    """A worker with its listener."""

    def __init__(self, directory):
        self.listener = Listener()
        limits = Limits(max_particles=10_000)
        self.settings = WorkerSettings(record_directory=str(directory / "records"), limits=limits)
        self.worker = SimulationWorker(self.listener, parameters=DRAFT, settings=self.settings)

    def give(self, text, box=True):
        """Loads a pattern, on the box or in free fall, and waits for its garment."""
        ready = sum("is ready" in line for line in self.listener.lines)
        if box:
            self.worker.load_body(BOX_VERTICES, BOX_TRIANGLES)
        self.worker.load_pattern(text)
        self.listener.wait(lambda: sum("is ready" in line for line in self.listener.lines) > ready)

    def wait_for_report(self, count=1):
        self.listener.wait(lambda: len(self.listener.of(REPORT)) >= count)
        return json.loads(decode_string(self.listener.of(REPORT)[-1]))

    def wait_for_state(self, state):
        deadline = time.monotonic() + PATIENCE
        while self.worker.describe()["state"] != state:
            assert time.monotonic() < deadline, self.worker.describe()
            time.sleep(0.01)

    def wait_until_moved(self):
        before = self.time()
        deadline = time.monotonic() + PATIENCE
        while self.time() == before:
            assert time.monotonic() < deadline, self.worker.describe()
            time.sleep(0.01)

    def time(self):
        return self.worker.describe()["progress"]["simulated_time"]

    def last_points(self):
        return decode_marker(self.listener.of(GARMENT)[-1]).points


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    bench.worker.close()


def reference(text, box=True):
    """The simulation that the worker should be running."""
    body = Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES) if box else None
    return Simulation(Scene.build(Pattern.from_json(text), body, quality="draft", gravity=DRAFT.gravity))


@pytest.mark.parametrize("command", ["start", "step", "drape", "reset", "save"])
def test_without_a_pattern_there_is_nothing_to_do(bench, command):
    with pytest.raises(ClothError, match=f"^{command}: there is no garment"):
        getattr(bench.worker, command)()
    assert bench.worker.describe()["state"] == "waiting for a pattern"


def test_drape_gives_the_same_garment_and_report_as_the_core(bench):
    bench.give(handkerchief())
    bench.worker.drape()
    report = bench.wait_for_report()
    bench.wait_for_state("rest")
    expected = reference(handkerchief())
    expected_report = expected.settle()
    assert report["state_sha256"] == expected_report.state_sha256
    assert report["settled"]
    assert bench.last_points().tobytes() == expected.positions[expected.triangles].tobytes()
    assert bench.worker.describe()["report"] == report
    stamps = [decode_marker(data).stamp for data in bench.listener.of(GARMENT)]
    assert stamps[-1] - stamps[0] == pytest.approx(1e9 * expected.time, abs=1)
    assert stamps == sorted(set(stamps))


def test_start_lets_it_move_and_pause_halts_it(bench):
    bench.give(handkerchief(), box=False)
    assert bench.worker.start() == "running"
    bench.wait_until_moved()
    bench.worker.pause()
    # Saving is done between two ticks, so once it has been done twice the last one is over and its frame is sent.
    for count in (1, 2):
        bench.worker.save()
        bench.listener.wait(lambda count=count: sum(line.startswith("saved") for line in bench.listener.lines) == count)
    assert bench.worker.describe()["state"] == "paused"
    halted, frames = bench.time(), len(bench.listener.of(GARMENT))
    time.sleep(0.2)
    assert (bench.time(), len(bench.listener.of(GARMENT))) == (halted, frames)
    bench.worker.start()
    bench.wait_until_moved()


def test_a_step_is_one_frame_of_simulated_time(bench):
    bench.give(handkerchief(), box=False)
    for number in (1, 2):
        bench.worker.step()
        bench.wait_for_state("paused")
        bench.listener.wait(lambda number=number: len(bench.listener.of(GARMENT)) >= number + 1)
    expected = reference(handkerchief(), box=False)
    for _ in range(2):
        expected.advance(1 / 30)
    assert bench.last_points().tobytes() == expected.positions[expected.triangles].tobytes()


def test_reset_puts_the_garment_back(bench):
    bench.give(handkerchief())
    first = bench.last_points()
    bench.worker.drape()
    bench.wait_for_report()
    assert (bench.last_points() != first).any()
    with pytest.raises(ClothError, match="the run is over; reset it first"):
        bench.worker.start()
    with pytest.raises(ClothError, match="the run is over; reset it first"):
        bench.worker.step()
    bench.worker.reset()
    bench.listener.wait(lambda: (bench.last_points() == first).all())
    bench.wait_for_state("paused")
    assert bench.time() == 0.0
    assert bench.worker.describe()["report"] is None


def test_drape_after_rest_starts_again(bench):
    bench.give(handkerchief())
    bench.worker.drape()
    first = bench.wait_for_report()
    bench.worker.drape()
    second = bench.wait_for_report(2)
    assert second["state_sha256"] == first["state_sha256"]


def test_a_run_without_support_ends_with_its_reason(bench):
    bench.give(handkerchief(), box=False)
    bench.worker.drape()
    report = bench.wait_for_report()
    assert not report["settled"]
    assert "nothing supports the garment" in report["rest_reason"]
    bench.wait_for_state("paused")


@pytest.mark.parametrize(
    ("load", "complaint"),
    [
        (lambda worker: worker.load_pattern("{}"), "the key 'properties' is missing"),
        (lambda worker: worker.load_pattern(handkerchief(size=1e-9)), "panel 'cloth'"),
        (lambda worker: worker.load_pattern(handkerchief(size=3.0)), "max_particles = 10000"),
        (lambda worker: worker.load_body(BOX_VERTICES * np.nan, BOX_TRIANGLES), "not finite"),
        (lambda worker: worker.load_body(1e5 * BOX_VERTICES, BOX_TRIANGLES), "scale"),
    ],
)
def test_what_cannot_be_used_is_refused_and_the_old_garment_goes_on(bench, load, complaint):
    bench.give(handkerchief(0.25), box=False)
    scene = bench.worker.describe()["scene"]
    bench.worker.start()
    load(bench.worker)
    bench.listener.wait(lambda: bench.listener.warnings)
    [line] = bench.listener.warnings
    assert re.match("(pattern|body) refused: ", line)
    assert complaint in line
    assert "\n" not in line
    bench.wait_for_state("running")
    bench.wait_until_moved()
    description = bench.worker.describe()
    assert description["scene"] == scene
    assert description["refused"] == line
    bench.worker.diagnose()
    assert line.encode() in bench.listener.of(DIAGNOSTICS)[-1]
    # The next good one is taken, and clears the complaint.
    bench.give(handkerchief())
    assert bench.worker.describe()["refused"] is None


def test_of_a_good_body_and_a_bad_pattern_together_the_body_is_kept(bench):
    bench.give(handkerchief(0.2), box=False)
    with bench.worker._builder._wake:  # so that both are there when the builder looks
        bench.worker.load_body(BOX_VERTICES, BOX_TRIANGLES, "box")
        bench.worker.load_pattern(handkerchief(size=3.0))
    bench.listener.wait(lambda: bench.listener.warnings and len(bench.listener.of(GARMENT)) > 1)
    bench.wait_for_state("paused")
    scene = bench.worker.describe()["scene"]
    assert scene["body"] == "box"
    assert len(bench.listener.warnings) == 1


def test_a_second_pattern_replaces_the_first_mid_run(bench):
    bench.give(handkerchief(0.2), box=False)
    bench.worker.start()
    bench.wait_until_moved()
    first = decode_marker(bench.listener.of(GARMENT)[-1])
    bench.give(handkerchief(0.3), box=False)
    bench.wait_for_state("running")
    bench.wait_until_moved()
    second = decode_marker(bench.listener.of(GARMENT)[-1])
    assert len(second.points) > len(first.points)
    assert (second.namespace, second.identifier) == (first.namespace, first.identifier)
    assert second.stamp > first.stamp


def test_auto_start(bench):
    bench.worker.configure(DRAFT, WorkerSettings(auto_start=True))
    bench.give(handkerchief(), box=False)
    bench.wait_until_moved()
    assert bench.worker.describe()["progress"]["simulated_time"] > 0.0


def test_parameters_act_with_the_next_reset(bench):
    bench.give(handkerchief(), box=False)
    bench.worker.configure(SceneParameters(quality="draft", gravity=0.0, frame_id="room"), bench.settings)
    assert decode_marker(bench.listener.of(GARMENT)[-1]).frame_id == "map"
    bench.worker.reset()
    bench.listener.wait(lambda: decode_marker(bench.listener.of(GARMENT)[-1]).frame_id == "room")
    bench.wait_for_state("paused")
    bench.worker.step()
    bench.listener.wait(lambda: len(bench.listener.of(GARMENT)) >= 3)
    assert bench.last_points() == pytest.approx(decode_marker(bench.listener.of(GARMENT)[0]).points)


def test_limits_hold_for_a_reset_with_a_finer_quality(bench):
    bench.give(handkerchief(), box=False)
    limits = Limits(max_particles=200)
    bench.worker.configure(SceneParameters(quality="fine"), WorkerSettings(limits=limits))
    bench.worker.reset()
    bench.listener.wait(lambda: bench.listener.warnings)
    assert "max_particles = 200" in bench.listener.warnings[-1]
    bench.wait_for_state("paused")
    assert bench.worker.describe()["scene"]["particles"] <= 200


@pytest.mark.parametrize("error", [SimulationError("particle 3: left all bounds"), ZeroDivisionError("division")])
@pytest.mark.parametrize("place", [(Simulation, "tick"), (RunSender, "begin")])
def test_a_run_that_fails_says_so_and_the_next_garment_is_served(bench, monkeypatch, place, error):
    def fail(*_):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(*place, fail)
        bench.worker.configure(DRAFT, replace(bench.settings, auto_start=True))
        bench.worker.load_pattern(handkerchief())
        bench.listener.wait(lambda: bench.listener.warnings)
        assert bench.listener.warnings[0].startswith("the run failed: ")
        assert str(error) in bench.listener.warnings[0]
        bench.wait_for_state("paused")
        bench.worker.diagnose()
        assert bench.listener.warnings[0].encode() in bench.listener.of(DIAGNOSTICS)[-1]
    bench.give(handkerchief())
    assert bench.wait_for_report()["settled"]
    bench.worker.diagnose()
    assert b"failed" not in bench.listener.of(DIAGNOSTICS)[-1]


def test_frames_that_nobody_wants_are_not_made(bench):
    bench.listener.subscribed = False
    bench.give(handkerchief())
    bench.worker.drape()
    bench.wait_for_report()
    # The first and the last one are kept for whoever joins later.
    assert len(bench.listener.of(GARMENT)) == 2


def test_the_body_is_shown_before_there_is_a_pattern(bench):
    bench.worker.load_body(BOX_VERTICES, BOX_TRIANGLES)
    bench.listener.wait(lambda: bench.listener.of(BODY_MARKER))
    points = decode_marker(bench.listener.of(BODY_MARKER)[0]).points
    assert points.tolist() == BOX_VERTICES[BOX_TRIANGLES].reshape(-1, 3).tolist()


def test_save_writes_mesh_and_report(bench, tmp_path):
    bench.give(handkerchief())
    bench.worker.drape()
    report = bench.wait_for_report()
    answers = [bench.worker.save(), bench.worker.save()]
    bench.listener.wait(lambda: sum(line.startswith("saved") for line in bench.listener.lines) == 2)
    meshes = sorted((tmp_path / "records").glob("*.glb"))
    reports = sorted((tmp_path / "records").glob("*.json"))
    assert len(meshes) == len(reports) == 2
    for answer in answers:
        assert sum(str(path) in answer for path in (*meshes, *reports)) == 2
    assert all(json.loads(path.read_text()) == report for path in reports)
    mesh = trimesh.load(meshes[0], force="mesh")
    assert len(mesh.faces) == report["triangles"]


def test_save_into_a_place_that_is_no_directory_is_refused(bench, tmp_path):
    bench.give(handkerchief())
    (tmp_path / "records").write_text("in the way")
    for command in (bench.worker.save, lambda: bench.worker.record(True)):
        with pytest.raises(ClothError, match=r"record_directory .*set it to a directory that can be written"):
            command()


def test_a_recording_holds_all_that_was_sent(bench):
    bench.give(handkerchief())
    path = bench.worker.record(True).removeprefix("recording ")
    with pytest.raises(ClothError, match="is being recorded; stop that first"):
        bench.worker.record(True)
    assert bench.worker.describe()["recording"] == path
    bench.worker.drape()
    report = bench.wait_for_report()
    bench.worker.diagnose()
    assert bench.worker.record(False) == f"recorded {path}"
    with pytest.raises(ClothError, match="nothing is being recorded"):
        bench.worker.record(False)
    with LogReader(path) as log:
        assert log.patterns() == [handkerchief()]
        assert log.body()[0].tolist() == BOX_VERTICES.tolist()
        assert log.report() == report
        parameters = log.parameters()
        logged = [message.data for message in log.messages(GARMENT)]
        assert log.count(DIAGNOSTICS) == 1
    assert parameters["quality"] == "draft"
    # The same bytes as were sent, from the first frame of the recording on.
    assert logged == bench.listener.of(GARMENT)[-len(logged) :]
    assert len(logged) > 2  # the start, what came between (as often as the wall clock asks), and rest


def test_a_recording_goes_on_over_a_second_pattern(bench):
    bench.give(handkerchief(0.2), box=False)
    path = bench.worker.record(True).removeprefix("recording ")
    bench.worker.start()
    bench.wait_until_moved()
    bench.give(handkerchief(0.3), box=False)
    bench.wait_until_moved()
    bench.worker.close()
    with LogReader(path) as log:
        assert log.patterns() == [handkerchief(0.2), handkerchief(0.3)]
        counts = [len(frame.corners) for frame in log.frames()]
    # The runs do not overlap: all frames of the first lie before those of the second.
    assert counts == sorted(counts)
    assert len(set(counts)) == 2


def test_closing_in_the_middle_of_everything_leaves_a_log(bench):
    bench.give(handkerchief(), box=False)
    path = bench.worker.record(True).removeprefix("recording ")
    bench.worker.start()
    bench.worker.load_pattern(handkerchief(0.6))
    bench.worker.close()
    with LogReader(path) as log:
        assert log.count(GARMENT) >= 1


def test_the_clock_never_runs_back_though_two_threads_send_it(tmp_path):
    bench = Bench(tmp_path)
    bench.worker.close()
    bench.settings = replace(bench.settings, publish_clock=True)
    bench.worker = SimulationWorker(bench.listener, parameters=DRAFT, settings=bench.settings)
    try:
        bench.give(handkerchief(0.2))
        bench.worker.start()
        deadline = time.monotonic() + PATIENCE
        # 400 messages, and as many more as it takes until the run has got under way.
        while len(sent := bench.listener.of(CLOCK)) < 400 or sent[-1] == sent[0]:
            bench.worker.diagnose()  # with the time of the last message, while the run is already further
            assert time.monotonic() < deadline
        stamps = [deserialize_message(data, Clock).clock for data in bench.listener.of(CLOCK)]
    finally:
        bench.worker.close()
    moments = [stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps]
    assert moments == sorted(moments)
    assert moments[-1] > moments[0]
