"""Whatever becomes of a subscriber and its shared memory, services answer; publishing leaves Python's lock alone."""

import ctypes
import mmap
import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from node_client import PATIENCE, Client, NodeProcess
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from small_scenes import handkerchief
from std_msgs.msg import String

from cloth_sim_ros.delivery import configure_fast_dds
from cloth_sim_ros.frame_participant import configure_node
from cloth_sim_ros.messages import decode_string, encode_string
from cloth_sim_ros.unlocked_publisher import UnlockedPublisher

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
PORT = re.compile(r"/dev/shm/fastrtps_port\d+$")
MUTEX = 0x5170
"""Where Fast DDS 2.14 has the lock that each sender to a port takes, in the shared memory of the port."""
SUBSCRIBER = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import Marker
rclpy.init()
node = rclpy.create_node("subscriber")
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(Marker, "/cloth_sim/garment", lambda _: print("frame", flush=True), qos, raw=True)
rclpy.spin(node)
"""


def name_of_profile(environment):
    return Path(environment[PROFILES]).stem


@pytest.mark.parametrize(
    ("given", "profile", "discovery"),
    [
        ({}, "fastdds_node", None),
        ({RANGE: "SUBNET"}, "fastdds_node", "SUBNET"),
        ({RANGE: "LOCALHOST"}, "fastdds_node_localhost", "SYSTEM_DEFAULT"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "fastdds_node_localhost", "SYSTEM_DEFAULT"),
        # Only the middleware layer knows how to reach these.
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.1"}, "fastdds", "LOCALHOST"),
    ],
)
def test_a_profile_for_each_discovery_range(given, profile, discovery):
    environment = dict(given)
    configure_node(environment)
    assert name_of_profile(environment) == profile
    assert environment.get(RANGE) == discovery
    assert os.path.exists(environment[PROFILES])
    # Who has been started by a process with the profile for all others gets the same.
    inherited = dict(given)
    configure_fast_dds(inherited)
    configure_node(inherited)
    assert inherited == environment


@pytest.mark.parametrize("name", [PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", TRANSPORTS])
def test_what_a_user_has_set_stays(name):
    mine = {name: "mine", RANGE: "LOCALHOST", "RMW_FASTRTPS_PUBLICATION_MODE": "AUTO"}
    given = dict(mine)
    configure_node(given)
    assert given == mine


@contextmanager
def locked(pid):
    """Holds the locks of a process's shared memory, as if it had been killed while it had them."""
    libc = ctypes.CDLL(None)
    paths = {
        match.group() for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if (match := PORT.search(line))
    }
    held = []
    for path in sorted(paths):
        with open(path, "r+b") as file:
            memory = mmap.mmap(file.fileno(), 0)
        address = ctypes.addressof(ctypes.c_char.from_buffer(memory)) + MUTEX
        if libc.pthread_mutex_trylock(ctypes.c_void_p(address)) == 0:
            held.append((memory, address))
    try:
        assert held
        yield
    finally:
        for _, address in held:
            libc.pthread_mutex_unlock(ctypes.c_void_p(address))


def test_services_answer_while_a_killed_subscriber_holds_up_the_frames(tmp_path):
    """The most that can happen to frames: who sends them waits for a lock that nobody will ever release."""
    client = Client()
    client.process = node = NodeProcess(tmp_path, real_time_factor=0.1, publish_rate=50.0)
    client.subscribe("garment")
    frames = client.received["garment"]
    subscriber = None
    try:
        client.pattern.publish(encode_string(handkerchief(0.5)))  # which falls and falls
        client.wait(lambda: client.describe()["scene"])
        subscriber = subprocess.Popen([sys.executable, "-c", SUBSCRIBER], stdout=subprocess.PIPE)
        assert subscriber.stdout.readline()
        assert client.call("start").success
        client.wait(lambda: len(frames) > 10)
        subscriber.send_signal(signal.SIGSTOP)
        with locked(subscriber.pid):
            subscriber.kill()
            subscriber.wait()
            # Times at which frames and answers came in, until there are frames again after a gap.
            events = [(time.monotonic(), True)]
            deadline = time.monotonic() + PATIENCE
            while time.monotonic() < deadline:
                before = len(frames)
                client.describe()
                events.append((time.monotonic(), len(frames) > before))
                arrivals = [at for at, new in events if new]
                gaps = [(b - a, a, b) for a, b in pairwise(arrivals)]
                if gaps and max(gaps)[0] > 0.7 and len(arrivals) > 5:
                    break
                time.sleep(0.01)
            # Fast DDS waits for a second; if not, nothing has been held up, and this shows nothing.
            gap, left, right = max(gaps)
            assert gap > 0.7
        assert sum(left < at < right for at, _ in events) > 10
    finally:
        if subscriber is not None:
            subscriber.kill()
            subscriber.wait()
        node.kill()
        client.close()


@pytest.fixture
def talker():
    context = Context()
    context.init()
    node = Node("unlocked", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_what_is_published_without_the_lock_arrives(talker):
    qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = UnlockedPublisher(talker.create_publisher(String, "/unlocked", qos))
    texts = ["", "ü\0", 300_000 * "x"]
    for text in texts:
        publisher.publish(encode_string(text))
    client = Client(own_name="listener")
    heard = []
    try:
        client._node.create_subscription(String, "/unlocked", heard.append, qos, raw=True)
        client.wait(lambda: len(heard) == len(texts))
        client.wait(lambda: publisher.wait_for_all_acked(Duration()))
    finally:
        client.close()
    assert [decode_string(data) for data in heard] == texts


def test_others_run_while_it_waits(talker):
    """With a subscriber that is stopped, all is acknowledged never, and the other thread must not wait for that."""
    publisher = talker.create_publisher(String, "/unlocked", 10)
    code = "import rclpy; from std_msgs.msg import String; rclpy.init(); node = rclpy.create_node('stopped')\n"
    code += "node.create_subscription(String, '/unlocked', print, 10); print(1, flush=True); rclpy.spin(node)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline()
        deadline = time.monotonic() + PATIENCE
        while not publisher.get_subscription_count():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGSTOP)
        unlocked = UnlockedPublisher(publisher)
        unlocked.publish(encode_string("x"))
        answer = []
        waiting = threading.Thread(target=lambda: answer.append(unlocked.wait_for_all_acked(Duration(seconds=2.0))))
        waiting.start()
        turns = 0
        while waiting.is_alive():
            turns += 1
            time.sleep(0.01)
    finally:
        process.kill()
        process.wait()
    assert answer == [False]
    assert turns > 10


def test_after_the_end_of_its_context_it_refuses():
    context = Context()
    context.init()
    node = Node("ended", context=context)
    publisher = UnlockedPublisher(node.create_publisher(String, "/unlocked", 10))
    context.shutdown()
    with pytest.raises(RuntimeError, match="cannot publish"):
        publisher.publish(encode_string("x"))
    node.destroy_node()
