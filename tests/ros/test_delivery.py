"""No frame is lost on the way to a subscriber that is fast enough, whatever becomes of the others."""

import os
import signal
import subprocess
import sys
import time

import pytest
from clock import Clock
from node_client import PATIENCE, Client, NodeProcess, stop
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from small_scenes import handkerchief
from std_msgs.msg import String

from cloth_sim_ros.delivery import IMPATIENCE, Departure, PacedPublisher, configure_fast_dds
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.messages import decode_marker, encode_string
from cloth_sim_ros.rclpy_topics import qos_profile
from cloth_sim_ros.topics import GARMENT, REPORT
from cloth_sim_ros.unlocked_publisher import unlocked

SUBSCRIBER = """
import sys, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("subscriber")
qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(String, "/delivery", lambda message: print(message.data[:8], flush=True), qos)
rclpy.spin(node)
"""
LISTENER = """
import sys, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import Marker
from cloth_sim_ros.messages import decode_marker
rclpy.init()
node = rclpy.create_node("listener")
qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
show = lambda data: print(decode_marker(data).stamp, flush=True)
node.create_subscription(Marker, "/cloth_sim/garment", show, qos, raw=True)
rclpy.spin(node)
"""
CROWD = """
import sys, time, rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import Marker
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
nodes = []
for number in range(4):
    context = Context()
    context.init()
    nodes.append(Node(f"one_of_a_crowd_{number}", context=context))
    nodes[-1].create_subscription(Marker, "/cloth_sim/garment", lambda _: None, qos)
print("ready", flush=True)
time.sleep(60)
"""
COUNT = 200


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.setenv("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")  # as the node
    context = Context()
    context.init()
    node = Node("publisher", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    publisher = node.create_publisher(String, "/delivery", qos_profile(REPORT.qos))
    publisher.departure = Departure(node)
    yield publisher
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


def subscribers(publisher, count, output):
    processes = [subprocess.Popen([sys.executable, "-c", SUBSCRIBER], stdout=output) for _ in range(count)]
    deadline = time.monotonic() + PATIENCE
    while publisher.get_subscription_count() < count:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(0.5)
    return processes


def test_messages_in_quick_succession_all_arrive(publisher, tmp_path):
    """Of 300 kB, as a frame of 4,000 triangles; by a publisher that keeps the last one only."""
    path = tmp_path / "received.txt"
    with open(path, "w") as output:
        (process,) = subscribers(publisher, 1, output)
        paced = PacedPublisher(unlocked(publisher), publisher.departure)
        for number in range(COUNT):
            paced.publish(encode_string(f"{number:08d}" + 300_000 * "x"))
        deadline = time.monotonic() + PATIENCE
        while len(path.read_text().split()) < COUNT and time.monotonic() < deadline:
            time.sleep(0.05)
        process.kill()
        process.wait()
    assert path.read_text().split() == [f"{number:08d}" for number in range(COUNT)]


def test_a_subscriber_that_is_stopped_does_not_stop_the_publisher(publisher, tmp_path):
    with open(tmp_path / "received.txt", "w") as output:
        (process,) = subscribers(publisher, 1, output)
        stop(process)
        paced = PacedPublisher(unlocked(publisher), publisher.departure)
        try:
            for number in range(50):
                paced.publish(encode_string(str(number)))
            assert not publisher.wait_for_all_acked(Duration())  # it has indeed not received them
            process.send_signal(signal.SIGCONT)
            deadline = time.monotonic() + PATIENCE
            while not publisher.wait_for_all_acked(Duration()):
                assert time.monotonic() < deadline
                time.sleep(10 * IMPATIENCE)
        finally:
            process.kill()
            process.wait()


class Killed:
    """Stands for a publisher whose only subscriber never answers again."""

    def __init__(self):
        self.sent = []

    def wait_for_all_acked(self, _):
        return False

    def publish(self, data):
        self.sent.append(data)


class HeldUp:
    """Stands for the sending thread of DDS while it is held up for some time [s]."""

    def __init__(self, duration):
        self.duration, self.until = duration, 0.0

    def mark(self):
        self.until = time.monotonic() + self.duration

    def is_over(self):
        return time.monotonic() >= self.until


def test_no_message_is_replaced_before_it_has_left_though_a_killed_subscriber_is_waited_for():
    killed, held_up = Killed(), HeldUp(0.3)
    paced = PacedPublisher(killed, held_up)
    for number in range(4):
        left = held_up.until
        paced.publish(b"%d" % number)
        assert held_up.until - held_up.duration >= left
    assert killed.sent == [b"0", b"1", b"2", b"3"]


def test_a_killed_subscriber_holds_up_one_message_and_those_after_it_hardly(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("cloth_sim_ros.delivery.time", clock)
    paced = PacedPublisher(Killed(), HeldUp(0.0))
    waits = []
    for _ in range(10):
        began = clock.monotonic()
        paced.publish(b"frame")
        waits.append(clock.monotonic() - began)
    first, *others = waits
    assert first == pytest.approx(0.1, abs=0.002)
    assert others == pytest.approx([0.01] * 9, abs=0.002)


def test_a_departure_is_over_whether_a_subscriber_receives_or_not(publisher, tmp_path):
    departure = publisher.departure
    with open(tmp_path / "received.txt", "w") as output:
        (process,) = subscribers(publisher, 1, output)
        process.kill()
        process.wait()
        publisher.publish(String(data="x"))
        departure.mark()
        deadline = time.monotonic() + PATIENCE
        while not departure.is_over():
            assert time.monotonic() < deadline
            time.sleep(IMPATIENCE)
        assert not publisher.wait_for_all_acked(Duration())


def test_a_living_subscriber_gets_every_frame_while_killed_ones_are_waited_for(tmp_path):
    """Subscribers come, four at once, and are killed (SIGKILL) while DDS still waits for those before."""
    environment = dict(os.environ)
    configure_fast_dds(environment)
    client = Client()
    client.process = node = NodeProcess(tmp_path, real_time_factor=0.25, publish_rate=50.0)
    heard = tmp_path / "heard.txt"
    running = []
    try:
        client.pattern.publish(encode_string(handkerchief(0.5)))  # which falls and falls
        client.wait(lambda: client.describe()["scene"])
        with open(heard, "w") as output:
            command = [sys.executable, "-c", LISTENER]
            listener = subprocess.Popen(command, stdout=output, stderr=subprocess.DEVNULL, env=environment)
        running.append(listener)
        client.wait(heard.read_text)
        path = client.record(True).message.removeprefix("recording ")
        assert client.call("start").success
        for _ in range(5):
            crowd = subprocess.Popen(
                [sys.executable, "-c", CROWD], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
            )
            running.append(crowd)
            crowd.stdout.readline()
            time.sleep(1.0)
            crowd.kill()
            crowd.wait()
        assert client.call("pause").success
        assert client.describe()["state"] == "paused"
        assert client.record(False).success
        with LogReader(path) as log:
            logged = [decode_marker(message.data).stamp for message in log.messages(GARMENT)]
        client.wait(lambda: str(logged[-1]) in heard.read_text().split())
    finally:
        for process in running:
            process.kill()
            process.wait()
        node.kill()
        client.close()
    received = [int(line) for line in heard.read_text().split()]
    assert len(logged) > 100
    # The first has been sent before, when there was no log.
    assert [stamp for stamp in received if logged[0] < stamp <= logged[-1]] == logged[1:]


def test_what_a_user_has_set_for_fast_dds_stays():
    environment: dict[str, str] = {}
    configure_fast_dds(environment)
    assert environment["RMW_FASTRTPS_PUBLICATION_MODE"] == "ASYNCHRONOUS"
    assert os.path.exists(environment["FASTRTPS_DEFAULT_PROFILES_FILE"])
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"):
        mine = {name: "mine", "RMW_FASTRTPS_PUBLICATION_MODE": "AUTO"}
        given = dict(mine)
        configure_fast_dds(given)
        assert given == mine
