"""Simulates the runs of a log again from what is in the log alone, and compares each frame and report bit by bit."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.errors import ClothError
from cloth_core.fabric import Fabric
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_sim_ros.log_check import check_log
from cloth_sim_ros.log_reader import LoggedMessage, LogReader
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import NANOSECONDS, decode_marker, decode_mesh, decode_string
from cloth_sim_ros.run_identity import FORMAT, checksum, versions
from cloth_sim_ros.run_messages import RunMessages
from cloth_sim_ros.scheduled_simulation import (
    ActError,
    FindBody,
    Motion,
    OutsideAct,
    repeat,
    schedule_from,
    vertices_checksum,
)
from cloth_sim_ros.topics import BODY, BODY_MARKER, GARMENT, PARAMETERS, PATTERN, REPORT, SCHEDULE, Topic

__all__ = ["ReplayDifference", "Verification", "replay_log", "verify_log"]

OnTick = Callable[[Simulation], None]

_NOT_COMPARED = ("wall_time", "rest_reason")
# Of a term: what is measured anew in each run.
_MEASURED_ANEW = ("microseconds_per_step", "share", "within")
"""Of a report: what a clock measures, and in which words the run ended. Of `terms`, all but the cost is compared."""


class ReplayDifference(ClothError):
    """A simulation from the log's inputs does not give what the log holds."""


@dataclass(frozen=True)
class Verification:
    """What was compared and found to be identical."""

    runs: int
    frames: int
    particles: int
    """Positions compared, those of all frames together."""
    reports: int
    simulated_time: float
    """Of all runs together [s]."""
    state_sha256: str
    """Of the last report; empty if there is none."""


@dataclass(frozen=True)
class _LoggedRun:
    """One run of a log: from its parameters to those of the next run."""

    number: int
    parameters: dict[str, Any]
    start: int
    end: int | None
    """Times [ns since 1970]; None is the end of the log."""

    def holds(self, log_time: int) -> bool:
        return self.start <= log_time and (self.end is None or log_time < self.end)


def replay_log(path: str | os.PathLike[str], on_tick: OnTick | None = None) -> list[Report]:
    """Simulates all runs of a log again, each as far as the log has frames of it.

    Raises:
        LogError: the log cannot be read or does not hold what it takes.
        ClothError: its inputs cannot be used.
    """
    reports = []
    with LogReader(path) as log:
        for run in _runs(log):
            simulation = Simulation(_scene(log, run))
            frames = [message.log_time for message in _of_run(log, GARMENT, run)]
            if frames:
                last = RunMessages(run.start, "map")

                def look(simulation: Simulation, last: RunMessages = last, end: int = frames[-1]) -> bool:
                    if on_tick is not None:
                        on_tick(simulation)
                    return last.stamp(simulation.time) >= end

                try:
                    repeat(simulation, _schedule(log, run), look, _moved_bodies(log, run))
                except ActError as error:
                    raise LogError(f"log {path}, run {run.number}: {error}") from None
                reports.append(simulation.report())
    if not reports:
        raise LogError(f"log {path}: it holds no frame of a garment; record a run")
    return reports


def verify_log(path: str | os.PathLike[str], on_tick: OnTick | None = None) -> Verification:
    """Checks each byte of a log against its checksums, simulates its runs again, and compares.

    Compared are, bit by bit: the positions of each frame of the garment; the body's marker; of each report the SHA-256
    of positions and velocities and all values but those that a clock measures. Patterns and bodies must have the
    checksums that are noted in the parameters.

    Args:
        path: the log
        on_tick: called while it is simulated

    Raises:
        LogError: the log cannot be read, is damaged (the line says where) or does not hold what it takes.
        ReplayDifference: says which frame and particle, or which value of a report, differs first.
    """
    check_log(path)
    with LogReader(path) as log:
        comparisons = [_verify_run(log, run, on_tick) for run in _runs(log)]
    done = [comparison for comparison in comparisons if comparison.frames]
    if not done:
        raise LogError(f"log {path}: it holds no frame of a garment; record a run")
    return Verification(
        runs=len(done),
        frames=sum(comparison.frames for comparison in done),
        particles=sum(comparison.particles for comparison in done),
        reports=sum(comparison.reports for comparison in done),
        simulated_time=sum(comparison.time for comparison in done),
        state_sha256=done[-1].state_sha256,
    )


# -- what the log holds


def _runs(log: LogReader) -> list[_LoggedRun]:
    found: dict[int, dict[str, Any]] = {}
    for message in log.messages(PARAMETERS):
        parameters = _json(log, message)
        identity = parameters.get("replay")
        if not isinstance(identity, dict) or identity.get("format") != FORMAT:
            raise LogError(
                f"log {log.path}, {message.topic}: it does not say what it takes to simulate the run again; "
                "record it with this version"
            )
        found[_get(log, identity, "start", int)] = parameters
    if not found:
        raise LogError(f"log {log.path}: it holds no parameters of a run; record one with this version")
    starts = sorted(found)
    return [
        _LoggedRun(number, found[start], start, end)
        for number, (start, end) in enumerate(zip(starts, [*starts[1:], None], strict=True), 1)
    ]


def _of_run(log: LogReader, topic: Topic, run: _LoggedRun) -> Iterator[LoggedMessage]:
    return (message for message in log.messages(topic) if run.holds(message.log_time))


def _schedule(log: LogReader, run: _LoggedRun) -> tuple[Motion, ...]:
    try:
        return schedule_from([_json(log, message) for message in _of_run(log, SCHEDULE, run)])
    except ValueError as error:
        raise LogError(f"log {log.path}, run {run.number}, {SCHEDULE.name}: {error}; record the run again") from None


def _scene(log: LogReader, run: _LoggedRun) -> Scene:
    """The scene of a run, from what the log holds."""
    identity = run.parameters["replay"]
    patterns = [
        Pattern.from_json(decode_string(_input(log, PATTERN, run, entry)), str(entry.get("name")))
        for entry in _get(log, identity, "patterns", list)
    ]
    body = None
    if identity.get("body") is not None:
        entry = _get(log, identity, "body", dict)
        body = Body.from_arrays(*decode_mesh(_input(log, BODY, run, entry)), str(entry.get("name")))
    try:
        fabric = Fabric(**_get(log, identity, "fabric", dict))
        settings = Settings(**_get(log, identity, "settings", dict))
    except TypeError as error:
        raise LogError(f"log {log.path}, {PARAMETERS.name}: {error}; replay it with the version it names") from None
    return Scene.build(
        patterns,
        body,
        fabric,
        settings=settings,
        gravity=_get(log, identity, "gravity", float),
        air_drag=_get(log, identity, "air_drag", float),
        pins=_get(log, identity, "pins", list),
        without=identity.get("without", ()),
    )


def _moved_bodies(log: LogReader, run: _LoggedRun) -> FindBody:
    """Where the body went, as the messages of the run say; to be asked in the order of time."""
    messages = _of_run(log, BODY, run)

    def find(wanted: str) -> NDArray[np.float64]:
        for message in messages:
            vertices, _ = decode_mesh(message.data)
            if vertices_checksum(vertices) == wanted:
                return vertices
        raise LogError(
            f"no message of topic {BODY.name} has vertices of the checksum {wanted}; it was changed or left out, or "
            "the body had moved before recording began"
        )

    return find


def _input(log: LogReader, topic: Topic, run: _LoggedRun, entry: dict[str, Any]) -> bytes:
    """The message of a pattern or body with the checksum that the run names."""
    wanted = entry.get("sha256")
    for message in log.messages(topic):
        content = decode_string(message.data).encode("utf-8") if topic is PATTERN else message.data
        if checksum(content) == wanted:
            return message.data
    raise LogError(
        f"log {log.path}, run {run.number}, topic {topic.name}: no message has the checksum {wanted} of "
        f"'{entry.get('name')}', of which the run was made; it was changed or left out"
    )


def _json(log: LogReader, message: LoggedMessage) -> dict[str, Any]:
    try:
        content = json.loads(decode_string(message.data))
    except (ValueError, ClothError):
        content = None
    if not isinstance(content, dict):
        raise LogError(f"log {log.path}, {message.topic}: the text is not a JSON object; record the run again")
    return content


def _get(log: LogReader, values: dict[str, Any], key: str, kind: type[Any]) -> Any:
    value = values.get(key)
    if not isinstance(value, kind):
        raise LogError(f"log {log.path}, {PARAMETERS.name}: '{key}' of the run is missing; record it again")
    return value


# -- comparison


def _verify_run(log: LogReader, run: _LoggedRun, on_tick: OnTick | None) -> _Comparison:
    scene = _scene(log, run)
    comparison = _Comparison(log, run, scene)
    if comparison.done:
        return comparison
    simulation = Simulation(scene)

    def look(simulation: Simulation) -> bool:
        if on_tick is not None:
            on_tick(simulation)
        return comparison.look(simulation)

    try:
        out_of_step = repeat(simulation, _schedule(log, run), look, _moved_bodies(log, run))
    except OutsideAct as act:
        raise LogError(
            f"log {log.path}, run {run.number}: the first {comparison.frames} frames are identical; then {act}; "
            "it can be verified no further"
        ) from None
    except ActError as error:
        raise LogError(
            f"log {log.path}, run {run.number}: the first {comparison.frames} frames are identical; then {error}"
        ) from None
    if not comparison.done:
        comparison.miss(simulation, out_of_step)
    return comparison


class _Comparison:
    """Frames and reports of a run, taken off as the simulation comes by."""

    def __init__(self, log: LogReader, run: _LoggedRun, scene: Scene) -> None:
        self.frames = self.reports = self.particles = 0
        self.time = 0.0
        self.state_sha256 = ""
        self._log, self._run, self._scene = log, run, scene
        self._messages = RunMessages(run.start, "map")
        self._waiting_frames = _of_run(log, GARMENT, run)
        self._waiting_reports = _of_run(log, REPORT, run)
        self._bodies = ((message, decode_marker(message.data)) for message in _of_run(log, BODY_MARKER, run))
        self._body = next(self._bodies, None)
        self._frame = next(self._waiting_frames, None)
        self._report = next(self._waiting_reports, None)
        self._doubt: tuple[int, LoggedMessage, ReplayDifference] | None = None
        """A report that differs so far, with the step: at the end of a motion it may have been made a moment later."""

    @property
    def done(self) -> bool:
        nothing_to_report = self._doubt is None and (self._report is None or self.frames == 0)
        return self._frame is None and nothing_to_report

    def look(self, simulation: Simulation) -> bool:
        """Compares what the log has of this moment; true once there is nothing more."""
        stamp = self._messages.stamp(simulation.time)
        self.time = simulation.time
        self._compare_body(simulation, stamp)
        while self._frame is not None and self._frame.log_time <= stamp:
            if self._frame.log_time < stamp:
                self.miss(simulation, None)
            self._compare_frame(simulation, self._frame)
            self._frame = next(self._waiting_frames, None)
        self._settle_doubt(simulation)
        while self._report is not None and self._report.log_time <= stamp:
            self._compare_report(simulation, self._report)
            self._report = next(self._waiting_reports, None)
        return self.done

    def _settle_doubt(self, simulation: Simulation) -> None:
        if self._doubt is not None:
            (step, message, difference), self._doubt = self._doubt, None
            if step != simulation.steps:
                raise difference
            self.reports -= 1
            self._compare_report(simulation, message)

    def _compare_body(self, simulation: Simulation, stamp: int) -> None:
        """By the stamp in the marker: a log that began later has the last one of before."""
        while self._body is not None and self._body[1].stamp <= stamp:
            message, marker = self._body
            body = simulation.scene.body
            if body is not None and marker.stamp == stamp:
                expected = body.vertices[body.triangles].reshape(-1, 3)
                if marker.points.tobytes() != expected.tobytes():
                    raise self._difference(
                        f"{message.topic} (at {simulation.time:.6g} s): it is not the body of the run"
                    )
            self._body = next(self._bodies, None)

    def _compare_frame(self, simulation: Simulation, message: LoggedMessage) -> None:
        self.frames += 1
        corners = simulation.triangles.ravel()
        self.particles += len(simulation.positions)
        logged, expected = decode_marker(message.data).points, simulation.positions[corners]
        if logged.shape != expected.shape:
            raise self._difference(
                f"frame {self.frames}: {len(logged) // 3} triangles in the log, {len(expected) // 3} simulated"
            )
        other = (logged.view(np.uint64) != np.ascontiguousarray(expected).view(np.uint64)).any(axis=1)
        if other.any():
            corner = int(other.argmax())
            particle = int(corners[corner])
            garment = self._scene.garment
            panel = garment.panel_names[garment.panel_of_particle[particle]]
            apart = float(np.linalg.norm(logged[corner] - expected[corner]))
            count = len(np.unique(corners[other]))
            raise self._difference(
                f"frame {self.frames} (at {simulation.time:.6g} s, step {simulation.steps}, {message.topic}), "
                f"particle {particle} of panel '{panel}': {logged[corner].tolist()} m in the log, "
                f"{expected[corner].tolist()} m simulated, {apart:.3g} m apart; {count} particles differ"
            )

    def _compare_report(self, simulation: Simulation, message: LoggedMessage) -> None:
        self.reports += 1
        logged, expected = _json(self._log, message), simulation.report().to_dict()
        self.state_sha256 = str(expected["state_sha256"])
        for key in ("state_sha256", *expected):
            mine, theirs = (_comparable(key, values.get(key)) for values in (expected, logged))
            if mine != theirs:
                difference = self._difference(
                    f"report {self.reports} (at {simulation.time:.6g} s, {message.topic}), {key}: {theirs} in the log, "
                    f"{mine} simulated"
                )
                if self._doubt is not None:
                    raise self._doubt[2]
                self._doubt = (simulation.steps, message, difference)
                return

    def miss(self, simulation: Simulation, out_of_step: tuple[Motion, int] | None) -> None:
        """Raises because the next frame or report is not passed, or a report differs."""
        if self._doubt is not None:
            raise self._doubt[2]
        waiting = self._frame or self._report
        assert waiting is not None
        moment = (waiting.log_time - self._run.start) / NANOSECONDS
        why = (
            f"the simulation passes {simulation.time:.9g} s after step {simulation.steps} without it"
            if out_of_step is None
            else f"{out_of_step[0].kind} began after {out_of_step[0].steps} steps there, {out_of_step[1]} here"
        )
        raise self._difference(f"frame {self.frames + 1} (at {moment:.9g} s, {waiting.topic}): {why}")

    def _difference(self, line: str) -> ReplayDifference:
        return ReplayDifference(f"log {self._log.path}, run {self._run.number}, {line}{_other_versions(self._run)}")


def _comparable(key: str, value: Any) -> Any:
    if key == "terms" and isinstance(value, dict):
        return {name: {k: v for k, v in term.items() if k not in _MEASURED_ANEW} for name, term in value.items()}
    return None if key in _NOT_COMPARED else value


def _other_versions(run: _LoggedRun) -> str:
    """What is not as it was when the log was recorded, which may well be the reason."""
    recorded = run.parameters["replay"].get("versions")
    if not isinstance(recorded, dict):
        return ""
    here = versions()
    other = [f"{name} {recorded.get(name)} (here {here[name]})" for name in here if recorded.get(name) != here[name]]
    return f"; recorded with {', '.join(other)}" if other else ""
