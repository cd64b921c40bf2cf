"""Topics as rclpy wants them: message classes and quality of service."""

from typing import Any

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from shape_msgs.msg import Mesh
from std_msgs.msg import String
from visualization_msgs.msg import Marker

from cloth_sim_ros.topics import Qos

__all__ = ["MESSAGE_CLASSES", "qos_profile", "recorded_qos_profile"]

MESSAGE_CLASSES: dict[str, type[Any]] = {
    "std_msgs/msg/String": String,
    "shape_msgs/msg/Mesh": Mesh,
    "visualization_msgs/msg/Marker": Marker,
    "rosgraph_msgs/msg/Clock": Clock,
    "diagnostic_msgs/msg/DiagnosticArray": DiagnosticArray,
}


def qos_profile(qos: Qos) -> QoSProfile:
    """Quality of service of a topic of the simulator."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=qos.depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)


def recorded_qos_profile(offered: str) -> QoSProfile:
    """The first of the profiles in a log's `offered_qos_profiles`; what rosbag2 offers by default if there is none.

    The policies are integers, or names in logs of rosbag2 since its metadata version 9.
    """
    try:
        profile = yaml.safe_load(offered)[0]
        return QoSProfile(
            history=_policy(HistoryPolicy, profile["history"]),
            depth=int(profile["depth"]),
            reliability=_policy(ReliabilityPolicy, profile["reliability"]),
            durability=_policy(DurabilityPolicy, profile["durability"]),
        )
    except (yaml.YAMLError, LookupError, TypeError, ValueError):
        return QoSProfile(depth=10)


def _policy(policies: Any, value: int | str) -> Any:
    return policies[value.upper()] if isinstance(value, str) else policies(value)
