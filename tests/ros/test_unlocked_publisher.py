"""Publishing past rclpy: the same bytes and errors, and other threads run meanwhile; by rclpy where that fails."""

import ctypes
import hashlib
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from node_client import PATIENCE, stop
from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import String

from cloth_sim_ros import unlocked_publisher
from cloth_sim_ros.messages import encode_string
from cloth_sim_ros.rclpy_topics import qos_profile
from cloth_sim_ros.topics import REPORT
from cloth_sim_ros.unlocked_publisher import UnlockedPublisher, unlocked

SUBSCRIBER = """
import hashlib, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("subscriber")
qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
show = lambda data: print(len(data), hashlib.sha256(data).hexdigest(), flush=True)
node.create_subscription(String, "/unlocked", show, qos, raw=True)
rclpy.spin(node)
"""


class Lines:
    """Stands for a logger."""

    def __init__(self):
        self.debugged = []

    def debug(self, line):
        self.debugged.append(line)


def other_layout(monkeypatch):
    """As where the libraries that rclpy has loaded are not found by their names; what is logged about it."""
    lines = Lines()

    def not_loaded(name, mode):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(unlocked_publisher.ctypes, "CDLL", not_loaded)
    monkeypatch.setattr(unlocked_publisher, "get_logger", lambda _: lines)
    unlocked_publisher._rcl.cache_clear()
    return lines


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.setenv("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")  # as the node
    unlocked_publisher._rcl.cache_clear()
    context = Context()
    context.init()
    node = Node("publisher", context=context)
    publisher = node.create_publisher(String, "/unlocked", qos_profile(REPORT.qos))
    publisher.context = context
    yield publisher
    node.destroy_node()
    context.try_shutdown()
    unlocked_publisher._rcl.cache_clear()


@pytest.fixture(params=["past rclpy", "by rclpy"])
def outgoing(request, publisher, monkeypatch):
    if request.param == "by rclpy":
        other_layout(monkeypatch)
    outgoing = unlocked(publisher)
    assert isinstance(outgoing, UnlockedPublisher) == (request.param == "past rclpy")
    return outgoing


@pytest.fixture
def subscriber(publisher, tmp_path):
    """Another process, and what it writes of each message that it receives."""
    path = tmp_path / "received.txt"
    with open(path, "w") as output:
        process = subprocess.Popen([sys.executable, "-c", SUBSCRIBER], stdout=output)
    try:
        wait(publisher.get_subscription_count)
        time.sleep(0.5)  # the other direction is discovered by itself
        yield process, path
    finally:
        process.kill()
        process.wait()


def wait(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_another_process_receives_the_bytes_that_were_sent(outgoing, subscriber):
    """Of all sizes up to that of a frame; in the bytes there are zeros, where a C string would end."""
    _, path = subscriber
    characters = np.random.default_rng(1).integers(0, 128, 1_440_000, dtype=np.uint8).tobytes().decode("ascii")
    assert "\x00" in characters[:1000]
    # Multiples of four, which the transport does not fill up: four bytes, the count, the text and its closing zero.
    sent = [encode_string(characters[:count]) for count in (3, 1_003, 70_003, 600_003, 1_439_999)]
    for data in sent:
        assert len(data) % 4 == 0
        wait(lambda: outgoing.wait_for_all_acked(Duration()))
        outgoing.publish(data)
    wait(lambda: path.read_text().count("\n") == len(sent))
    expected = [f"{len(data)} {hashlib.sha256(data).hexdigest()}" for data in sent]
    assert path.read_text().splitlines() == expected


def test_a_subscriber_that_is_stopped_has_not_received_and_once_it_runs_it_has(outgoing, subscriber):
    process, _ = subscriber
    stop(process)
    outgoing.publish(encode_string("x"))
    assert outgoing.wait_for_all_acked(Duration(seconds=0.2)) is False
    process.send_signal(signal.SIGCONT)
    wait(lambda: outgoing.wait_for_all_acked(Duration()))


def test_another_thread_wakes_up_the_subscriber_that_is_waited_for(publisher, subscriber):
    """It could not while this one kept Python's lock: the time would run out first."""
    process, _ = subscriber
    outgoing = unlocked(publisher)
    stop(process)
    outgoing.publish(encode_string("x"))
    assert not outgoing.wait_for_all_acked(Duration())
    # The other thread comes to run only where this one lets it, which nothing but waiting does within the next minute.
    interval, waking = sys.getswitchinterval(), threading.Thread(target=process.send_signal, args=(signal.SIGCONT,))
    sys.setswitchinterval(60.0)
    try:
        waking.start()
        received = outgoing.wait_for_all_acked(Duration(seconds=15.0))
    finally:
        sys.setswitchinterval(interval)
        waking.join()
    assert received


def test_after_the_context_was_shut_down_rcl_refuses_and_says_why(outgoing, publisher):
    outgoing.publish(encode_string("before"))
    publisher.context.shutdown()
    with pytest.raises(RCLError, match="context is invalid"):
        outgoing.publish(encode_string("after"))
    with pytest.raises(RCLError, match="context is invalid"):
        outgoing.wait_for_all_acked(Duration())


def test_a_publisher_that_was_destroyed_is_named_and_not_touched(outgoing, publisher):
    publisher.destroy()
    with pytest.raises(InvalidHandle):
        outgoing.publish(encode_string("after"))
    with pytest.raises(InvalidHandle):
        outgoing.wait_for_all_acked(Duration())


def test_where_rcl_is_not_reached_there_is_rclpy_and_one_debug_line(publisher, monkeypatch):
    lines = other_layout(monkeypatch)
    assert unlocked(publisher) is publisher
    assert unlocked(publisher) is publisher
    assert lines.debugged == ["publishing keeps Python's lock: librcl.so: cannot open shared object file"]


def test_libraries_without_the_functions_are_left_alone(publisher, monkeypatch):
    real = ctypes.CDLL
    other_layout(monkeypatch)
    monkeypatch.setattr(unlocked_publisher.ctypes, "CDLL", lambda name, mode: real("libc.so.6"))
    assert unlocked(publisher) is publisher


def test_a_message_lies_in_memory_as_rcutils_has_it():
    """rcutils itself fills one in, and touches nothing behind it."""
    message_type, allocator_type = unlocked_publisher._SerializedMessage, unlocked_publisher._Allocator

    class Guarded(ctypes.Structure):
        _fields_ = (("message", message_type), ("guard", ctypes.c_uint8 * 64))

    rcutils = ctypes.CDLL("librcutils.so")
    rcutils.rcutils_get_default_allocator.restype = allocator_type
    allocator = rcutils.rcutils_get_default_allocator()
    guarded = Guarded(message_type(), (ctypes.c_uint8 * 64)(*range(64)))
    message = guarded.message
    assert rcutils.rcutils_uint8_array_init(ctypes.byref(message), ctypes.c_size_t(1234), ctypes.byref(allocator)) == 0
    assert message.buffer is not None
    assert (message.buffer_length, message.buffer_capacity) == (0, 1234)
    assert bytes(message.allocator) == bytes(allocator)
    assert all((allocator.allocate, allocator.deallocate, allocator.reallocate, allocator.zero_allocate))
    assert rcutils.rcutils_uint8_array_fini(ctypes.byref(message)) == 0
    assert message.buffer is None
    assert list(guarded.guard) == list(range(64))
