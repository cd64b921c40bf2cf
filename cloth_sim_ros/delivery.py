"""How messages get to all subscribers of a topic that keeps the last one only."""

import os
import time
from collections.abc import Callable, MutableMapping
from importlib import resources
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Empty

from cloth_sim_ros.deferred_message import Message
from cloth_sim_ros.unlocked_publisher import Outgoing, unlocked

__all__ = ["Departure", "PacedPublisher", "configure_fast_dds"]

PATIENCE = 0.1
"""How long a message waits until all subscribers have the one before [s]."""
IMPATIENCE = 0.01
"""The same once one of them has not had it in time: it may have been killed or stopped [s]."""
DEPARTURE_PATIENCE = 5.0
"""How long a message waits until the one before has left at all [s]."""
POLL_INTERVAL = 0.001
"""Between two looks at who has received it [s]."""


class Departure:
    """Tells whether DDS has passed on what was handed to it, be there subscribers that will never receive it or not.

    One thread of DDS sends all messages of a participant, in their order, and is held up for a while where the shared
    memory of a new participant has to be checked. A message that waits for it is lost if the next one replaces it. So
    each is followed by an empty message to the node itself, which comes through when all before it have been sent.

    Args:
        node: gets a publisher and a subscription on a topic that `ros2 topic list` hides
    """

    TOPIC = "~/_sent"

    def __init__(self, node: Node) -> None:
        self._publisher = unlocked(node.create_publisher(Empty, self.TOPIC, QoSProfile(depth=1)))
        # Whether its messages are ever taken does not matter.
        node.create_subscription(Empty, self.TOPIC, lambda _: None, QoSProfile(depth=1))
        self._message = bytes(serialize_message(Empty()))

    def mark(self) -> None:
        """Says that something has been handed over."""
        self._publisher.publish(self._message)

    def is_over(self) -> bool:
        """Whether all has been sent that was handed over before the last mark."""
        return self._publisher.wait_for_all_acked(Duration())


class PacedPublisher:
    """Sends a message once all subscribers have received the last one, which it replaces in the publisher's memory.

    Otherwise two messages in quick succession, or a subscriber that gets too little of the processor, cost the first.
    A subscriber that does not answer any more holds up one message, and those after it hardly; but each has left
    before the next one replaces it.

    Args:
        publisher: reliable, of depth 1
        departure: of the same node
    """

    def __init__(self, publisher: Outgoing, departure: Departure) -> None:
        self._publisher = publisher
        self._departure = departure
        self._in_time = True

    def publish(self, message: Message) -> None:
        """Publishes CDR bytes as they are; waits, at worst for seconds."""
        data = bytes(message)  # encoded while the one before is still on its way
        # Each look is one of no duration: with one, rclpy waits with Python's lock held, and no service would answer.
        _wait(self._departure.is_over, DEPARTURE_PATIENCE)
        self._in_time = _wait(
            lambda: self._publisher.wait_for_all_acked(Duration()), PATIENCE if self._in_time else IMPATIENCE
        )
        self._publisher.publish(data)
        self._departure.mark()


def _wait(condition: Callable[[], bool], longest: float) -> bool:
    """Whether the condition has come to hold within this time [s]."""
    deadline = time.monotonic() + longest
    while not (holds := condition()) and time.monotonic() < deadline:
        time.sleep(POLL_INTERVAL)
    return holds


def configure_fast_dds(environment: MutableMapping[str, str] = os.environ) -> None:
    """Sets what Fast DDS and its middleware layer read when a context is made; what a user has set stays."""
    # Otherwise whoever publishes sends by itself, and waits for a slow reliable subscriber with all threads of Python.
    environment.setdefault("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")
    own = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
    profiles = resources.files("cloth_sim_ros").joinpath("dds/fastdds.xml")
    if isinstance(profiles, Path) and not any(environment.get(name) for name in own):
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profiles)
