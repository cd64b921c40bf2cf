"""Sends what there is to know of a run: what goes in, each frame, and the report."""

import json
from dataclasses import asdict

from cloth_core.report import Report
from cloth_sim_ros.messages import encode_string
from cloth_sim_ros.outlet import Outlet
from cloth_sim_ros.run_identity import run_identity
from cloth_sim_ros.run_messages import RunMessages
from cloth_sim_ros.scene_builder import Run
from cloth_sim_ros.scene_inputs import SceneInputs
from cloth_sim_ros.scheduled_simulation import ScheduleFollower
from cloth_sim_ros.topics import BODY, BODY_MARKER, GARMENT, PARAMETERS, PATTERN, REPORT, SCHEDULE

__all__ = ["RunSender"]


class RunSender:
    """Encodes the messages of one run and sends them with its stamps.

    Args:
        inputs: of the run; without a pattern there is only a body to be sent
        outlet: where the messages go
    """

    def __init__(self, inputs: SceneInputs, outlet: Outlet) -> None:
        parameters = inputs.parameters
        self._inputs = inputs
        self._outlet = outlet
        self._messages = RunMessages(
            outlet.next_start(),
            parameters.frame_id,
            garment_color=parameters.garment_color,
            body_color=parameters.body_color,
        )
        self._sent_time: float | None = None
        self._schedule_follower = ScheduleFollower()
        self._sent_body = inputs.body.body if inputs.body is not None else None

    def body(self) -> None:
        """Sends the body and its marker, if there is one."""
        received, start = self._inputs.body, self._messages.start
        if received is not None:
            body = received.body
            self._outlet.send(BODY, received.message, start)
            self._outlet.send(BODY_MARKER, self._messages.body(body.vertices, body.triangles), start)

    def begin(self, run: Run) -> None:
        """Sends all that a late joiner or a log needs to know of a run, and its first frame."""
        assert self._inputs.pattern is not None
        start = self._messages.start
        body = self._inputs.body
        parameters = {
            **self._inputs.parameters.to_dict(),
            "settings": asdict(run.scene.settings),
            "replay": run_identity(
                run.scene,
                [self._inputs.pattern],
                None if body is None else body.body,
                None if body is None else body.message,
                start,
            ),
        }
        self._outlet.forget(REPORT)
        self._outlet.send(PATTERN, encode_string(self._inputs.pattern.source), start)
        self._outlet.send(PARAMETERS, encode_string(json.dumps(parameters, sort_keys=True)), start)
        self.body()
        self.frame(run)

    def is_behind(self, run: Run) -> bool:
        """Whether the garment has moved since the last frame."""
        return run.simulation.time != self._sent_time

    def frame(self, run: Run) -> None:
        """Sends the garment as it is."""
        simulation = run.simulation
        self._schedule(run)
        self._sent_time = simulation.time
        stamp = self._messages.stamp(simulation.time)
        body = simulation.scene.body
        if body is not None and body is not self._sent_body:
            self._sent_body = body
            marker = self._messages.body(body.vertices, body.triangles, simulation.time)
            self._outlet.send(BODY_MARKER, marker, stamp)
        # Positions are a copy of the simulation's own, and triangles stay the same.
        garment = self._messages.deferred_garment(simulation.time, simulation.positions, simulation.triangles)
        self._outlet.send(GARMENT, garment, stamp)

    def moved_body(self, run: Run, message: bytes) -> None:
        """Logs a `shape_msgs/Mesh` to which the body is to move from now on."""
        self._outlet.send(BODY, message, self._messages.stamp(run.simulation.time))

    def stamp(self, run: Run) -> int:
        """Time of the run [ns since 1970], as in the header of a frame sent now."""
        return self._messages.stamp(run.simulation.time)

    def report(self, run: Run, report: Report) -> None:
        """Sends a report of the garment as it is."""
        self._schedule(run)
        self._outlet.send(REPORT, encode_string(report.to_json()), self._messages.stamp(run.simulation.time))

    def _schedule(self, run: Run) -> None:
        """Sends how the run was moved, if that has changed, ahead of what came of it."""
        schedule = run.simulation.schedule
        change = self._schedule_follower.change(schedule)
        if change is None:
            return
        end = len(schedule)

        def whole() -> bytes:
            return _encode_json(ScheduleFollower().change(schedule[:end]))

        self._outlet.send(SCHEDULE, _encode_json(change), self._messages.stamp(run.simulation.time), latched=whole)


def _encode_json(values: object) -> bytes:
    return encode_string(json.dumps(values))
