"""No frame is lost on the way to a subscriber that is fast enough, whatever becomes of the others."""

import os
import signal
import subprocess
import sys
import time

import pytest
from node_client import PATIENCE
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from cloth_sim_ros.delivery import IMPATIENCE, PacedPublisher, configure_fast_dds
from cloth_sim_ros.rclpy_topics import qos_profile
from cloth_sim_ros.topics import REPORT

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
COUNT = 200


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.setenv("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")  # as the node
    context = Context()
    context.init()
    node = Node("publisher", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield node.create_publisher(String, "/delivery", qos_profile(REPORT.qos))
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
        paced = PacedPublisher(publisher)
        for number in range(COUNT):
            paced.publish(String(data=f"{number:08d}" + 300_000 * "x"))
        deadline = time.monotonic() + PATIENCE
        while len(path.read_text().split()) < COUNT and time.monotonic() < deadline:
            time.sleep(0.05)
        process.kill()
        process.wait()
    assert path.read_text().split() == [f"{number:08d}" for number in range(COUNT)]


def test_a_subscriber_that_is_stopped_does_not_stop_the_publisher(publisher, tmp_path):
    with open(tmp_path / "received.txt", "w") as output:
        (process,) = subscribers(publisher, 1, output)
        process.send_signal(signal.SIGSTOP)
        paced = PacedPublisher(publisher)
        try:
            for number in range(50):
                paced.publish(String(data=str(number)))
            assert not publisher.wait_for_all_acked(Duration())  # it has indeed not received them
            process.send_signal(signal.SIGCONT)
            deadline = time.monotonic() + PATIENCE
            while not publisher.wait_for_all_acked(Duration()):
                assert time.monotonic() < deadline
                time.sleep(10 * IMPATIENCE)
        finally:
            process.kill()
            process.wait()


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
