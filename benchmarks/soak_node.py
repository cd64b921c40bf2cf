"""A node under load for minutes: `python benchmarks/soak_node.py MINUTES [-o DIRECTORY]`.

Patterns, bodies and grippers change at random every few seconds while three subscribers listen to the garment: one
that keeps up, one that takes half a second for each frame, and one that is killed and started again.

All use the transports of the node (`fastdds.xml`); with --default-dds, all but the node have those of Fast DDS.

Written to soak.json and printed: memory of the node over time; time to answer service calls; frames that the log has
and the good subscriber has not; frames that are torn. For what the machine itself adds: the answers of an rclpy node
that does nothing at all, asked in turn with the one under load by a process that does nothing else; how late a process
that only sleeps wakes up; and the share of the time in which the node's threads waited for a core.

The script starts itself again as each of those processes, and ends them however it is ended itself, but for SIGKILL.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

NODE = "/cloth_sim"
CHANGE_INTERVAL = 4.0
"""Between two patterns or bodies [s]."""
MORTAL_LIFE = 8.0
PROBE_INTERVAL = 0.02
SLOW_TIME = 0.5
RECORD_SECONDS = 60.0
"""A log ends and the next one begins."""


def main() -> None:
    """Starts everything, changes the scene until the time is over, and reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("minutes", type=float, nargs="?", default=30.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("soak"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--default-dds", action="store_true")
    parser.add_argument("--role", choices=list(ROLES), help=argparse.SUPPRESS)
    from cloth_sim_ros.delivery import configure_fast_dds

    options = parser.parse_args()
    if options.role:
        ROLES[options.role](options.output)
        return
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randrange(1, 100)))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # So that the processes that have been started are ended too.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    options.output.mkdir(parents=True, exist_ok=True)
    os.environ["ROS_LOG_DIR"] = str(options.output)
    if not options.default_dds:
        configure_fast_dds()
    result = soak(options.minutes, options.output, options.seed)
    (options.output / "soak.json").write_text(json.dumps(result, indent=1))
    print(json.dumps({key: value for key, value in result.items() if key != "memory_mb"}, indent=1))


def soak(minutes: float, output: Path, seed: int) -> dict[str, Any]:
    """What has been seen within `minutes`."""
    for name in ("probe.jsonl", "good.jsonl"):
        (output / name).unlink(missing_ok=True)
    running: list[subprocess.Popen[bytes]] = []
    try:
        node = subprocess.Popen(
            [
                sys.executable, "-c", "from cloth_sim_ros.node import main; main()", "--ros-args",
                "-p", "quality:=draft", "-p", "auto_start:=true", "-p", f"record_directory:={output / 'records'}",
            ],
            stderr=open(output / "node_stderr.txt", "w"),
        )  # fmt: skip
        running.append(node)
        running += [start(name, output) for name in ("good", "slow", "control", "probe")]
        mortal, deaths, changes, memory = start("mortal", output), 0, 0, []
        running.append(mortal)
        chance = random.Random(seed)
        client = Driver(chance)
        client.wait_for_node()
        client.change(first=True)
        began = time.monotonic()
        next_change = next_memory = began
        next_death = began + MORTAL_LIFE
        next_record = began + 20.0
        recording = False
        while (now := time.monotonic()) < began + 60.0 * minutes and node.poll() is None:
            client.spin(0.05)
            if now >= next_memory:
                next_memory = now + 1.0
                memory.append((round(now - began, 1), resident_megabytes(node.pid)))
            if now >= next_change:
                next_change = now + CHANGE_INTERVAL * chance.uniform(0.5, 1.5)
                client.change()
                changes += 1
            if now >= next_death:
                next_death = now + MORTAL_LIFE
                running.remove(mortal)
                mortal.kill()
                mortal.wait()
                deaths += 1
                mortal = start("mortal", output)
                running.append(mortal)
            if now >= next_record:
                next_record = now + RECORD_SECONDS
                if recording:
                    client.record(False)
                client.record(True)
                recording = True
        crashed = node.poll()
        waited = seconds_without_core(node.pid) / (time.monotonic() - began)
        ended = time.monotonic()
        node.send_signal(signal.SIGINT)
        code = node.wait(30)
        shutdown = time.monotonic() - ended
    finally:
        end(running)
    return {
        "minutes": minutes,
        "changes": changes,
        "deaths_of_a_subscriber": deaths,
        "node_ended_early_with": crashed,
        "exit_code_after_sigint": code,
        "node_waits_for_a_core_seconds_per_second": round(waited, 2),
        "load_average": os.getloadavg(),
        "shutdown_seconds": round(shutdown, 2),
        **memory_trend(memory),
        **latencies(output / "probe.jsonl"),
        **frames(output),
        "last_lines_of_the_node": (output / "node_stderr.txt").read_text().splitlines()[-3:],
        "warnings": client.refused,
        "memory_mb": memory,
    }


def start(role: str, output: Path) -> subprocess.Popen[bytes]:
    """This script as another process."""
    return subprocess.Popen([sys.executable, __file__, "--role", role, "-o", str(output)])


def end(processes: list[subprocess.Popen[bytes]]) -> None:
    """Ends those that have not ended by themselves; who does not listen to SIGTERM is killed."""
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
    for process in processes:
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


# -- what is measured --------------------------------------------------------------------------------------------------


def resident_megabytes(pid: int) -> float:
    """Memory of a process [MB]."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return round(int(text.split("VmRSS:")[1].split()[0]) / 1024, 1)


def seconds_without_core(pid: int) -> float:
    """How long the threads of a process have waited for a core although they could run, in sum [s]."""
    waited = 0.0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        try:
            waited += int(path.read_text().split()[1]) / 1e9
        except OSError:
            continue  # the thread has just ended
    return waited


def memory_trend(memory: list[tuple[float, float]]) -> dict[str, float]:
    """Memory once everything has been loaded, at the end, and its slope over the second half."""
    times, values = np.array(memory).T
    late = times > times[-1] / 2
    slope = np.polyfit(times[late] / 60.0, values[late], 1)[0] if late.sum() > 2 else float("nan")
    quarter = values[(times > times[-1] / 4) & ~late]
    return {
        "memory_second_quarter_mb": round(float(np.median(quarter)), 1),
        "memory_last_quarter_mb": round(float(np.median(values[times > 0.75 * times[-1]])), 1),
        "memory_slope_mb_per_minute": round(float(slope), 2),
    }


def latencies(path: Path) -> dict[str, Any]:
    """Service answers, and what the machine itself added [ms]."""
    rows = [json.loads(line) for line in path.read_text().splitlines() if line.endswith("]")]
    answers, asleep, control, asking, asking_control = np.array([[r[1], r[2], *r[4:]] for r in rows]).T * 1000.0
    building = np.array([row[3] == "building" for row in rows])
    result: dict[str, Any] = {"service_calls": len(answers), "unanswered": sum(row[1] > 5.0 for row in rows)}
    for name, values in (
        ("answer_ms", answers),
        ("answer_while_building_ms", answers[building]),
        ("answer_less_time_to_ask_ms", answers - asking),
        ("answer_of_an_empty_node_ms", control),
        ("answer_of_an_empty_node_less_time_to_ask_ms", control - asking_control),
        ("lateness_of_the_prober_ms", asleep),
    ):
        if len(values):
            result[name] = {
                "median": round(float(np.median(values)), 2),
                "99 %": round(float(np.percentile(values, 99.0)), 2),
                "99.9 %": round(float(np.percentile(values, 99.9)), 2),
                "largest": round(float(values.max()), 2),
                "over 100": int((values > 100.0).sum()),
            }
    worst = sorted(rows, key=lambda row: -row[1])[:5]
    result["worst [at s, answer ms, of which to ask ms, lateness ms, state]"] = [
        [round(row[0], 1), *(round(1000 * row[column], 1) for column in (1, 5, 2)), row[3]] for row in worst
    ]
    return result


def frames(output: Path) -> dict[str, int]:
    """Frames of the logs that the good subscriber has not received, and torn ones."""
    from cloth_sim_ros.log_reader import LogReader
    from cloth_sim_ros.messages import decode_marker
    from cloth_sim_ros.topics import GARMENT

    received = [json.loads(line) for line in (output / "good.jsonl").read_text().splitlines() if line.endswith("]")]
    stamps = {row[0] for row in received}
    logged = []
    for path in sorted((output / "records").glob("*.mcap")):
        with LogReader(path) as log:
            logged += [decode_marker(message.data).stamp for message in log.messages(GARMENT)]
    missing = set(logged) - stamps
    return {
        "frames_received": len(received),
        "frames_logged": len(logged),
        "frames_logged_and_not_received": sum(stamp < max(stamps) for stamp in missing),
        "frames_logged_while_it_ended": sum(stamp > max(stamps) for stamp in missing),
        "torn_frames": sum(not row[2] for row in received),
        "frames_out_of_order": sum(b[0] < a[0] for a, b in pairwise(received)),
    }


# -- who changes the scene ---------------------------------------------------------------------------------------------


def handkerchief(size: float) -> str:
    """A level square above the origin, as GarmentCode JSON."""
    half = size / 2
    panel = {
        "translation": [0.0, 0.2, 0.0],
        "rotation": [-90.0, 0.0, 0.0],
        "vertices": [[-half, -half], [half, -half], [half, half], [-half, half]],
        "edges": [{"endpoints": [corner, (corner + 1) % 4]} for corner in range(4)],
    }
    return json.dumps(
        {
            "pattern": {"panels": {"cloth": panel}, "stitches": []},
            "properties": {"units_in_meter": 1, "curvature_coords": "relative"},
        }
    )


class Driver:
    """Sends patterns, bodies and poses at random."""

    def __init__(self, chance: random.Random) -> None:
        import rclpy
        import trimesh
        from geometry_msgs.msg import PoseStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from shape_msgs.msg import Mesh
        from std_msgs.msg import String
        from std_srvs.srv import SetBool, Trigger

        from cloth_core.pattern import Pattern

        rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)  # they are this process's own
        self._rclpy, self._chance, self.refused = rclpy, chance, 0
        self._node = rclpy.create_node("soak_driver")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._pattern = self._node.create_publisher(String, f"{NODE}/pattern", latched)
        self._body = self._node.create_publisher(Mesh, f"{NODE}/body", latched)
        self._pose = self._node.create_publisher(PoseStamped, f"{NODE}/gripper/pose", 10)
        self._triggers = {
            name: self._node.create_client(Trigger, f"{NODE}/{name}")
            for name in ("start", "drape", "reset", "save", "gripper/grasp", "gripper/release")
        }
        self._record = self._node.create_client(SetBool, f"{NODE}/record")
        self._balls = [trimesh.creation.icosphere(n, radius=0.12) for n in (2, 3)]
        self._ball = self._balls[0]
        self._tshirt = Pattern.load("tshirt").source
        self._on_ball = True

    def wait_for_node(self) -> None:
        """Until its services are there."""
        assert self._record.wait_for_service(60.0)

    def spin(self, seconds: float) -> None:
        """Listens for answers."""
        self._rclpy.spin_once(self._node, timeout_sec=seconds)

    def call(self, name: str) -> None:
        """Calls a service; whether it is refused is counted, not waited for."""
        from std_srvs.srv import Trigger

        self._triggers[name].call_async(Trigger.Request()).add_done_callback(self._count)

    def _count(self, future: Any) -> None:
        self.refused += not future.result().success

    def record(self, on: bool) -> None:
        """Starts or ends a log."""
        from std_srvs.srv import SetBool

        self._record.call_async(SetBool.Request(data=on))

    def change(self, first: bool = False) -> None:
        """One random change."""
        actions: list[Callable[[], None]] = [
            self._new_pattern, self._new_pattern, self._new_body, self._garment_on_body,
            self._move_body, self._move_body, self._take, self._take,
            lambda: self.call("drape"), lambda: self.call("reset"), lambda: self.call("save"),
            lambda: self._pattern.publish(self._bytes("{broken")),
        ]  # fmt: skip
        if first:
            self._new_body()
            self._new_pattern()
            return
        self._chance.choice(actions)()
        self.call("start")

    def _bytes(self, text: str) -> bytes:
        from cloth_sim_ros.messages import encode_string

        return encode_string(text)

    def _new_pattern(self) -> None:
        self._pattern.publish(self._bytes(handkerchief(self._chance.uniform(0.2, 0.8))))
        if not self._on_ball:
            self._new_body()

    def _new_body(self) -> None:
        self._on_ball = True
        self._ball = self._chance.choice(self._balls)
        self._send(self._ball.vertices)

    def _move_body(self) -> None:
        if self._on_ball:
            self._send(self._ball.vertices + [self._chance.uniform(-0.1, 0.1) for _ in range(3)])

    def _send(self, vertices: Any) -> None:
        from cloth_sim_ros.messages import encode_mesh

        self._body.publish(encode_mesh(np.asarray(vertices), np.asarray(self._ball.faces)))

    def _garment_on_body(self) -> None:
        from cloth_core.body import Body
        from cloth_sim_ros.messages import encode_mesh

        body = Body.load("young")
        self._on_ball = False
        self._body.publish(encode_mesh(body.vertices, body.triangles))
        self._pattern.publish(self._bytes(self._tshirt))

    def _take(self) -> None:
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        for axis in "xyz":
            setattr(message.pose.position, axis, self._chance.uniform(-0.1, 0.1) + 0.15 * (axis == "z"))
        self._pose.publish(message)
        self.call(self._chance.choice(["gripper/grasp", "gripper/release"]))


# -- the other processes -----------------------------------------------------------------------------------------------


@contextmanager
def ros_node(name: str) -> Iterator[Any]:
    """A node of its own; ends on SIGTERM."""
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    try:
        yield rclpy.create_node(name)
    except (KeyboardInterrupt, ExternalShutdownException, RCLError):
        pass  # also where it is ended while it starts


def subscribe(name: str, callback: Callable[[bytes], None]) -> None:
    """Listens to the garment until it is ended."""
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from visualization_msgs.msg import Marker

    with ros_node(name) as node:
        qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(Marker, f"{NODE}/garment", callback, qos, raw=True)
        rclpy.spin(node)


def good(output: Path) -> None:
    """Keeps up, and looks at each frame."""
    from cloth_core.errors import ClothError
    from cloth_sim_ros.messages import decode_marker

    with open(output / "good.jsonl", "w", buffering=1) as file:

        def look(data: bytes) -> None:
            try:
                marker = decode_marker(data)
                # A torn frame would hold parts of two states: a triangle whose corners are far apart.
                corners = marker.points.reshape(-1, 3, 3)
                whole = bool(np.isfinite(corners).all() and np.ptp(corners, axis=1).max(initial=0.0) < 0.3)
                row = [marker.stamp, len(corners), whole]
            except ClothError:
                row = [0, 0, False]
            file.write(json.dumps(row) + "\n")

        subscribe("soak_good", look)


def slow(output: Path) -> None:
    """Takes its time."""
    subscribe("soak_slow", lambda _: time.sleep(SLOW_TIME))


def mortal(output: Path) -> None:
    """Is killed from outside."""
    subscribe("soak_mortal", lambda _: None)


def control(output: Path) -> None:
    """A node with one service and nothing else to do."""
    import rclpy
    from std_srvs.srv import Trigger

    with ros_node("soak_control") as node:
        node.create_service(Trigger, "~/describe", lambda _, response: response)
        rclpy.spin(node)


def probe(output: Path) -> None:
    """Asks all the time, and measures how late it wakes up itself when it only sleeps."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_srvs.srv import Trigger

    with ros_node("soak_probe") as node, open(output / "probe.jsonl", "w", buffering=1) as file:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # Spun all the time: spin_until_future_complete leaves its callbacks queued, and gets slower from call to call.
        threading.Thread(target=executor.spin, daemon=True).start()
        clients = [node.create_client(Trigger, f"{name}/describe") for name in (NODE, "/soak_control")]
        for client in clients:
            client.wait_for_service()

        def ask(client: Any) -> tuple[float, float, Any]:
            """Time that the answer took, of which this process itself to send the question [s]; answer, or None."""
            answered = threading.Event()
            asked = time.perf_counter()
            future = client.call_async(Trigger.Request())
            asking = time.perf_counter() - asked
            future.add_done_callback(lambda _: answered.set())
            if not answered.wait(10.0):
                client.remove_pending_request(future)
            return time.perf_counter() - asked, asking, future.result() if future.done() else None

        time.sleep(2.0)
        for client in clients:
            ask(client)  # the first answer waits until both ends know of each other
        began = time.monotonic()
        while rclpy.ok():
            asleep = time.perf_counter()
            time.sleep(PROBE_INTERVAL)
            late = time.perf_counter() - asleep - PROBE_INTERVAL
            answer, asking, result = ask(clients[0])
            state = "no answer" if result is None else json.loads(result.message)["state"]
            time.sleep(PROBE_INTERVAL)
            control, asking_control, _ = ask(clients[1])
            row = [time.monotonic() - began, answer, late, state, control, asking, asking_control]
            file.write(json.dumps(row) + "\n")


ROLES: dict[str, Callable[[Path], None]] = {
    "good": good,
    "slow": slow,
    "mortal": mortal,
    "control": control,
    "probe": probe,
}

if __name__ == "__main__":
    main()
