"""Names, types and delivery guarantees of everything the simulator sends and receives."""

from dataclasses import dataclass

__all__ = [
    "BODY",
    "BODY_MARKER",
    "CLOCK",
    "DEFAULT_NODE_NAME",
    "DIAGNOSTICS",
    "GARMENT",
    "LATCHED",
    "PARAMETERS",
    "PATTERN",
    "REPORT",
    "SCHEDULE",
    "VOLATILE",
    "Qos",
    "Topic",
]

DEFAULT_NODE_NAME = "/cloth_sim"


@dataclass(frozen=True)
class Qos:
    """Quality of service of a topic, always reliable and keep-last: meshes are too large for best effort."""

    depth: int
    latched: bool
    """Transient local: a late joiner receives the last `depth` messages (REP 2003 for maps)."""

    def to_yaml(self) -> str:
        """The form of rosbag2 in a log, with the integers of `rmw/types.h` that every ROS 2 distribution reads."""
        unlimited = "{sec: 9223372036, nsec: 854775807}"
        return "\n".join(
            (
                "- history: 1",
                f"  depth: {self.depth}",
                "  reliability: 1",
                f"  durability: {1 if self.latched else 2}",
                f"  deadline: {unlimited}",
                f"  lifespan: {unlimited}",
                "  liveliness: 1",
                f"  liveliness_lease_duration: {unlimited}",
                "  avoid_ros_namespace_conventions: false",
            )
        )


LATCHED = Qos(depth=1, latched=True)
VOLATILE = Qos(depth=10, latched=False)


@dataclass(frozen=True)
class Topic:
    """A topic of the node. `name` is relative to the node's own name unless it starts with a slash."""

    name: str
    message_type: str
    qos: Qos

    def resolve(self, node_name: str = DEFAULT_NODE_NAME) -> str:
        """Full name below a node whose fully qualified name is `node_name`."""
        return self.name if self.name.startswith("/") else f"{node_name}/{self.name}"


PATTERN = Topic("pattern", "std_msgs/msg/String", LATCHED)
BODY = Topic("body", "shape_msgs/msg/Mesh", LATCHED)
PARAMETERS = Topic("parameters", "std_msgs/msg/String", LATCHED)
"""In logs alone: with which values a run was made."""
SCHEDULE = Topic("schedule", "std_msgs/msg/String", LATCHED)
"""In logs alone: how a run was moved, for who repeats it."""
GARMENT = Topic("garment", "visualization_msgs/msg/Marker", LATCHED)
BODY_MARKER = Topic("body_marker", "visualization_msgs/msg/Marker", LATCHED)
REPORT = Topic("report", "std_msgs/msg/String", LATCHED)
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", VOLATILE)
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", VOLATILE)
