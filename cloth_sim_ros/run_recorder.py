"""Records a simulation into a log as it runs, without a node."""

import json
import os
import time
from collections.abc import Mapping, Sequence
from types import TracebackType

import numpy as np
import numpy.typing as npt

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros.background_log import BackgroundLog
from cloth_sim_ros.deferred_message import Message
from cloth_sim_ros.diagnostics import run_status
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.messages import Level, encode_diagnostics, encode_mesh, encode_string
from cloth_sim_ros.run_identity import run_identity
from cloth_sim_ros.run_messages import RunMessages
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation, ScheduleFollower
from cloth_sim_ros.topics import BODY, BODY_MARKER, DIAGNOSTICS, GARMENT, PARAMETERS, PATTERN, REPORT, SCHEDULE, Topic

__all__ = ["RunRecorder"]

FRAME_RATE = 30.0
"""Frames per simulated second that `RunRecorder.follow` records [Hz]."""
DIAGNOSTICS_INTERVAL = 1.0
"""Wall-clock time between two diagnostics, as the node sends them [s]."""


class RunRecorder:
    """A log of one run, with the topics that the node would have under its default name.

    A thread of its own encodes, compresses and writes, while the simulation goes on.

    Args:
        path: file to be created
        pattern_texts: JSON of each pattern, as it was read
        body: None if the garment falls freely
        parameters: of the run; values that JSON can hold
        frame_id: coordinate frame of everything
        patterns, scene: what the texts were read into, and what was built of them; without them the log cannot be
            simulated again

    Raises:
        LogError: here, if the log cannot be created, and once, in the next method that is called, if a message before
            could not be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        pattern_texts: Sequence[str],
        body: Body | None,
        parameters: Mapping[str, object],
        frame_id: str = "map",
        *,
        patterns: Sequence[Pattern] = (),
        scene: Scene | None = None,
    ) -> None:
        self._path = path
        start = time.time_ns()
        if scene is not None:
            parameters = {**parameters, "replay": run_identity(scene, patterns, body, None, start)}
        self._messages = RunMessages(start, frame_id)
        self._last_frame_time = float("-inf")
        self._next_diagnostics = float("-inf")
        self._schedule = ScheduleFollower()
        self._failure: LogError | None = None
        self._log: BackgroundLog | None = BackgroundLog(LogWriter(path), self._on_failed)
        for text in pattern_texts:
            self._write(PATTERN, start, encode_string(text))
        self._write(PARAMETERS, start, encode_string(json.dumps(dict(parameters), sort_keys=True)))
        if body is not None:
            self._write(BODY, start, encode_mesh(body.vertices, body.triangles))
            self._write(BODY_MARKER, start, self._messages.body(body.vertices, body.triangles))

    def frame(
        self, simulated_time: float, positions: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]
    ) -> None:
        """Adds the garment at `simulated_time` [s]: positions [m], (n, 3), triangles (m, 3), which stay as they are."""
        self._last_frame_time = simulated_time
        stamp = self._messages.stamp(simulated_time)
        self._write(GARMENT, stamp, self._messages.deferred_garment(simulated_time, positions.copy(), triangles))

    def follow(self, simulation: Simulation) -> None:
        """Adds what is due: 30 frames per simulated second, diagnostics once a second.

        To be called after each tick, for example as `on_tick` of `Simulation.settle`, and before the first.
        """
        self._follow_schedule(simulation)
        if simulation.time - self._last_frame_time >= 1.0 / FRAME_RATE:
            self.frame(simulation.time, simulation.positions, simulation.triangles)
        now = time.monotonic()
        if now >= self._next_diagnostics:
            self._next_diagnostics = now + DIAGNOSTICS_INTERVAL
            self._diagnostics(simulation)

    def finish(self, simulation: Simulation, report: Report) -> None:
        """Adds the last frame, unless it is there already, the last diagnostics and the report."""
        self._follow_schedule(simulation)
        if simulation.time > self._last_frame_time:
            self.frame(simulation.time, simulation.positions, simulation.triangles)
        self._diagnostics(simulation)
        self._write(REPORT, self._messages.stamp(simulation.time), encode_string(report.to_json()))

    def _follow_schedule(self, simulation: Simulation) -> None:
        """Adds how the simulation was moved, if it says so and that has changed."""
        if not isinstance(simulation, ScheduledSimulation):
            return
        change = self._schedule.change(simulation.schedule)
        if change is not None:
            self._write(SCHEDULE, self._messages.stamp(simulation.time), encode_string(json.dumps(change)))

    def _diagnostics(self, simulation: Simulation) -> None:
        progress = simulation.progress
        level = Level.ERROR if progress.phase == "failed" else Level.OK
        status = run_status("cloth_sim", level, progress.phase, progress)
        stamp = self._messages.stamp(simulation.time)
        self._write(DIAGNOSTICS, stamp, encode_diagnostics(time.time_ns(), [status]))

    def _write(self, topic: Topic, log_time: int, message: Message) -> None:
        if self._failure is not None:
            self.close()
        if self._log is None:
            raise LogError(f"log {self._path}: it is closed; start another one")
        self._log.write(topic, log_time, message)

    def _on_failed(self, _: BackgroundLog, error: LogError) -> None:
        self._failure = error

    def close(self) -> None:
        """Ends the log, which is complete on return; once closed, does nothing."""
        log, self._log = self._log, None
        if log is not None:
            log.close()

    def __enter__(self) -> "RunRecorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
