"""The ROS 2 node: topics, services and parameters around a `SimulationWorker`."""

import gc
import json
import os
import re
import signal
import sys
from array import array
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions, install_signal_handlers
from rclpy.task import Future
from rclpy.utilities import try_shutdown
from std_srvs.srv import SetBool, Trigger

from cloth_core.errors import ClothError, PatternError, SceneError
from cloth_core.first_start import compile_beside, is_first_start
from cloth_core.grasp import Pose
from cloth_core.pattern import MAX_TEXT_BYTES
from cloth_sim_ros.deferred_message import Message
from cloth_sim_ros.delivery import Departure, PacedPublisher, configure_fast_dds
from cloth_sim_ros.messages import decode_mesh, decode_string
from cloth_sim_ros.node_parameters import PARAMETERS, NodeParameter, check, scene_parameters, worker_settings
from cloth_sim_ros.rclpy_topics import MESSAGE_CLASSES, qos_profile
from cloth_sim_ros.sending_thread import SendingThread
from cloth_sim_ros.simulation_services import SimulationServices, import_types
from cloth_sim_ros.topics import BODY, BODY_MARKER, CLOCK, DIAGNOSTICS, GARMENT, PATTERN, REPORT, Topic
from cloth_sim_ros.unlocked_publisher import unlocked
from cloth_sim_ros.warm_up import warm_up
from cloth_sim_ros.worker import SimulationWorker

__all__ = ["ClothSimNode", "main"]

DIAGNOSTICS_PERIOD = 1.0
"""Wall-clock time between two diagnostics [s]."""
POLL_PERIOD = 0.01
"""Between two looks at whether steps that were asked for are done [s]."""
LAST_DELIVERY = 1.0
"""How long the end waits until all has been sent [s]."""
QUIT_DELAY = 0.2
"""Between the answer to a request to quit and the end [s]."""
SWITCH_INTERVAL = 0.001
"""Longest that a thread keeps the interpreter when others wait [s]."""


def main(args: list[str] | None = None) -> None:
    """Runs the node until SIGINT or SIGTERM, then ends its log."""
    _prepare()
    signals: list[int] = []
    # rclpy ends the context on both signals and calls these afterwards: nothing but a note, so that no exception and
    # no second signal cuts off the log while it is being ended.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    # A service call takes the interpreter several times; where the builder keeps it busy, each waits for one interval.
    sys.setswitchinterval(SWITCH_INTERVAL)
    configure_fast_dds()
    # Not before there is something to end: most of rclpy raises where the context goes down while it is at work.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = ClothSimNode()
    except (ClothError, ParameterException) as error:
        rclpy.shutdown()
        sys.exit(f"cloth_sim_node: {error}")
    # What has been imported stays: a full collection need not look at it, which would halt all threads for 0.1 s.
    gc.collect()
    gc.freeze()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    install_signal_handlers(SignalHandlerOptions.ALL)
    try:
        if not signals:
            executor.spin()
    except (ExternalShutdownException, RCLError):
        if node.context.ok():
            raise
    finally:
        node.close()
        try_shutdown()


def _prepare() -> None:
    """Loads and compiles before anybody can see the node, and wait for its answers meanwhile."""
    # There is nothing to end yet; what is raised here instead would be lost in some callbacks of the compiler.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    if is_first_start():
        print("cloth_sim_node: compiling, which takes a minute or two at the first start", file=sys.stderr)
        compile_beside()
    warm_up()


def _descriptor(parameter: NodeParameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=parameter.description,
        additional_constraints=parameter.constraints,
        read_only=parameter.read_only,
    )
    if parameter.lowest is not None and parameter.highest is not None:
        if isinstance(parameter.default, float):
            float_range = FloatingPointRange(from_value=parameter.lowest, to_value=parameter.highest)
            descriptor.floating_point_range = [float_range]
        else:
            integer_range = IntegerRange(from_value=int(parameter.lowest), to_value=int(parameter.highest), step=1)
            descriptor.integer_range = [integer_range]
    return descriptor


class ClothSimNode(Node):
    """Serves one simulated garment under the name `cloth_sim`."""

    def __init__(self) -> None:
        super().__init__("cloth_sim")
        self._log = self.get_logger()  # type: ignore[no-untyped-call]
        values = self._declare_parameters()
        self._values = values
        self._create_publishers()
        self._worker = SimulationWorker(
            self,
            node_name=self.get_fully_qualified_name(),
            parameters=scene_parameters(values),
            settings=worker_settings(values),
        )
        self._create_subscriptions()
        self._create_services()
        # By the wall clock, also where use_sim_time is set and time stands still.
        self.create_timer(DIAGNOSTICS_PERIOD, self._worker.diagnose, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._load_builtins({name: values[name] for name in ("body", "pattern")})

    def close(self) -> None:
        """Ends the simulation and a recording; the log is complete on return."""
        self._worker.close()
        self._sending.close(LAST_DELIVERY)
        self.destroy_node()  # type: ignore[no-untyped-call]

    # -- declare -------------------------------------------------------------------------------------------------------

    def _declare_parameters(self) -> dict[str, Any]:
        values = {
            parameter.name: self.declare_parameter(parameter.name, parameter.default, _descriptor(parameter)).value
            for parameter in PARAMETERS
        }
        check(values)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.add_post_set_parameters_callback(self._on_parameters_set)
        return values

    # -- create --------------------------------------------------------------------------------------------------------

    def _create_publishers(self) -> None:
        self._publishers_of: dict[Topic, Publisher] = {}
        self._paced: dict[Topic, PacedPublisher] = {}
        self._sending = SendingThread(self._on_send_error)
        departure = Departure(self)
        for topic in (GARMENT, BODY_MARKER, REPORT, DIAGNOSTICS, CLOCK):
            message_class = MESSAGE_CLASSES[topic.message_type]
            name = topic.name if topic.name.startswith("/") else f"~/{topic.name}"
            publisher = self.create_publisher(message_class, name, qos_profile(topic.qos))
            self._publishers_of[topic] = publisher
            if topic.qos.latched:
                self._paced[topic] = PacedPublisher(unlocked(publisher), departure)

    def _create_subscriptions(self) -> None:
        for topic, callback in ((PATTERN, self._on_pattern), (BODY, self._on_body)):
            message_class = MESSAGE_CLASSES[topic.message_type]
            self.create_subscription(message_class, f"~/{topic.name}", callback, qos_profile(topic.qos), raw=True)
        for name in self._values["grippers"]:
            # Only the last pose counts, so that a stream of them may be sent as sensors do, with best effort.
            self.create_subscription(
                PoseStamped, f"~/{name}/pose", partial(self._on_gripper_pose, name), qos_profile_sensor_data
            )

    def _create_services(self) -> None:
        worker = self._worker
        commands: dict[str, Callable[[], str]] = {
            "start": worker.start,
            "pause": worker.pause,
            "reset": worker.reset,
            "step": worker.step,
            "drape": worker.drape,
            "save": worker.save,
            "describe": lambda: json.dumps(self._describe()),
        }
        for name in self._values["grippers"]:
            commands[f"{name}/grasp"] = partial(worker.grasp, name)
            commands[f"{name}/release"] = partial(worker.release, name)
        for name, command in commands.items():
            self.create_service(Trigger, f"~/{name}", self._trigger(command))
        self.create_service(SetBool, "~/record", self._on_record)
        types = import_types()
        if types is not None:
            self._create_simulation_services(types)

    def _create_simulation_services(self, types: Any) -> None:
        services = SimulationServices(self._worker, types, self._quit_soon)

        async def step(request: Any, response: Any) -> Any:
            if services.begin_steps(request, response):
                await self._once(services.steps_are_done)
            return response

        for kind, callback in (
            (types.GetSimulatorFeatures, services.get_simulator_features),
            (types.GetSimulationState, services.get_simulation_state),
            (types.SetSimulationState, services.set_simulation_state),
            (types.ResetSimulation, services.reset_simulation),
            (types.StepSimulation, step),
        ):
            name = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
            # A callback that waits locks its group, and must not lock that of all others.
            self.create_service(kind, f"~/{name}", callback, callback_group=ReentrantCallbackGroup())

    def _once(self, condition: Callable[[], bool]) -> Future:
        """Done once the condition holds."""
        future = Future()
        timer = self.create_timer(
            POLL_PERIOD,
            lambda: condition() and not future.done() and (timer.cancel(), future.set_result(None)),
            callback_group=ReentrantCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        future.add_done_callback(lambda _: self.destroy_timer(timer))
        return future

    def _quit_soon(self) -> None:
        """Ends the context once the answer to the request for it has been sent."""
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(QUIT_DELAY, lambda: self.context.try_shutdown(), clock=clock)

    # -- callbacks -----------------------------------------------------------------------------------------------------

    def _on_pattern(self, data: bytes) -> None:
        try:
            if len(data) > MAX_TEXT_BYTES:
                raise PatternError(f"pattern message: {len(data)} bytes are more than {MAX_TEXT_BYTES}; simplify it")
            self._worker.load_pattern(decode_string(data, "pattern message"))
        except ClothError as error:
            self._worker.refuse(f"pattern refused: {error}")

    def _on_body(self, data: bytes) -> None:
        try:
            self._worker.load_body(*decode_mesh(data, self._values["max_triangles"]))
        except ClothError as error:
            self._worker.refuse(f"body refused: {error}")

    def _on_gripper_pose(self, name: str, message: Any) -> None:
        frame_id, expected = message.header.frame_id, self._values["frame_id"]
        try:
            if frame_id not in ("", expected):
                raise SceneError(f"its frame is '{frame_id}', not '{expected}'; transform it before it is sent")
            p, q = message.pose.position, message.pose.orientation
            self._worker.move_gripper(name, Pose.of((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
        except ClothError as error:
            self._worker.refuse(f"{name}/pose refused: {error}")

    def _describe(self) -> dict[str, Any]:
        values = {name: list(value) if isinstance(value, array) else value for name, value in self._values.items()}
        table = {parameter.name: parameter.to_dict(values[parameter.name]) for parameter in PARAMETERS}
        return {**self._worker.describe(), "node_parameters": table}

    def _trigger(self, command: Callable[[], str]) -> Callable[[Any, Any], Any]:
        return lambda _, response: self._answer(command, response)

    def _on_record(self, request: Any, response: Any) -> Any:
        return self._answer(lambda: self._worker.record(request.data), response)

    def _answer(self, command: Callable[[], str], response: Any) -> Any:
        try:
            response.message = command()
            response.success = True
        except ClothError as error:
            response.message = str(error)
            response.success = False
            self.warn(str(error))
        return response

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        known = {parameter.name for parameter in PARAMETERS}
        changes = {parameter.name: parameter.value for parameter in parameters if parameter.name in known}
        try:
            check(self._values | changes)
        except ClothError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_parameters_set(self, parameters: list[Parameter]) -> None:
        changes = {parameter.name: parameter.value for parameter in parameters if parameter.name in self._values}
        self._values = self._values | changes
        self._worker.configure(scene_parameters(self._values), worker_settings(self._values))
        self._load_builtins({name: changes[name] for name in ("body", "pattern") if name in changes})

    def _load_builtins(self, names: dict[str, str]) -> None:
        if names.get("body"):
            self._worker.load_builtin_body(names["body"])
        if names.get("pattern"):
            self._worker.load_builtin_pattern(names["pattern"])

    # -- listener of the worker, from any thread -----------------------------------------------------------------------

    def wants_frames(self) -> bool:
        """Whether anybody subscribes to the garment, and the frames before are on their way."""
        subscribed = self.context.ok() and self._publishers_of[GARMENT].get_subscription_count() > 0
        return subscribed and not self._sending.is_behind()

    def send(self, topic: Topic, message: Message) -> None:
        """Publishes CDR bytes as they are; what is latched in its order, but later."""
        if topic in self._paced:
            self._sending.send(topic.name, self._paced[topic].publish, message)
        elif topic in self._publishers_of:
            try:
                self._publishers_of[topic].publish(bytes(message))
            except Exception as error:
                self._on_send_error(topic.name, error)

    def _on_send_error(self, name: str, error: Exception) -> None:
        # The context may go down between two statements of any thread; then nobody waits for the message.
        if self.context.ok():
            self._log.error(f"{name}: {error}")

    def inform(self, line: str) -> None:
        """Logs; to standard error once the context is down, when there is no /rosout any more."""
        if self.context.ok():
            self._log.info(line)
        else:
            print(line, file=sys.stderr)

    def warn(self, line: str) -> None:
        """Logs, likewise."""
        if self.context.ok():
            self._log.warning(line)
        else:
            print(line, file=sys.stderr)
