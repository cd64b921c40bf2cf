"""Logs: other people's readers agree with what was simulated, and a log always ends as one."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros import log_writer
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_repair import end_log
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.messages import encode_string
from cloth_sim_ros.run_recorder import RunRecorder
from cloth_sim_ros.topics import GARMENT, REPORT

LATCHED_TOPICS = ["body", "body_marker", "garment", "parameters", "pattern", "report"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A recorded drape: the log, and what was in memory while it was written."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    body = Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES, "box")
    pattern = Pattern.from_json(handkerchief(), "handkerchief")
    simulation = Simulation(Scene.build(pattern, body, quality="draft"))
    corners = []

    class Spy(RunRecorder):
        def frame(self, simulated_time, positions, triangles):
            corners.append((simulated_time, positions[triangles]))
            super().frame(simulated_time, positions, triangles)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_writer, "CHUNK_SIZE", 100_000)  # so that a small log has many
        with Spy(path, [pattern.source], body, {"fabric": "cotton_poplin"}) as recorder:
            recorder.follow(simulation)
            report = simulation.settle(recorder.follow)
            recorder.finish(simulation, report)
    return path, pattern, body, corners, report


def points_of(marker):
    return np.array([[point.x, point.y, point.z] for point in marker.points]).reshape(-1, 3, 3)


def test_a_drape_leaves_frames_until_it_rests(run):
    _, _, _, corners, report = run
    times = [time for time, _ in corners]
    assert report.settled
    assert times[0] == 0.0
    assert times[-1] == report.simulated_time
    assert np.diff(times)[:-1].min() >= 1 / 30 - 1e-9
    assert len(times) > 20 * report.simulated_time


def test_rosbags_reads_every_message(run):
    path, pattern, body, corners, report = run
    types = get_typestore(Stores.ROS2_JAZZY)
    messages = {}
    with Reader(path) as reader:
        for connection, log_time, data in reader.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((log_time, message))
        assert reader.message_count == sum(len(found) for found in messages.values())
    assert sorted(messages) == ["/cloth_sim/" + name for name in LATCHED_TOPICS] + ["/diagnostics"]

    frames = messages["/cloth_sim/garment"]
    assert len(frames) == len(corners)
    for (log_time, marker), (time, expected) in zip(frames, corners, strict=True):
        assert points_of(marker).tobytes() == expected.tobytes()
        assert log_time == marker.header.stamp.sec * 10**9 + marker.header.stamp.nanosec
        assert abs(log_time - frames[0][0] - 1e9 * time) <= 1
    [(_, mesh)] = messages["/cloth_sim/body"]
    assert np.array([[v.x, v.y, v.z] for v in mesh.vertices]).tobytes() == body.vertices.tobytes()
    assert np.array([t.vertex_indices for t in mesh.triangles]).tolist() == body.triangles.tolist()
    [(_, marker)] = messages["/cloth_sim/body_marker"]
    assert points_of(marker).tobytes() == body.vertices[body.triangles].tobytes()
    [(_, text)] = messages["/cloth_sim/pattern"]
    assert text.data == pattern.source
    [(_, text)] = messages["/cloth_sim/report"]
    assert json.loads(text.data)["state_sha256"] == report.state_sha256
    [(_, text)] = messages["/cloth_sim/parameters"]
    assert json.loads(text.data) == {"fabric": "cotton_poplin"}


def test_mcap_ros2_support_reads_every_message(run):
    path, _, _, corners, _ = run
    frames, count = [], 0
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            count += 1
            if channel.topic == "/cloth_sim/garment":
                frames.append(points_of(message))
        assert count == reader.get_summary().statistics.message_count
    for frame, (_, expected) in zip(frames, corners, strict=True):
        assert frame.tobytes() == expected.tobytes()


def test_the_reader_here_gives_back_what_went_in(run):
    path, pattern, body, corners, report = run
    with LogReader(path) as log:
        frames = list(log.frames())
        assert log.count(GARMENT) == len(frames) == len(corners)
        assert log.patterns() == [pattern.source]
        assert log.report() == json.loads(report.to_json())
        vertices, triangles = log.body()
        assert log.duration == pytest.approx(report.simulated_time, abs=1e-6)
    assert vertices.tobytes() == body.vertices.tobytes()
    assert triangles.tolist() == body.triangles.tolist()
    for frame, (time, expected) in zip(frames, corners, strict=True):
        assert frame.time == pytest.approx(time, abs=1e-8)
        assert frame.corners.tobytes() == expected.tobytes()
        vertices, triangles = frame.mesh()
        assert (vertices[triangles] == expected).all()
        assert len(np.unique(vertices, axis=0)) == len(vertices)


def test_qos_lets_playback_latch(run):
    path = run[0]
    with Reader(path) as reader:
        profiles = {connection.topic: connection.ext.offered_qos_profiles for connection in reader.connections}
    for name in LATCHED_TOPICS:
        [profile] = profiles[f"/cloth_sim/{name}"]
        assert (profile.depth, profile.durability) == (1, QosDurability.TRANSIENT_LOCAL)
    [profile] = profiles["/diagnostics"]
    assert (profile.depth, profile.durability) == (10, QosDurability.VOLATILE)
    for [profile] in profiles.values():
        assert (profile.history, profile.reliability) == (QosHistory.KEEP_LAST, QosReliability.RELIABLE)


def test_container_has_what_players_need(run):
    path = run[0]
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert len(list(reader.iter_messages())) == summary.statistics.message_count
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    for channel in summary.channels.values():
        # Integers: what rosbag2 of all distributions reads.
        [profile] = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        assert isinstance(profile["durability"], int)
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    assert all(index.message_index_offsets for index in summary.chunk_indexes)


def test_an_existing_file_is_not_touched(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with pytest.raises(LogError, match="the file exists"):
        LogWriter(path)
    assert path.read_text() == "precious"


def test_a_missing_directory_is_named(tmp_path):
    with pytest.raises(LogError, match="No such file or directory; choose a directory"):
        LogWriter(tmp_path / "missing" / "run.mcap")


def test_a_log_that_is_removed_meanwhile_is_missed(tmp_path):
    log = LogWriter(tmp_path / "run.mcap")
    log.write(REPORT, 1, encode_string("{}"))
    (tmp_path / "run.mcap").unlink()
    with pytest.raises(LogError, match="the file was removed"):
        log.close()
    assert log.closed


def test_a_closed_log_takes_no_more(tmp_path):
    log = LogWriter(tmp_path / "run.mcap")
    log.close()
    log.close()
    with pytest.raises(LogError, match="closed"):
        log.write(REPORT, 1, encode_string("{}"))


def test_an_error_while_recording_leaves_a_log(tmp_path):
    with pytest.raises(ZeroDivisionError), RunRecorder(tmp_path / "run.mcap", [handkerchief()], None, {}):
        raise ZeroDivisionError
    with LogReader(tmp_path / "run.mcap") as log:
        assert log.patterns() == [handkerchief()]
        assert log.body() is None
        assert log.report() == {}


# A limit on the size of a file stands for a full disk. Noise does not compress, so a frame fills its share.
FULL_DISK = """
import resource, signal, sys
import numpy as np
from cloth_core.errors import ClothError
from cloth_sim_ros.run_recorder import RunRecorder
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
rng = np.random.default_rng(1)
triangles = np.arange(30000, dtype=np.int32).reshape(-1, 3)
recorder = RunRecorder(sys.argv[1], ["{}"], None, {})
try:
    for number in range(20):
        recorder.frame(number / 30, rng.normal(size=(30000, 3)), triangles)
    recorder.close()
except ClothError as error:
    print(error)
recorder.close()
"""


@pytest.mark.parametrize("size", [4_000_000, 4_321_000])
def test_a_full_disk_ends_the_log_after_its_last_whole_chunk(tmp_path, size):
    path = tmp_path / "run.mcap"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path), str(size)], capture_output=True, text=True, check=True
    )
    [line] = done.stdout.splitlines()
    assert f"log {path}: File too large" in line
    assert path.stat().st_size <= size
    rng = np.random.default_rng(1)
    with LogReader(path) as log:
        frames = list(log.frames())
        assert f"{len(list(log.messages()))} messages before it are kept" in line
    assert len(frames) >= 2
    for frame in frames:
        assert frame.corners.tobytes() == rng.normal(size=(30000, 3)).tobytes()
    with Reader(path) as reader:
        assert len(list(reader.messages())) == reader.message_count


def test_a_cut_log_is_refused_and_can_be_ended(run, tmp_path):
    whole = run[0].read_bytes()
    with open(run[0], "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    ends = [chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length for chunk in chunks]
    assert len(ends) > 3
    with LogReader(run[0]) as log:
        order = [(message.topic, message.log_time, message.data) for message in log.messages()]
    path = tmp_path / "cut.mcap"
    for size in (50, chunks[0].chunk_start_offset + 1, *ends, ends[-1] - 1, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match="it was cut off"):
            LogReader(path)
        with open(path, "rb+") as stream:
            kept = end_log(stream)
        with LogReader(path) as log:
            messages = [(message.topic, message.log_time, message.data) for message in log.messages()]
        assert len(messages) == kept
        assert set(messages) <= set(order)
        assert (kept == len(order)) == (size >= ends[-1])


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"PK\x03\x04" + bytes(100), b"\x89MCAP0\r\n" + bytes(200)])
def test_a_file_that_is_no_log_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"^log .*run\.mcap: it (is not an MCAP file|was cut off)[^\n]*$"):
        LogReader(path)


def test_a_missing_log_is_refused(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        LogReader(tmp_path / "run.mcap")


def test_a_damaged_chunk_is_found(run, tmp_path):
    content = bytearray(run[0].read_bytes())
    with open(run[0], "rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[0]
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    with LogReader(path) as log, pytest.raises(LogError, match="damaged"):
        list(log.frames())


def test_recording_needs_no_ros():
    """As on a machine where rclpy is not installed."""
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "import cloth_sim_ros.run_recorder, cloth_sim_ros.log_reader, cloth_sim_ros.render, cloth_sim_ros.worker\n"
        "assert not any(name.split('.')[0].endswith('_msgs') for name in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])
