"""How messages get to all subscribers of a topic that keeps the last one only."""

import os
import time
from collections.abc import MutableMapping
from importlib import resources
from pathlib import Path

from rclpy.duration import Duration
from rclpy.publisher import Publisher

__all__ = ["PacedPublisher", "configure_fast_dds"]

PATIENCE = 0.1
"""How long a message waits until all subscribers have the one before [s]."""
IMPATIENCE = 0.005
"""The same once one of them has not had it in time: it may have been killed or stopped [s]."""
POLL_INTERVAL = 0.001
"""Between two looks at who has received it [s]."""


class PacedPublisher:
    """Sends a message once all subscribers have received the last one, which it replaces in the publisher's memory.

    Otherwise two messages in quick succession, or a subscriber that gets too little of the processor, cost the first.
    A subscriber that does not answer any more holds up one message, and those after it hardly.

    Args:
        publisher: reliable, of depth 1
    """

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._in_time = True

    def publish(self, data: bytes) -> None:
        """Publishes CDR bytes as they are."""
        deadline = time.monotonic() + (PATIENCE if self._in_time else IMPATIENCE)
        # With a duration it would wait with Python's lock held, and no service would answer.
        while not (received := self._publisher.wait_for_all_acked(Duration())) and time.monotonic() < deadline:
            time.sleep(POLL_INTERVAL)
        self._in_time = received
        self._publisher.publish(data)


def configure_fast_dds(environment: MutableMapping[str, str] = os.environ) -> None:
    """Sets what Fast DDS and its middleware layer read when a context is made; what a user has set stays."""
    # Otherwise whoever publishes sends by itself, and waits for a slow reliable subscriber with all threads of Python.
    environment.setdefault("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")
    own = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
    profiles = resources.files("cloth_sim_ros").joinpath("dds/fastdds.xml")
    if isinstance(profiles, Path) and not any(environment.get(name) for name in own):
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profiles)
