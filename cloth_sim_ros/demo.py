"""`make demo`: starts the real node and talks to it as any other ROS program would, from a process of its own."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import click
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from cloth_core.mesh_files import read_mesh, write_file
from cloth_sim_ros.delivery import configure_fast_dds
from cloth_sim_ros.rclpy_topics import qos_profile
from cloth_sim_ros.render import render_log
from cloth_sim_ros.topics import BODY, DIAGNOSTICS, PATTERN, REPORT

__all__ = ["main"]

ANSWER_TIME = 30.0
"""Longest wait for an answer of the node, or for it to appear [s]."""
GOODBYE_TIME = 15.0
"""Longest wait for the node to end after SIGINT [s]."""
LINE_INTERVAL = 5.0
"""Between two lines of progress [s]."""
SHOWN_VALUES = ("phase", "simulated time [s]", "speed [simulated s per s]", "expected rest at [s]")
RESULTS = ("run.mcap", "garment.glb", "picture.png", "report.json")
DATA = resources.files("cloth_core") / "data"


class DemoError(Exception):
    """The demonstration cannot go on; one line."""


class DemoClient(Node):
    """What a user of the simulator writes: two publishers, a few service clients and two subscriptions."""

    def __init__(self, node_process: subprocess.Popen[bytes]) -> None:
        super().__init__("cloth_sim_demo")
        self._node_process = node_process
        self.report: dict[str, Any] | None = None
        self._shown_state: tuple[str, str | None] | None = None
        self._next_line = 0.0
        self._pattern = self.create_publisher(String, PATTERN.resolve(), qos_profile(PATTERN.qos))
        self._body = self.create_publisher(Mesh, BODY.resolve(), qos_profile(BODY.qos))
        self.create_subscription(String, REPORT.resolve(), self._on_report, qos_profile(REPORT.qos))
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.resolve(), self._on_diagnostics, qos_profile(DIAGNOSTICS.qos)
        )

    def publish_body(self, path: Path) -> None:
        """Sends a mesh file, in metres and z up, as `shape_msgs/Mesh`."""
        vertices, triangles = read_mesh(path)
        message = Mesh(
            vertices=[Point(x=x, y=y, z=z) for x, y, z in vertices.tolist()],
            triangles=[MeshTriangle(vertex_indices=corners) for corners in triangles.astype("uint32")],
        )
        self._publish(self._body, message, f"{len(vertices)} vertices and {len(triangles)} triangles")

    def publish_pattern(self, text: str) -> None:
        """Sends a GarmentCode pattern (JSON) as `std_msgs/String`."""
        self._publish(self._pattern, String(data=text), f"{len(text)} characters of JSON")

    def call(self, name: str, request: Any = None) -> str:
        """Calls ~/`name` and returns the answer; DemoError with the node's reason if it refuses."""
        service_type = Trigger if request is None else SetBool
        client: Client = self.create_client(service_type, f"/cloth_sim/{name}")
        self.wait_until(client.service_is_ready, f"service ~/{name} appears", ANSWER_TIME)
        future = client.call_async(Trigger.Request() if request is None else request)
        self.wait_until(future.done, f"~/{name} answers", ANSWER_TIME)
        self.destroy_client(client)
        answer = future.result()  # type: ignore[no-untyped-call]
        if not answer.success:
            raise DemoError(f"~/{name} was refused: {answer.message}")
        return str(answer.message)

    def describe(self) -> dict[str, Any]:
        """What the node says about itself; DemoError if it has refused what it was sent."""
        description: dict[str, Any] = json.loads(self.call("describe"))
        if description["refused"]:
            raise DemoError(f"the node refused what it was sent: {description['refused']}")
        return description

    def wait_until(self, condition: Callable[[], bool], what: str, seconds: float) -> None:
        """Serves callbacks until the condition holds; DemoError after `seconds` or when the node has ended."""
        deadline = time.monotonic() + seconds
        while not condition():
            if self._node_process.poll() is not None:
                raise DemoError(f"the node ended with code {self._node_process.returncode} before {what}")
            if time.monotonic() > deadline:
                raise DemoError(f"{seconds:g} s passed before {what}")
            rclpy.spin_once(self, timeout_sec=0.1)

    def _publish(self, publisher: Publisher, message: Any, what: str) -> None:
        topic = publisher.topic_name
        self.wait_until(lambda: publisher.get_subscription_count() > 0, f"the node listens to {topic}", ANSWER_TIME)
        publisher.publish(message)
        say(f"published {what} on {topic}")

    def _on_report(self, message: String) -> None:
        self.report = json.loads(message.data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Shows a change of state at once and progress every few seconds."""
        for status in message.status:
            values = {entry.key: entry.value for entry in status.values}
            state = (status.message, values.get("phase"))
            if state == self._shown_state and time.monotonic() < self._next_line:
                continue
            self._shown_state, self._next_line = state, time.monotonic() + LINE_INTERVAL
            shown = [f"{key}: {values[key]}" for key in SHOWN_VALUES if key in values]
            say(f"  /diagnostics: {', '.join([status.message, *shown])}")


def say(line: str) -> None:
    """Tells the user what is going on, with the time since the start."""
    print(f"[{time.monotonic() - STARTED:5.1f} s] {line}", flush=True)


STARTED = time.monotonic()


@contextmanager
def running_node(record_directory: Path, quality: str, log_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A node in a process of its own, stopped by its process id at the end, whatever happens."""
    executable = Path(sys.executable).with_name("cloth_sim_node")
    parameters = {"record_directory": record_directory, "quality": quality}
    arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
    with log_path.open("wb") as log:
        process = subprocess.Popen([executable, "--ros-args", *arguments], stdout=log, stderr=subprocess.STDOUT)
        say(f"started {executable.name} (process {process.pid}), its output goes to {log_path}")
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(GOODBYE_TIME)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            say(f"stopped the node (process {process.pid}, exit code {process.returncode})")


def demonstrate(client: DemoClient, records: Path, pattern: str, body: str, timeout: float) -> dict[str, Any]:
    """Drapes built-in garment and body through topics and services, recording into `records`; the report."""
    say("~/record: " + client.call("record", SetBool.Request(data=True)))
    with resources.as_file(DATA / "bodies" / f"{body}.ply") as path:
        client.publish_body(path)
    client.publish_pattern((DATA / "patterns" / f"{pattern}.json").read_text(encoding="utf-8"))

    def built() -> bool:
        scene = client.describe()["scene"]
        return scene is not None and scene["body"] is not None

    client.wait_until(built, "the garment is built", timeout)
    scene = client.describe()["scene"]
    active = [name for name, term in scene["terms"].items() if term["active"]]
    say(f"~/describe: {scene['particles']} particles, {scene['triangles']} triangles, terms: {', '.join(active)}")
    say("~/drape: " + client.call("drape"))
    client.wait_until(lambda: client.report is not None, "the garment is at rest", timeout)
    say("~/report: the run has ended")
    say("~/save: " + client.call("save"))
    client.wait_until(lambda: any(records.glob("*.glb")), "the garment is saved", ANSWER_TIME)
    say("~/record: " + client.call("record", SetBool.Request(data=False)))
    assert client.report is not None
    return client.report


def keep_results(records: Path, output: Path, report: dict[str, Any]) -> None:
    """Leaves run.mcap, garment.glb, picture.png and report.json in `output`."""
    for kind, name in ((".mcap", "run.mcap"), (".glb", "garment.glb")):
        files = sorted(records.glob(f"*{kind}"))
        if len(files) != 1:
            raise DemoError(f"{records}: the node has written {len(files)} files {kind} instead of one")
        shutil.move(files[0], output / name)
    write_file(output / "report.json", (json.dumps(report, indent=2) + "\n").encode())
    say("drawing the end of the log")
    render_log(output / "run.mcap", output / "picture.png")


def summarise(report: dict[str, Any], output: Path) -> None:
    """Prints what came out."""
    say(
        f"{report['garment']}, {report['fabric']}: {report['rest_reason']}; {report['simulated_time']:.2f} s simulated "
        f"in {report['wall_time']:.1f} s; largest strain {100 * report['max_strain']:.1f} %; largest seam gap "
        f"{1000 * report['max_seam_gap']:.2g} mm; edges through the body {report['body_intersections']}, of "
        f"the body through cloth {report['body_edges_through_cloth']}; deepest "
        f"penetration {1000 * report['max_penetration']:.2g} mm"
    )
    for name in RESULTS:
        say(f"wrote {output / name}")


@click.command()
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), default="demo", show_default=True)
@click.option("--pattern", default="tshirt", show_default=True, help="Built-in pattern.")
@click.option("--body", default="young", show_default=True, help="Built-in body.")
@click.option("--quality", default="normal", show_default=True, help="draft, normal or fine.")
@click.option("--timeout", default=600.0, show_default=True, help="Longest wait for rest [s].")
def main(output: Path, pattern: str, body: str, quality: str, timeout: float) -> None:
    """Drapes a garment through the ROS interface and leaves log, mesh, picture and report in OUTPUT."""
    # A graph of its own, on this machine only, so that neither a stray node nor a neighbour takes part.
    domain = random.SystemRandom().randint(1, 101)
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    configure_fast_dds()
    # So that the node is stopped, too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("demo: terminated"))
    output.mkdir(parents=True, exist_ok=True)
    say(f"ROS domain {domain}, localhost only")
    try:
        with tempfile.TemporaryDirectory(prefix="records_", dir=output) as records:
            with running_node(Path(records), quality, output / "node.log") as process:
                rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
                try:
                    report = demonstrate(DemoClient(process), Path(records), pattern, body, timeout)
                finally:
                    rclpy.shutdown()
            keep_results(Path(records), output, report)
    except DemoError as error:
        sys.exit(f"demo: {error}; see {output / 'node.log'}")
    summarise(report, output)
    if not report["settled"]:
        sys.exit("demo: the garment did not come to rest")


if __name__ == "__main__":
    main()
