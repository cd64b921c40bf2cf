"""What a frame of the garment costs: `python benchmarks/frame_cost.py [-o docs/frame_cost.md]`.

In one run, with subscribers in processes of their own: processor time to encode, publish and record a frame of 20,000
triangles, by this package and in the plain way of rclpy; latency from the end of a step to the subscriber; and how much
of its speed a simulation keeps while 60 frames a second are published and recorded.
"""

import argparse
import os
import platform
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

TRIANGLES = 20_000
FRAMES = 60
RATE = 60.0
# Of the simulation that is measured with and without being published and recorded.
STEPS = 3200
TOPIC = "/frame_cost/garment"


def main() -> None:
    """Measures, prints and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--role", choices=["subscriber"], help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    from cloth_sim_ros.delivery import configure_fast_dds

    options = parser.parse_args()
    if options.role:
        subscriber(options.log)
        return
    os.environ["ROS_DOMAIN_ID"] = str(random.randrange(1, 100))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    configure_fast_dds()  # as the node does
    with tempfile.TemporaryDirectory() as directory:
        text = report(measure(Path(directory), options.frames))
    print(text)
    if options.output:
        options.output.write_text(text)


def sheet() -> tuple[Any, Any]:
    """A wavy sheet of 20,000 triangles: positions [m], (n, 3), and triangles (m, 3)."""
    side = int(np.sqrt(TRIANGLES / 2))
    u, v = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1), indexing="ij")
    chance = np.random.default_rng(1)
    x = np.stack([u, v, 0.05 * np.sin(9 * u + 5 * v)], axis=-1).reshape(-1, 3)
    x += chance.normal(0.0, 1e-4, x.shape)  # digits as real frames have them, which do not compress
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1)
    a, b, c, d = corner, corner + side + 1, corner + side + 2, corner + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return x, triangles


class Stopwatch:
    """Median processor time of all threads of this process and wall-clock time, per frame [ms]."""

    def __init__(self) -> None:
        self.rows: dict[str, tuple[float, float]] = {}

    def measure(self, what: str, action: Callable[[int], object], count: int, pause: float = 0.0) -> None:
        """Does something `count` times; the first time does not count."""
        action(0)
        processor, wall = [], []
        for number in range(1, count + 1):
            p, w = time.process_time(), time.perf_counter()
            action(number)
            wall.append(time.perf_counter() - w)
            if pause:
                time.sleep(pause)  # so that what a thread of DDS does for this frame counts
            processor.append(time.process_time() - p)
        self.rows[what] = (1e3 * statistics.median(processor), 1e3 * statistics.median(wall))


def measure(directory: Path, count: int) -> dict[str, Any]:
    """All figures."""
    import rclpy
    from geometry_msgs.msg import Point
    from rclpy.serialization import serialize_message
    from visualization_msgs.msg import Marker

    from cloth_sim_ros.delivery import Departure, PacedPublisher
    from cloth_sim_ros.log_writer import LogWriter
    from cloth_sim_ros.rclpy_topics import qos_profile
    from cloth_sim_ros.run_messages import RunMessages
    from cloth_sim_ros.topics import GARMENT
    from cloth_sim_ros.unlocked_publisher import unlocked

    x, triangles = sheet()
    rclpy.init()
    node = rclpy.create_node("frame_cost")
    publisher = node.create_publisher(Marker, TOPIC, qos_profile(GARMENT.qos))
    received = directory / "received.txt"
    listener = subprocess.Popen([sys.executable, __file__, "--role", "subscriber", "--log", str(received)])
    while publisher.get_subscription_count() == 0:
        time.sleep(0.05)
    time.sleep(1.0)
    paced = PacedPublisher(unlocked(publisher), Departure(node))
    messages = RunMessages(time.time_ns(), "map")
    watch = Stopwatch()
    frames = [messages.garment(number / RATE, x + 1e-6 * number, triangles) for number in range(count + 1)]
    try:
        watch.measure("encode", lambda number: messages.garment(number / RATE, x, triangles), count)
        watch.measure("publish", lambda number: paced.publish(frames[number]), count, pause=1.0 / RATE)
        with LogWriter(directory / "one.mcap") as log:
            watch.measure("record", lambda number: log.write(GARMENT, number, frames[number]), count)
        watch.rows["record"] = record_cost(directory / "many.mcap", frames)

        marker = Marker()

        def fill(_: int) -> None:
            marker.points = [Point(x=px, y=py, z=pz) for px, py, pz in x[triangles].reshape(-1, 3).tolist()]

        plain = max(count // 10, 3)
        watch.measure("plain: encode", fill, plain)
        watch.measure("plain: publish", lambda _: publisher.publish(marker), plain, pause=1.0 / RATE)
        watch.measure("plain: serialize, for a log", lambda _: serialize_message(marker), plain)

        received.write_text("")
        latencies = latency(paced.publish, x, triangles, received, count)
        share = effect(paced, directory)
    finally:
        listener.kill()  # DDS may never end a process that was asked to end while it took a frame
        listener.wait()
        rclpy.shutdown()
    return {"rows": watch.rows, "latency": latencies, **share, **compression(frames), "bytes": len(frames[0])}


def record_cost(path: Path, frames: list[bytes]) -> tuple[float, float]:
    """Mean over many frames, since only whole chunks are compressed and written [ms]."""
    from cloth_sim_ros.log_writer import LogWriter
    from cloth_sim_ros.topics import GARMENT

    p, w = time.process_time(), time.perf_counter()
    with LogWriter(path) as log:
        for number, data in enumerate(frames):
            log.write(GARMENT, number, data)
    scale = 1e3 / len(frames)
    return (time.process_time() - p) * scale, (time.perf_counter() - w) * scale


def compression(frames: list[bytes]) -> dict[str, float]:
    """Size [MB] and processor time [ms] of a compressed frame, as in logs and at the level that zstd has by default."""
    import zstandard

    from cloth_sim_ros.log_compression import compress

    found = {}
    for name, action in (("own", compress), ("level_3", zstandard.compress)):
        began = time.process_time()
        sizes = [len(action(data)) for data in frames]
        found[f"{name}_ms"] = 1e3 * (time.process_time() - began) / len(frames)
        found[f"{name}_mb"] = sum(sizes) / len(sizes) / 1e6
    return found


def latency(publish: Callable[[bytes], None], x: Any, triangles: Any, received: Path, count: int) -> dict[str, float]:
    """From the end of a step, before encoding, to the subscriber's callback in another process [ms]."""
    from cloth_sim_ros.run_messages import RunMessages

    for _ in range(count):
        time.sleep(1.0 / RATE)
        # The stamp is the time at which the step has ended, so that the subscriber can tell.
        publish(RunMessages(time.time_ns(), "map").garment(0.0, x, triangles))
    time.sleep(1.0)
    values = [float(line) for line in received.read_text().split()]
    return {"median": statistics.median(values), "95 %": float(np.percentile(values, 95)), "frames": len(values)}


def effect(paced: Any, directory: Path) -> dict[str, float]:
    """How fast a simulation of 20,000 triangles runs, alone and with 60 frames a second published and recorded.

    Steps per second of processor time of the simulation's thread, which other processes hardly change; alternately, the
    same steps from the same start each time, median over all. Frames go the node's way, through the same classes.
    """
    from cloth_core.pattern import Pattern
    from cloth_core.quality import Settings
    from cloth_core.scene import Scene
    from cloth_core.simulation import Simulation
    from cloth_sim_ros.node import SWITCH_INTERVAL
    from cloth_sim_ros.outlet import Outlet
    from cloth_sim_ros.run_messages import RunMessages
    from cloth_sim_ros.sending_thread import SendingThread
    from cloth_sim_ros.topics import GARMENT

    pattern = Pattern.load("rectangle")
    area = sum(abs(panel.area) for panel in pattern.panels.values())
    scene = Scene.build(pattern, settings=Settings(spacing=float(np.sqrt(2 * area / TRIANGLES))), pins=[0])
    simulation = Simulation(scene)
    messages = RunMessages(time.time_ns(), "map")
    steps: dict[bool, list[float]] = {False: [], True: []}
    by_clock: dict[bool, list[float]] = {False: [], True: []}
    sending = SendingThread(lambda _, error: print(error))

    class Listener:
        def send(self, topic: Any, message: Any) -> None:
            sending.send(topic.name, paced.publish, message)

        def warn(self, line: str) -> None:
            print(line)

    outlet = Outlet(Listener(), "/frame_cost")
    outlet.start_log(directory / "effect.mcap")
    sys.setswitchinterval(SWITCH_INTERVAL)
    for piece in range(16):
        served = bool(piece % 2)
        simulation.reset()
        simulation.advance(0.01)
        next_frame, began, before = time.perf_counter(), time.perf_counter(), simulation.steps
        worked = time.thread_time()
        while simulation.steps - before < STEPS:
            simulation.tick()
            if served and time.perf_counter() >= next_frame:
                next_frame += 1.0 / RATE
                frame = messages.deferred_garment(simulation.time, simulation.positions, simulation.triangles)
                outlet.send(GARMENT, frame, messages.stamp(simulation.time))
        steps[served].append((simulation.steps - before) / (time.thread_time() - worked))
        by_clock[served].append((simulation.steps - before) / (time.perf_counter() - began))
    outlet.stop_log()
    sending.close(1.0)
    alone, served_rate = (statistics.median(steps[key][1:]) for key in (False, True))
    clock_alone, clock_served = (statistics.median(by_clock[key][1:]) for key in (False, True))
    return {
        "steps_alone": alone,
        "steps_served": served_rate,
        "clock_alone": clock_alone,
        "clock_served": clock_served,
        "triangles": len(scene.garment.triangles),
    }


def subscriber(path: Path) -> None:
    """Notes how old each frame is when it arrives [ms]."""
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.executors import ExternalShutdownException
    from visualization_msgs.msg import Marker

    from cloth_sim_ros.cdr import CdrReader
    from cloth_sim_ros.rclpy_topics import qos_profile
    from cloth_sim_ros.topics import GARMENT

    def note(data: bytes) -> None:
        now = time.time_ns()
        reader = CdrReader(data, "marker")
        stamp = reader.int32("sec") * 1_000_000_000 + reader.uint32("nanosec")
        with open(path, "a") as file:
            file.write(f"{(now - stamp) / 1e6:.3f}\n")

    rclpy.init()
    node = rclpy.create_node("frame_cost_subscriber")
    node.create_subscription(Marker, TOPIC, note, qos_profile(GARMENT.qos), raw=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException, RCLError):  # also where it is ended between two waits
        rclpy.spin(node)


def report(found: dict[str, Any]) -> str:
    """The page."""
    rows = found["rows"]
    own, plain = (sum(rows[name][0] for name in names) for names in (OWN, PLAIN))
    table = [f"| {what} | {rows[name][0]:.2f} | {rows[name][1]:.2f} |" for name, what in LINES.items()]
    lost = 100 * (1 - found["steps_served"] / found["steps_alone"])
    lost_by_clock = 100 * (1 - found["clock_served"] / found["clock_alone"])
    return f"""# What a frame costs

A garment of {TRIANGLES} triangles as a `visualization_msgs/Marker`: {found["bytes"] / 1e6:.2f} MB, to one subscriber in
another process, and into a log. Processor time is that of all threads of the process, medians per frame (recording:
mean over many frames). Written by `python benchmarks/frame_cost.py -o docs/frame_cost.md` on
{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}, load average
{os.getloadavg()[0]:.1f} (1 or less is a quiet machine).

| | processor [ms] | wall clock [ms] |
|---|---|---|
{chr(10).join(table)}
| **encode, publish and record** | **{own:.2f}** | |
| **the same in the plain way of rclpy**, without compression | **{plain:.2f}** | |

In a log a frame takes {found["own_mb"]:.3f} MB, compressed in {found["own_ms"]:.2f} ms; at level 3, which zstd has by
default, it would take {found["level_3_mb"]:.3f} MB and {found["level_3_ms"]:.2f} ms. Publishing waits until the
subscriber has received the frame before, in a thread that does nothing else.

From the end of a step to the subscriber's callback: {found["latency"]["median"]:.1f} ms (median),
{found["latency"]["95 %"]:.1f} ms (95 %), {found["latency"]["frames"]} frames.

A simulation of {found["triangles"]} triangles does {found["steps_alone"]:.0f} steps per second of processor time of its
thread alone, and {found["steps_served"]:.0f} with {RATE:.0f} frames a second encoded, published and recorded (by
threads of their own, as in the node): it loses {lost:.1f} %. By the wall clock, on the machine as it was,
{found["clock_alone"]:.0f} and {found["clock_served"]:.0f}: {lost_by_clock:.1f} %.
"""


OWN = ("encode", "publish", "record")
PLAIN = ("plain: encode", "plain: publish", "plain: serialize, for a log")
LINES = {
    "encode": "encode: `MarkerEncoder`",
    "publish": "publish: bytes",
    "record": "record: MCAP, zstd",
    "plain: encode": "plain rclpy: fill a list of `Point`",
    "plain: publish": "plain rclpy: publish the message",
    "plain: serialize, for a log": "plain rclpy: serialize it for a log",
}

if __name__ == "__main__":
    main()
