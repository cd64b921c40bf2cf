"""Two DDS participants of one node: frames leave by shared memory, services never touch it.

All that a participant sends goes through one lock. If a subscriber is killed in the moment in which it holds the lock
of its shared memory, who sends to it waits for a second, a time that is compiled into Fast DDS, and holds that one
lock meanwhile. A participant that only knows UDP never waits for another process. But UDP drops what its receiver does
not take out of the socket in time, which large messages pay for; so those have a participant of their own.
"""

import ctypes
import os
from collections.abc import MutableMapping
from importlib import resources
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from cloth_sim_ros.delivery import configure_fast_dds

__all__ = ["FrameParticipant", "configure_node"]

_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
_NAMESPACE = "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"
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


class FrameParticipant:
    """Where a node publishes what is large: a hidden node, `_<name>_frames`, in a context of its own.

    Args:
        owner: names the hidden one and lends its namespace, domain and, from the command line, its enclave
    """

    def __init__(self, owner: Node) -> None:
        profiles = os.environ.get(_PROFILES, "")
        if profiles in (_profile("fastdds_node"), _profile("fastdds_node_localhost")):
            _load_default_profile(_with_shared_memory(Path(profiles)))
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


def _with_shared_memory(path: Path) -> bytes:
    """The participant of a file of profiles, with the file's other transport before its own."""
    text = path.read_text(encoding="utf-8")
    # Transports are loaded already, and known by their names.
    participant = text[text.index("<participant ") : text.index("</participant>") + len("</participant>")]
    for old, new in (
        ("cloth_sim_node", "cloth_sim_frames"),
        ("<userTransports>", "<userTransports><transport_id>shared_memory</transport_id>"),
    ):
        assert participant.count(old) == 1
        participant = participant.replace(old, new)
    return f'<profiles xmlns="{_NAMESPACE}">{participant}</profiles>'.encode()


def _load_default_profile(text: bytes) -> None:
    """Has participants that are made from now on follow another default profile.

    Fast DDS reads the file of the environment once in a process. The calls are of its public interface; the middleware
    layer has none for it. Where they are not to be found, as with another middleware, all participants do as the first.
    """
    factory = "_ZN8eprosima7fastdds3dds24DomainParticipantFactory"
    try:
        fast_dds = ctypes.CDLL("libfastrtps.so.2.14", mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
        get_instance = fast_dds[f"{factory}12get_instanceEv"]
        load_string = fast_dds[f"{factory}24load_XML_profiles_stringEPKcm"]
        set_default = fast_dds[f"{factory}27set_default_participant_qosERKNS1_20DomainParticipantQosE"]
        from_profile = ctypes.byref(
            ctypes.c_byte.in_dll(fast_dds, "_ZN8eprosima7fastdds3dds23PARTICIPANT_QOS_DEFAULTE")
        )
    except (OSError, AttributeError, ValueError):
        return
    get_instance.restype = ctypes.c_void_p
    instance = ctypes.c_void_p(get_instance())
    load_string(instance, ctypes.c_char_p(text), ctypes.c_size_t(len(text)))
    set_default(instance, from_profile)


def _profile(name: str) -> str:
    """Path of a file of Fast DDS profiles of this package."""
    path = resources.files("cloth_sim_ros").joinpath(f"dds/{name}.xml")
    return str(path) if isinstance(path, Path) else ""
