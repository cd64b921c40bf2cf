"""Publishes a log on the topics of a ROS graph, in its own time."""

import math
import os
import time
from collections.abc import Callable

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.utilities import ok, try_shutdown

from cloth_core.errors import ClothError
from cloth_sim_ros.delivery import configure_fast_dds
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import NANOSECONDS
from cloth_sim_ros.rclpy_topics import MESSAGE_CLASSES, recorded_qos_profile

__all__ = ["play_log"]

Progress = Callable[[float, float], None]

LONGEST_SLEEP = 0.1
"""Between two looks at whether playing is to end [s]."""
DISCOVERY_TIME = 3.0
"""How long the first message waits for somebody to listen [s]."""
LAST_DELIVERY = 5.0
"""How long the end waits for slow subscribers [s]."""


def play_log(
    path: str | os.PathLike[str], rate: float = 1.0, loop: bool = False, progress: Progress | None = None
) -> None:
    """Publishes all messages of a log with the quality of service that they were recorded with.

    Ends with the log, or on Ctrl-C. Topics of types that the simulator does not use are left out.

    Args:
        path: the log
        rate: 2 plays twice as fast as it was recorded
        loop: starts again at the end
        progress: called with the time played and the whole duration [s]

    Raises:
        LogError: the log cannot be read, or holds nothing that can be played.
        ClothError: a rate that is not above 0.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise ClothError(f"play: a rate of {rate} cannot be played; use more than 0")
    with LogReader(path) as log:
        first = [message for message in log.messages() if message.message_type in MESSAGE_CLASSES]
        if not first:
            raise LogError(f"log {log.path}: it holds no message of the simulator; record a run")
        configure_fast_dds()
        rclpy.init()
        node = Node("cloth_sim_play")
        try:
            _play(node, log, rate, loop, progress)
        except KeyboardInterrupt:
            pass
        finally:
            node.destroy_node()
            try_shutdown()


def _play(node: Node, log: LogReader, rate: float, loop: bool, progress: Progress | None) -> None:
    publishers = _create_publishers(node, log)
    _wait_for_subscribers(publishers)
    again = True
    while again and ok():
        began = time.monotonic()
        for message in log.messages():
            if message.topic not in publishers:
                continue
            played = (message.log_time - log.start) / NANOSECONDS
            if not _sleep_until(began + played / rate):
                return
            publishers[message.topic].publish(message.data)
            if progress is not None:
                progress(played, log.duration)
        again = loop
    for publisher in publishers.values():
        publisher.wait_for_all_acked(Duration(seconds=LAST_DELIVERY))


def _create_publishers(node: Node, log: LogReader) -> dict[str, Publisher]:
    publishers: dict[str, Publisher] = {}
    for message in log.messages():
        if message.topic not in publishers and message.message_type in MESSAGE_CLASSES:
            message_class = MESSAGE_CLASSES[message.message_type]
            qos = recorded_qos_profile(message.qos)
            publishers[message.topic] = node.create_publisher(message_class, message.topic, qos)
    return publishers


def _wait_for_subscribers(publishers: dict[str, Publisher]) -> None:
    """Until the first one is found, or long enough to say that there is none."""
    deadline = time.monotonic() + DISCOVERY_TIME
    while ok() and time.monotonic() < deadline:
        if any(publisher.get_subscription_count() for publisher in publishers.values()):
            return
        time.sleep(0.02)


def _sleep_until(moment: float) -> bool:
    """False if playing is to end."""
    while ok():
        left = moment - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, LONGEST_SLEEP))
    return False
