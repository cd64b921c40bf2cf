"""A message is encoded once, in a thread that wants it, and not at all if nobody does."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import handkerchief
from test_worker import Bench, reference

from cloth_core.coarse_start import interpolation_between
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros.background_log import BackgroundLog
from cloth_sim_ros.deferred_message import DeferredMessage
from cloth_sim_ros.delivery import PacedPublisher
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.messages import MarkerEncoder, decode_marker
from cloth_sim_ros.node import ClothSimNode
from cloth_sim_ros.outlet import Outlet
from cloth_sim_ros.run_messages import RunMessages
from cloth_sim_ros.sending_thread import SendingThread
from cloth_sim_ros.topics import GARMENT, REPORT

PATIENCE = 30.0
POSITIONS = np.random.default_rng(1).normal(size=(40, 3))


class Encoder:
    """Encodes when it may, and notes by whom it was called."""

    def __init__(self, data=b"frame"):
        self.data, self.threads, self.may = data, [], threading.Event()

    def __call__(self):
        self.threads.append(threading.current_thread().name)
        assert self.may.wait(PATIENCE)
        return self.data


def test_two_threads_want_it_at_once_and_it_is_encoded_once():
    encode, got = Encoder(), []
    message = DeferredMessage(5, encode)
    threads = [threading.Thread(target=lambda: got.append(bytes(message))) for _ in range(2)]
    for thread in threads:
        thread.start()
    threads[0].join(0.2)
    threads[1].join(0.2)
    assert all(thread.is_alive() for thread in threads)  # the second waits for the first
    encode.may.set()
    for thread in threads:
        thread.join(PATIENCE)
    assert got == [b"frame", b"frame"]
    assert got[0] is got[1]
    assert len(encode.threads) == 1


def test_its_size_is_known_before_and_encodes_nothing():
    encode = Encoder()
    assert len(DeferredMessage(5, encode)) == 5
    assert encode.threads == []


def test_what_it_was_made_of_is_let_go_once_it_is_encoded():
    encode = Encoder()
    encode.may.set()
    message = DeferredMessage(5, encode)
    bytes(message)
    assert message._encode is None


@pytest.mark.parametrize("count", [0, 1, 2, 333])
@pytest.mark.parametrize("frame_id", ["map", "a", "base_link", ""])
def test_a_garment_is_the_same_bytes_now_and_later_and_as_long_as_said(count, frame_id):
    triangles = np.random.default_rng(2).integers(0, len(POSITIONS), (count, 3)).astype(np.int32)
    messages = RunMessages(1_700_000_000_000_000_000, frame_id)
    later = messages.deferred_garment(0.25, POSITIONS, triangles)
    now = messages.garment(0.25, POSITIONS, triangles)
    assert len(later) == len(now)
    assert bytes(later) == now


class Listener:
    """Sends as the node does, to a publisher that is held up or keeps what it gets."""

    def __init__(self, publisher):
        self.errors, self.warnings, self.paced = [], [], PacedPublisher(publisher, Departed())
        self.sending = SendingThread(lambda what, error: self.errors.append(error))

    def send(self, topic, message):
        self.sending.send(topic.name, self.paced.publish, message)

    def warn(self, line):
        self.warnings.append(line)


class Departed:
    def mark(self):
        pass

    def is_over(self):
        return True


class Publisher:
    def __init__(self):
        self.sent = []

    def wait_for_all_acked(self, timeout):
        return True

    def publish(self, data):
        self.sent.append(data)


def test_a_frame_that_is_sent_and_recorded_is_encoded_once_and_not_by_who_sends_it(tmp_path):
    publisher, path = Publisher(), tmp_path / "run.mcap"
    listener = Listener(publisher)
    outlet = Outlet(listener, "/cloth_sim")
    outlet.start_log(path)
    encoders = [Encoder(b"frame %d" % number) for number in range(20)]
    for number, encode in enumerate(encoders):
        outlet.send(GARMENT if number % 2 else REPORT, DeferredMessage(len(encode.data), encode), 1 + number)
        if number == 7:  # it has come so far without waiting for any
            for each in encoders:
                each.may.set()
    assert outlet.stop_log() == path
    listener.sending.close(PATIENCE)
    expected = [encode.data for encode in encoders]
    assert publisher.sent == expected
    with LogReader(path) as reader:
        messages = list(reader.messages())
    assert [message.data for message in messages] == expected
    assert [message.log_time for message in messages] == [1 + number for number in range(20)]
    assert [len(encode.threads) for encode in encoders] == 20 * [1]
    used = {name for encode in encoders for name in encode.threads}
    assert used <= {"cloth_sim recording", "cloth_sim sending"}
    assert not listener.errors
    assert not listener.warnings


def test_what_is_dropped_is_not_encoded(tmp_path):
    """By a log that has ended with an error; and nobody listens."""
    path = tmp_path / "run.mcap"
    writer = LogWriter(path)
    writer.close()
    told = []
    log = BackgroundLog(writer, lambda _, error: told.append(str(error)))
    encoders = [Encoder() for _ in range(5)]
    for number, encode in enumerate(encoders):
        log.write(GARMENT, number, DeferredMessage(5, encode))
    with pytest.raises(LogError, match="it is closed"):
        log.close()
    assert len(told) == 1
    assert [encode.threads for encode in encoders] == 5 * [[]]


def test_a_frame_that_cannot_be_encoded_ends_the_log_with_one_line_and_the_next_is_sent(tmp_path):
    def broken():
        raise MemoryError("no room for a frame")

    path, publisher, told = tmp_path / "run.mcap", Publisher(), []
    listener = Listener(publisher)
    log = BackgroundLog(LogWriter(path), lambda _, error: told.append(str(error)))
    for number, message in enumerate((b"first", DeferredMessage(5, broken), b"third")):
        log.write(REPORT, number, message)
        listener.send(REPORT, message)
    with pytest.raises(LogError, match="MemoryError: no room for a frame"):
        log.close()
    listener.sending.close(PATIENCE)
    assert told == [f"log {path}: MemoryError: no room for a frame; please report it"]
    assert [type(error) for error in listener.errors] == [MemoryError]
    assert publisher.sent == [b"first", b"third"]
    with LogReader(path) as reader:
        assert [message.data for message in reader.messages()] == [b"first"]


def test_waiting_frames_count_with_the_size_that_they_will_have():
    gate, encode = threading.Event(), Encoder(bytes(60))
    sending = SendingThread(lambda what, error: None, capacity=100)
    sending.send("held up", lambda _: gate.wait(PATIENCE), DeferredMessage(60, encode))
    blocked = threading.Thread(target=sending.send, args=("next", bytes, DeferredMessage(60, encode)))
    blocked.start()
    blocked.join(0.2)
    assert blocked.is_alive()
    assert encode.threads == []
    encode.may.set()
    gate.set()
    blocked.join(PATIENCE)
    assert not blocked.is_alive()
    sending.close(PATIENCE)
    assert len(encode.threads) == 1  # by `bytes`, which sent the second


def frames_of(bench):
    return [message for topic, message in list(bench.listener.messages) if topic is GARMENT]


def test_frames_of_a_run_are_encoded_later_and_hold_what_the_garment_was(tmp_path, monkeypatch):
    """The listener wants no bytes before the run has moved on; the truth is a simulation of its own."""
    encoded = []
    encode = MarkerEncoder.encode

    def noted(self, stamp, positions, triangles):
        encoded.append(stamp)
        return encode(self, stamp, positions, triangles)

    monkeypatch.setattr(MarkerEncoder, "encode", noted)
    bench = Bench(tmp_path)
    try:
        bench.give(handkerchief(), box=False)
        bench.worker.start()
        bench.listener.wait(lambda: len(frames_of(bench)) >= 5)
        bench.worker.pause()
        bench.wait_for_state("paused")
        frames = frames_of(bench)
        assert encoded == []
        markers = [decode_marker(bytes(frame)) for frame in frames]
        assert len(encoded) == len(frames)
    finally:
        bench.worker.close()
    simulation = reference(handkerchief(), box=False)
    for marker in markers:
        while round(simulation.time * 1e9) < marker.stamp - markers[0].stamp:
            simulation.tick()
        assert np.array_equal(marker.points, simulation.positions[simulation.triangles].reshape(-1, 3))
    assert not np.array_equal(markers[0].points, markers[-1].points)


@pytest.mark.parametrize("coarse", [False, True])
def test_positions_that_were_taken_stay_as_they_were(coarse):
    """At a coarse start too, where they are interpolated."""
    scene = Scene.build(Pattern.load("rectangle"), settings=Settings(spacing=0.1))
    moved = simulation = Simulation(scene)
    if coarse:
        moved = Simulation(scene.with_spacing(0.2))
        simulation._coarse = (moved, interpolation_between(moved.scene.garment, scene.garment))
    taken = simulation.positions
    before = taken.copy()
    moved.tick()
    assert np.array_equal(taken, before)
    assert not np.array_equal(simulation.positions, before)


def test_the_node_hands_a_frame_on_without_encoding_it():
    publisher, encode = Publisher(), Encoder()
    listener = Listener(publisher)
    node = SimpleNamespace(_paced={GARMENT: listener.paced}, _sending=listener.sending)
    ClothSimNode.send(node, GARMENT, DeferredMessage(5, encode))  # or it would wait here
    encode.may.set()
    listener.sending.close(PATIENCE)
    assert publisher.sent == [b"frame"]
    assert encode.threads == ["cloth_sim sending"]
