"""The real node in a process of its own, and a client of it in this one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from shape_msgs.msg import Mesh
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

__all__ = ["LATCHED", "Client", "NodeProcess", "stop"]

PATIENCE = 120.0
"""How long a test waits for what must happen, compilation included [s]."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TYPES = {"garment": Marker, "body_marker": Marker, "report": String, "pattern": String, "body": Mesh}


def stop(process: subprocess.Popen[Any]) -> None:
    """Stops a process until it gets SIGCONT; it does nothing any more once this returns."""
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED)


class NodeProcess:
    """`cloth_sim_node` with parameters, recording below `directory`."""

    def __init__(self, directory: Path, *arguments: str, **parameters: object) -> None:
        self.records = directory / "records"
        self._errors = open(directory / "stderr.txt", "w+")
        values = {"quality": "draft", "record_directory": str(self.records)} | parameters
        settings = [part for name, value in values.items() for part in ("-p", f"{name}:={value}")]
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from cloth_sim_ros.node import main; main()", "--ros-args", *settings, *arguments],
            stderr=self._errors,
            env=os.environ | {"ROS_LOG_DIR": str(directory)},
        )

    def end(self, number: int = signal.SIGINT) -> int:
        """Sends a signal and returns the exit code."""
        self._process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Exit code, once the process has ended."""
        return self._process.wait(PATIENCE)

    def is_running(self) -> bool:
        """False once the process has ended."""
        return self._process.poll() is None

    def errors(self) -> str:
        """What it has written to standard error."""
        self._errors.flush()
        return Path(self._errors.name).read_text()

    def kill(self) -> None:
        """Whatever the test has done to it, the process ends here."""
        self._process.kill()
        self._process.wait()
        self._errors.close()


class Client:
    """Another participant on the graph; keeps the raw bytes of all messages of the topics that it subscribes to."""

    def __init__(self, node_name: str = "/cloth_sim", own_name: str = "client") -> None:
        self.node_name = node_name
        self.process: NodeProcess | None = None
        """The process that must not end while this waits."""
        self.received: dict[str, list[bytes]] = {}
        self.diagnostics: list[DiagnosticArray] = []
        self._context = Context()
        self._context.init()
        self._node = Node(own_name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._clients: dict[str, Any] = {}
        self._poses: dict[str, Any] = {}
        self.pattern = self._node.create_publisher(String, f"{node_name}/pattern", LATCHED)
        self.body = self._node.create_publisher(Mesh, f"{node_name}/body", LATCHED)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)

    def subscribe(self, *names: str) -> None:
        """Listens to topics below the node."""
        for name in names:
            messages = self.received.setdefault(name, [])
            self._node.create_subscription(TYPES[name], f"{self.node_name}/{name}", messages.append, LATCHED, raw=True)

    def last(self, name: str) -> Any:
        """Last message of a topic, as rclpy decodes it."""
        return deserialize_message(self.received[name][-1], TYPES[name])

    def wait(self, condition: Callable[[], Any]) -> Any:
        """Spins until the condition holds, and returns its value."""
        deadline = time.monotonic() + PATIENCE
        while not (value := condition()):
            assert time.monotonic() < deadline
            assert self.process is None or self.process.is_running(), self.process.errors()
            self._executor.spin_once(0.05)
        return value

    def ask(self, name: str, request: Any, kind: Any) -> Any:
        """Answer of a service below the node that changes nothing, so that it can be asked for again.

        A service may see a request before it sees who waits for the answer, which is lost then: DDS discovers the two
        ways one after the other.
        """
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, f"{self.node_name}/{name}")
        client = self._clients[name]
        self.wait(client.service_is_ready)
        deadline = time.monotonic() + PATIENCE
        while True:
            future, until = client.call_async(request), time.monotonic() + 5.0
            self.wait(lambda future=future, until=until: future.done() or time.monotonic() > until)
            if future.done():
                return future.result()
            assert time.monotonic() < deadline

    def call(self, name: str, request: Any = None, kind: Any = Trigger) -> Any:
        """Answer of a service below the node."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, f"{self.node_name}/{name}")
        client = self._clients[name]
        self.wait(client.service_is_ready)
        future = client.call_async(request or kind.Request())
        self.wait(future.done)
        return future.result()

    def move_gripper(
        self, name: str, position: Any, orientation: Any = (0.0, 0.0, 0.0, 1.0), frame_id: str = "map"
    ) -> None:
        """Publishes the pose of a gripper, once the node listens."""
        if name not in self._poses:
            self._poses[name] = self._node.create_publisher(PoseStamped, f"{self.node_name}/{name}/pose", 10)
        self.wait(self._poses[name].get_subscription_count)
        message = PoseStamped()
        message.header.frame_id = frame_id
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, position)
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = map(float, orientation)
        self._poses[name].publish(message)

    def record(self, on: bool) -> Any:
        """Answer of ~/record."""
        return self.call("record", SetBool.Request(data=on), SetBool)

    def describe(self) -> dict[str, Any]:
        """Content of ~/describe."""
        answer = self.ask("describe", Trigger.Request(), Trigger)
        assert answer.success
        content: dict[str, Any] = json.loads(answer.message)
        return content

    def wait_for_state(self, state: str) -> dict[str, Any]:
        """Content of ~/describe once the node is in that state."""
        found: dict[str, Any] = self.wait(lambda: (said := self.describe())["state"] == state and said)
        return found

    def set_parameter(self, name: str, value: object) -> Any:
        """Result of setting a parameter, with its reason."""
        message: ParameterMessage = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.ask("set_parameters", request, SetParameters).results[0]

    def get_parameter(self, name: str) -> Any:
        """Value message of a parameter."""
        return self.ask("get_parameters", GetParameters.Request(names=[name]), GetParameters).values[0]

    def describe_parameters(self, names: list[str]) -> Any:
        """Descriptors."""
        request = DescribeParameters.Request(names=names)
        return self.ask("describe_parameters", request, DescribeParameters).descriptors

    def close(self) -> None:
        """Leaves the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
