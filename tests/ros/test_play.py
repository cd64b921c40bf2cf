"""Playing a log on a graph: the recorded bytes, in the recorded time, also for those who join late."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from clock import Clock
from node_client import Client
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy
from small_scenes import BOX_TRIANGLES, BOX_VERTICES

from cloth_core.body import Body
from cloth_core.errors import ClothError
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.play import play_log
from cloth_sim_ros.rclpy_topics import qos_profile, recorded_qos_profile
from cloth_sim_ros.run_recorder import RunRecorder
from cloth_sim_ros.topics import GARMENT, LATCHED, VOLATILE

FRAMES = 6
DURATION = 0.5


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with RunRecorder(path, ["{}"], Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES), {}) as recorder:
        for time_of_frame in np.linspace(0.0, DURATION, FRAMES):
            recorder.frame(time_of_frame, BOX_VERTICES + time_of_frame, BOX_TRIANGLES)
    return path


@pytest.fixture
def play():
    processes = []

    def start(path, **options):
        code = f"from cloth_sim_ros.play import play_log; play_log({str(path)!r}, **{options!r})"
        processes.append(subprocess.Popen([sys.executable, "-c", code], env=os.environ))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture
def client():
    client = Client()
    yield client
    client.close()


def logged_frames(path):
    """As they arrive: the transport fills up messages to a multiple of four bytes."""
    with LogReader(path) as log:
        return [message.data + bytes(-len(message.data) % 4) for message in log.messages(GARMENT)]


def test_plays_the_recorded_bytes_in_order(log, play, client):
    client.subscribe("garment", "body_marker")
    process = play(log, rate=0.5)
    frames = logged_frames(log)
    client.wait(lambda: frames[-1] in client.received["garment"])
    assert process.wait(60) == 0
    assert len(client.received["body_marker"]) == 1
    places = [frames.index(message) for message in client.received["garment"]]
    assert places == sorted(set(places))


@pytest.mark.parametrize("rate", [0.5, 4.0])
def test_plays_in_the_recorded_time(log, rate, monkeypatch):
    clock = Clock()
    monkeypatch.setattr("cloth_sim_ros.play.time", clock)
    moments = {}

    def publishing_takes_time(played, duration):
        assert duration == pytest.approx(DURATION)
        moments.setdefault(played, clock.monotonic())
        clock.sleep(0.003)

    play_log(log, rate=rate, progress=publishing_takes_time)
    played = np.array(list(moments))
    assert np.abs(played - np.linspace(0.0, DURATION, FRAMES)[:, None]).min(axis=1) == pytest.approx(0.0, abs=1e-9)
    # What is published takes no time from what comes after it, but from what belongs to the same moment.
    assert np.array(list(moments.values())) - moments[0.0] == pytest.approx(played / rate, abs=1e-6)


def test_loops_until_it_is_interrupted_and_serves_late_joiners(log, play, client):
    process = play(log, rate=5.0, loop=True)
    client.subscribe("garment")
    frames = logged_frames(log)
    client.wait(lambda: client.received["garment"].count(frames[-1]) >= 3)
    # Pattern and body were sent once, long ago; who comes late sees them all the same, and the garment as it is.
    late_joiner = Client(own_name="late_joiner")
    late_joiner.subscribe("garment", "body_marker", "body", "pattern")
    late_joiner.wait(lambda: all(late_joiner.received.values()))
    assert late_joiner.received["garment"][0] in frames
    assert late_joiner.last("pattern").data == "{}"
    body = late_joiner.last("body")
    assert [[v.x, v.y, v.z] for v in body.vertices] == BOX_VERTICES.tolist()
    assert len(late_joiner.last("body_marker").points) == 3 * len(BOX_TRIANGLES) == 3 * len(body.triangles)
    late_joiner.close()
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0


@pytest.mark.parametrize("qos", [LATCHED, VOLATILE])
def test_the_recorded_qos_is_the_one_of_the_node(qos):
    recorded, original = recorded_qos_profile(qos.to_yaml()), qos_profile(qos)
    assert recorded.get_c_qos_profile().to_dict() == original.get_c_qos_profile().to_dict()


def test_qos_as_newer_rosbag2_writes_it():
    text = "- {history: keep_all, depth: 3, reliability: best_effort, durability: transient_local}"
    profile = recorded_qos_profile(text)
    assert profile.history == HistoryPolicy.KEEP_ALL
    assert profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


@pytest.mark.parametrize("text", ["", "[]", "- history: sideways", ": : :", "- 3"])
def test_a_log_without_usable_qos_is_played_as_rosbag2_does(text):
    profile = recorded_qos_profile(text)
    assert (profile.depth, profile.durability) == (10, DurabilityPolicy.VOLATILE)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_rate_is_refused(log, rate):
    with pytest.raises(ClothError, match="cannot be played; use more than 0"):
        play_log(log, rate=rate)


def test_an_empty_log_is_refused(tmp_path):
    LogWriter(tmp_path / "empty.mcap").close()
    with pytest.raises(LogError, match="no message of the simulator"):
        play_log(tmp_path / "empty.mcap")
