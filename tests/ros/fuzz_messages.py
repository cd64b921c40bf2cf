"""Sends mutated patterns and bodies through the callbacks of the real node and watches what becomes of it.

    python tests/ros/fuzz_messages.py --count 10000

For each message: the callback raises nothing, the builder is done within a time, the message is either taken or refused
with one line that does not call itself a defect, a refused one leaves the scene as it was, no file appears, no path of
a message is opened, nothing is connected to and no process started. At the end a good scene is still taken. Memory is
printed before the first and after each tenth. Exit code 0, or 1 with each seed that failed.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["FuzzResult", "NodeUnderFuzz", "fuzz"]

LONGEST_BUILD = 60.0
"""After which a message counts as a hang [s]; the largest scene that is accepted here takes a few seconds."""
MAX_PARTICLES, MAX_TRIANGLES = 5_000, 20_000
LONGEST_LINE = 5_000
"""Of a refusal [characters]."""


@dataclass
class FuzzResult:
    """What came of it."""

    taken: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    slowest: tuple[float, int] = (0.0, 0)
    """[s] and the seed."""
    memory: list[float] = field(default_factory=list)
    """Resident memory before the first message and after each tenth [MB]."""


class NodeUnderFuzz:
    """The real node in this process; its callbacks get bytes, as rclpy would hand them over."""

    def __init__(self, directory: Path) -> None:
        import rclpy
        from rclpy.parameter import Parameter

        from cloth_sim_ros.node import ClothSimNode
        from cloth_sim_ros.warm_up import warm_up

        # As the node's own start does: what compiles for a minute would count as a hang.
        warm_up()
        self.directory = directory
        os.environ["ROS_LOG_DIR"] = str(directory / "ros")
        values = {"max_particles": MAX_PARTICLES, "max_triangles": MAX_TRIANGLES, "quality": "draft"}
        settings = [f"-p {name}:={value}" for name, value in values.items()]
        settings.append(f"-p record_directory:={directory / 'records'}")
        arguments = " ".join(["--ros-args", "--log-level", "FATAL", *settings]).split()
        rclpy.init(args=arguments)
        self.node = ClothSimNode()
        self.lines: list[str] = []
        self.node.warn = self.lines.append  # type: ignore[method-assign]
        assert self.node.get_parameter("max_particles").type_ is Parameter.Type.INTEGER

    @property
    def worker(self) -> Any:
        return self.node._worker

    def send(self, topic: str, data: bytes) -> None:
        """Hands a message to its callback and waits until it is dealt with."""
        self.lines[:] = []
        before = self.scene()
        callback = {"pattern": self.node._on_pattern, "body": self.node._on_body}[topic]
        callback(data)
        # It is dealt with once it has been taken or a line says why not.
        deadline = time.monotonic() + LONGEST_BUILD
        while not self.lines and self.scene() == before:
            if time.monotonic() > deadline:
                raise TimeoutError(f"neither taken nor refused after {LONGEST_BUILD:g} s")
            time.sleep(0.0005)

    def scene(self) -> Any:
        """Identity of pattern and body in use."""
        inputs = self.worker._builder._inputs
        return (inputs.pattern, inputs.body)

    def close(self) -> None:
        import rclpy

        self.node.close()
        rclpy.try_shutdown()


class Reach:
    """What this process opens, connects to and starts, as Python's audit events tell."""

    SUSPICIOUS = ("etc/passwd", "/dev/zero", "localhost", "://", "__proto__", "${HOME}")

    def __init__(self) -> None:
        self.found: list[str] = []
        self.watching = False
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.watching:
            return
        started = event in ("socket.connect", "subprocess.Popen", "os.system", "os.exec", "urllib.Request", "os.fork")
        opened = event == "open" and any(part in str(arguments[0]) for part in self.SUSPICIOUS)
        if started or opened:
            self.found.append(f"{event}: {str(arguments)[:200]}")


def fuzz(count: int, first_seed: int, directory: Path, say: Any = None, passes: int = 1) -> FuzzResult:
    """Sends `count` messages, half patterns, half bodies, mixed; all of them `passes` times."""
    from message_mutations import mutated_body, mutated_pattern, real_bodies, real_patterns
    from small_scenes import handkerchief

    from cloth_sim_ros.messages import encode_mesh, encode_string

    patterns, bodies = real_patterns() | {"handkerchief": handkerchief()}, real_bodies()
    good_pattern = encode_string(handkerchief(0.2))
    good_body = encode_mesh(*bodies["box"])
    node = NodeUnderFuzz(directory)
    result = FuzzResult()
    files = set(directory.rglob("*"))
    reach = Reach()
    # What Python only warns of is a line on standard error that nobody asked for.
    warnings.simplefilter("error")
    node.node.inform = lambda line: None  # type: ignore[method-assign]
    try:
        node.send("body", good_body)
        node.send("pattern", good_pattern)
        result.memory.append(resident_memory())
        for done, seed in enumerate(list(range(first_seed, first_seed + count)) * passes, 1):
            if seed % 10 == first_seed % 10:
                # Back to a scene in which both a pattern and a body can be taken.
                node.send("body", good_body)
                node.send("pattern", good_pattern)
            topic = "pattern" if random.Random(seed).random() < 0.5 else "body"
            data = mutated_pattern(seed, patterns) if topic == "pattern" else mutated_body(seed, bodies)
            before = node.scene()
            began = time.monotonic()
            try:
                reach.watching = True
                node.send(topic, data)
                reach.watching = False
            except Exception as error:
                result.failures.append(f"seed {seed} ({topic}): {type(error).__name__}: {error}")
                if isinstance(error, TimeoutError):
                    break
                continue
            result.slowest = max(result.slowest, (time.monotonic() - began, seed))
            _judge(result, seed, topic, node, before)
            if seed % 20 == 0 and not node.lines and node.worker.describe()["scene"]:
                node.worker.step()
            if done % max(count * passes // 10, 1) == 0:
                result.memory.append(resident_memory())
                if say is not None:
                    say(f"{done}: {result.taken} taken, {result.refused} refused, {result.memory[-1]:.0f} MB")
        node.send("body", good_body)
        node.send("pattern", good_pattern)
        if node.lines:
            result.failures.append(f"the good scene at the end: {node.lines}")
        new = [path for path in directory.rglob("*") if path not in files and "ros" not in path.parts]
        result.failures += reach.found
        if new:
            result.failures.append(f"files appeared: {new}")
    finally:
        node.close()
    return result


def _judge(result: FuzzResult, seed: int, topic: str, node: NodeUnderFuzz, before: Any) -> None:
    lines = list(node.lines)
    refused = [line for line in lines if line.startswith(f"{topic} refused: ")]
    other = [line for line in lines if line not in refused]
    if other or len(refused) > 1:
        result.failures.append(f"seed {seed} ({topic}): {lines}")
        return
    if not refused:
        result.taken += 1
        return
    [line] = refused
    result.refused += 1
    result.reasons[" ".join(line.split(": ", 1)[1].split(" ")[:4])] += 1
    if node.scene() != before:
        result.failures.append(f"seed {seed} ({topic}): refused, but the scene is another one: {line}")
    if "please report it" in line or not line.isprintable() or len(line) > LONGEST_LINE:
        result.failures.append(f"seed {seed} ({topic}): {line[:300]!r}")


def resident_memory() -> float:
    """[MB]."""
    fields = Path("/proc/self/statm").read_text().split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--passes", type=int, default=1, help="the same messages so often: what grows is a leak")
    options = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(random.randrange(1, 100))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as directory:
        result = fuzz(
            options.count, options.seed, Path(directory), lambda line: print(line, flush=True), options.passes
        )
    for failure in result.failures:
        print(failure)
    print(
        f"{options.count} messages, {options.passes} x, in {time.monotonic() - began:.0f} s: {result.taken} taken, "
        f"{result.refused} refused "
        f"for {len(result.reasons)} reasons, {len(result.failures)} failures; slowest {result.slowest[0]:.2f} s "
        f"(seed {result.slowest[1]}); memory [MB] {[round(m) for m in result.memory]}"
    )
    return 1 if result.failures else 0


if __name__ == "__main__":
    sys.exit(main())
