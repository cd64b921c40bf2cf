"""Two DDS participants of one node: frames leave by shared memory, services never touch it.

All that a participant sends goes through one lock. If a subscriber is killed in the moment in which it holds the lock
of its shared memory, who sends to it waits for a second, a time that is compiled into Fast DDS, and holds that one
lock meanwhile. A participant that only knows UDP never waits for another process. But UDP drops what its receiver does
not take out of the socket in time, which large messages pay for; so those have a participant of their own.
"""

import os
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from cloth_sim_ros.delivery import configure_fast_dds

__all__ = ["FrameParticipant", "configure_node", "without_shared_memory"]

_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def configure_node(environment: MutableMapping[str, str] = os.environ) -> None:
    """Sets what Fast DDS and its middleware layer read when the node's contexts are made; what a user has set stays."""
    before = environment.get(_PROFILES)
    configure_fast_dds(environment)
    if environment.get(_PROFILES) == before and before != _profile("fastdds"):
        return
    if environment.get(_RANGE) != "LOCALHOST" and environment.get("ROS_LOCALHOST_ONLY") != "1":
        environment[_PROFILES] = _profile("fastdds_node")
    elif not environment.get("ROS_STATIC_PEERS"):
        # The middleware layer would add shared memory to every participant of such a process.
        environment[_PROFILES] = _profile("fastdds_node_localhost")
        environment[_RANGE] = "SYSTEM_DEFAULT"
        environment.pop("ROS_LOCALHOST_ONLY", None)


@contextmanager
def without_shared_memory(environment: MutableMapping[str, str] = os.environ) -> Iterator[None]:
    """The participant that is made within has no shared memory, if `configure_node` has set the profile."""
    if environment.get(_TRANSPORTS) or "fastdds_node" not in environment.get(_PROFILES, ""):
        yield
        return
    environment[_TRANSPORTS] = "UDPv4"
    try:
        yield
    finally:
        del environment[_TRANSPORTS]


class FrameParticipant:
    """Where a node publishes what is large: a hidden node, `_<name>_frames`, in a context of its own.

    Args:
        owner: names the hidden one and lends its namespace, domain and, from the command line, its enclave
    """

    def __init__(self, owner: Node) -> None:
        self._context = Context()
        rclpy.init(
            context=self._context,
            domain_id=owner.context.get_domain_id(),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node(
            f"_{owner.get_name()}_frames",
            context=self._context,
            namespace=owner.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", Parameter.Type.BOOL, False)],
        )

    def close(self) -> None:
        """Takes it off the graph; may be called once."""
        self.node.destroy_node()  # type: ignore[no-untyped-call]
        self._context.try_shutdown()


def _profile(name: str) -> str:
    """Path of a file of Fast DDS profiles of this package."""
    path = resources.files("cloth_sim_ros").joinpath(f"dds/{name}.xml")
    return str(path) if isinstance(path, Path) else ""
