"""Runs one garment at a time in a thread of its own and answers commands at once. Knows no ROS graph.

The simulation thread steps the present run, a few milliseconds a tick. The builder's thread makes the next one; a scene
that cannot be built leaves the present run as it is, and one that can replaces it between two ticks.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cloth_core.errors import ClothError, SceneError, SimulationError
from cloth_core.grasp import Pose
from cloth_core.pattern import Pattern
from cloth_sim_ros.diagnostics import run_status
from cloth_sim_ros.grippers import Grippers, particles_near
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import Level, encode_diagnostics
from cloth_sim_ros.outlet import Listener, Outlet
from cloth_sim_ros.output_files import claim_path
from cloth_sim_ros.run_sender import RunSender
from cloth_sim_ros.scene_builder import Run, SceneBuilder
from cloth_sim_ros.scene_inputs import ReceivedBody, SceneInputs, SceneParameters
from cloth_sim_ros.simulation_thread import SimulationThread
from cloth_sim_ros.topics import DEFAULT_NODE_NAME, DIAGNOSTICS
from cloth_sim_ros.worker_settings import WorkerSettings
from cloth_sim_ros.worker_state import Mode, WorkerState

__all__ = ["SimulationWorker", "WorkerSettings"]

CLOSE_TIMEOUT = 5.0
"""How long closing waits for each thread [s]."""


class SimulationWorker:
    """Drives the simulation by commands from any thread.

    Each command answers with one line on what was accepted, or raises ClothError with one line on why not. What takes
    longer is done by the worker's threads and shows in `describe`, in the diagnostics and in the listener's lines.

    Args:
        listener: gets messages and lines
        node_name: fully qualified; for the topics of logs and the diagnostics
        parameters: of the first scene
        settings: act at once
    """

    def __init__(
        self,
        listener: Listener,
        *,
        node_name: str = DEFAULT_NODE_NAME,
        parameters: SceneParameters | None = None,
        settings: WorkerSettings | None = None,
    ) -> None:
        self._listener = listener
        self._node_name = node_name
        self._outlet = Outlet(listener, node_name)
        self._grippers = Grippers()
        self._state = WorkerState(settings or WorkerSettings(), lambda: self._builder.busy)
        self._builder = SceneBuilder(
            parameters or SceneParameters(), self._state.settings.limits, self._on_accepted, self._on_refused
        )
        self._thread = SimulationThread(self._state, self._outlet, listener, self._grippers)

    # -- commands ------------------------------------------------------------------------------------------------------

    def load_pattern(self, text: str, name: str = "pattern") -> None:
        """Takes a GarmentCode pattern (JSON); its garment replaces the present one as soon as it is built."""
        self._builder.request("pattern", lambda inputs: replace(inputs, pattern=Pattern.from_json(text, name)))

    def load_body(
        self, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32], name: str = "body"
    ) -> None:
        """Takes a body, vertices [m] (n, 3), triangles (m, 3).

        The garment starts again around it; if it is on a body of the same triangles already, that body moves instead.
        """
        if self._move_body(vertices, triangles):
            return
        self._builder.request(
            "body", lambda inputs: replace(inputs, body=ReceivedBody.from_arrays(vertices, triangles, name))
        )

    def load_builtin_pattern(self, name: str) -> None:
        """Takes a pattern that comes with the package."""
        self._builder.request("pattern", lambda inputs: replace(inputs, pattern=Pattern.load(name)))

    def load_builtin_body(self, name: str) -> None:
        """Takes a body that comes with the package."""
        self._builder.request("body", lambda inputs: replace(inputs, body=ReceivedBody.builtin(name)))

    def refuse(self, line: str) -> None:
        """Notes that an input was refused before it came here."""
        self._state.refusal = line
        self._listener.warn(line)

    def configure(self, parameters: SceneParameters, settings: WorkerSettings) -> None:
        """Takes parameters for the next pattern, body or reset, and settings for at once."""
        self._builder.parameters = parameters
        self._builder.limits = settings.limits
        with self._state.wake:
            self._state.settings = settings
            self._state.wake.notify_all()

    def start(self) -> str:
        """Lets the garment move, until it is at rest or something else is asked for."""
        with self._state.wake:
            self._need_unfinished_run("start")
            return self._state.set_mode(Mode.MOTION, "running")

    def drape(self) -> str:
        """Runs to rest, with the extra air drag that calms swinging; a run that is over starts again."""
        with self._state.wake:
            self._need_garment("drape")
            if self._state.is_over() and not self._state.is_building():
                self._state.resetting = True
                self._builder.rebuild()
            return self._state.set_mode(Mode.DRAPE, "draping; the report follows at rest")

    def step(self, count: int = 1) -> str:
        """Moves the garment by `count` steps of `step_duration` and pauses."""
        with self._state.wake:
            self._need_unfinished_run("step")
            self._state.steps = count
            steps = "one step" if count == 1 else f"{count} steps"
            return self._state.set_mode(Mode.STEP, f"{steps} of {self._state.settings.step:.4g} s")

    def pause(self) -> str:
        """Halts the garment where it is."""
        with self._state.wake:
            return self._state.set_mode(Mode.PAUSED, "paused")

    def reset(self) -> str:
        """Puts the garment back to its start, paused, with the parameters as they are now."""
        with self._state.wake:
            self._need_garment("reset")
            self._state.resetting = True
            self._builder.rebuild()
            return self._state.set_mode(Mode.PAUSED, "back at the start, paused")

    def move_gripper(self, name: str, pose: Pose) -> None:
        """Says where a gripper is; what it holds follows."""
        if not self._grippers.set_pose(name, pose):
            return

        def go_on(_: Run) -> None:
            with self._state.wake:
                self._state.resume()

        with self._state.wake:
            # Done between two ticks or, when the run has just ended and its report is being made, after that.
            if self._state.run is not None and name in self._state.run.simulation.grasps:
                self._state.add_task(go_on)

    def grasp(self, name: str) -> str:
        """Holds the particles around a gripper from now on."""
        pose = self._grippers.pose(name)
        with self._state.wake:
            run = self._run_for("grasp")
            if name in run.simulation.grasps:
                raise SceneError(f"{name}: it holds cloth already; release it first")
            chosen = particles_near(name, pose, self._state.positions, self._state.settings.grasp_radius)
            self._state.add_task(
                lambda current: self._thread.act_on(run, current, lambda: run.simulation.grasp(name, chosen, pose))
            )
        return f"{name} holds {len(chosen)} particles"

    def release(self, name: str) -> str:
        """Lets go of what a gripper holds."""
        with self._state.wake:
            run = self._run_for("release")
            if name not in run.simulation.grasps:
                raise SceneError(f"{name}: it holds nothing; grasp first")
            self._state.add_task(
                lambda current: self._thread.act_on(run, current, lambda: run.simulation.release(name))
            )
        return f"{name} holds nothing"

    def save(self) -> str:
        """Writes the garment (GLB) and its report (JSON) into the record directory, and sends the report."""
        with self._state.wake:
            if self._state.run is None:
                raise SceneError("save: there is no garment yet; publish a pattern first")
            try:
                path = self._claim((".json", ".glb"), lambda path: Path(f"{path}.json").touch(exist_ok=False))
            except OSError as error:
                raise ClothError(f"save: {error.filename}: {error.strerror}; set record_directory to another") from None
            report_path, mesh_path = Path(f"{path}.json"), Path(f"{path}.glb")
            self._state.add_task(lambda run: self._thread.write_result(run, mesh_path, report_path))
        return f"saving {mesh_path} and {report_path}"

    def record(self, on: bool) -> str:
        """Starts or ends a log in the record directory."""
        if not on:
            return f"recorded {self._outlet.stop_log()}"
        path = self._claim((".mcap",), lambda path: self._outlet.start_log(f"{path}.mcap"))
        with self._state.wake:
            self._state.add_task(self._thread.send_frame)
        return f"recording {path}.mcap"

    def describe(self) -> dict[str, Any]:
        """State, scene with its terms and their reasons, progress and parameters, as values that JSON can hold."""
        with self._state.wake:
            run, state = self._state.run, self._state.name()
        progress, log_path = self._state.progress, self._outlet.log_path
        return {
            "state": state,
            "scene": None if run is None else run.description,
            "progress": None if progress is None else asdict(progress),
            "largest_strain": self._state.largest_strain,
            "grippers": {} if run is None else run.simulation.grasps.describe(),
            "body_moves": run is not None and run.simulation.body_moves,
            "stamp": self._outlet.last_stamp,
            "parameters": self._builder.parameters.to_dict(),
            "settings": asdict(self._state.settings),
            "recording": None if log_path is None else str(log_path),
            "recording_failure": self._outlet.log_failure or None,
            "refused": self._state.refusal or None,
            "report": None if run is None or run.report is None else run.report.to_dict(),
        }

    def diagnose(self) -> None:
        """Sends the state of the run as diagnostics."""
        with self._state.wake:
            run, state = self._state.run, self._state.name()
        level, message = Level.OK, state
        if self._state.refusal:
            level, message = Level.WARN, f"{state}; {self._state.refusal}"
        if self._outlet.log_failure:
            level, message = Level.WARN, f"{message}; {self._outlet.log_failure}"
        if self._state.failure:
            level, message = Level.ERROR, self._state.failure
        details: dict[str, object] = {"state": state}
        if run is not None:
            details |= {
                "garment": run.scene.garment.name,
                "particles": run.description["particles"],
                "triangles": run.description["triangles"],
                "time step [s]": run.description["time_step"],
                "largest strain": self._state.largest_strain,
            }
        details["recording"] = self._outlet.log_path or "no"
        status = run_status(self._node_name, level, message, self._state.progress, details)
        self._outlet.send(DIAGNOSTICS, encode_diagnostics(time.time_ns(), [status]))
        # For those who have come late, while time stands still.
        self._thread.send_clock(self._outlet.last_stamp)

    def close(self) -> None:
        """Ends the threads and the log; to be called once."""
        with self._state.wake:
            self._state.closing = True
            self._state.wake.notify_all()
        self._thread.join(CLOSE_TIMEOUT)
        self._builder.close(CLOSE_TIMEOUT)
        if self._outlet.log_path is not None:
            try:
                self._listener.inform(f"recorded {self._outlet.stop_log()}")
            except LogError as error:
                self._listener.warn(str(error))

    # -- parts of commands; the state's wake is held -------------------------------------------------------------------

    def _need_garment(self, command: str) -> None:
        if self._state.run is None and not self._state.is_building():
            raise SceneError(f"{command}: there is no garment; {self._state.refusal or 'publish a pattern first'}")

    def _need_unfinished_run(self, command: str) -> None:
        self._need_garment(command)
        if self._state.is_over() and not self._state.is_building():
            raise SceneError(f"{command}: the run is over; reset it first")

    def _run_for(self, command: str) -> Run:
        """The run on which something from outside is to act."""
        if self._state.run is None:
            raise SceneError(f"{command}: there is no garment yet; publish a pattern first")
        if self._state.run.simulation.phase == "failed":
            raise SimulationError(f"{command}: the run has failed; reset it first")
        return self._state.run

    def _claim(self, suffixes: tuple[str, ...], claim: Callable[[Path], object]) -> Path:
        run = self._state.run
        name = "cloth_sim" if run is None else run.scene.garment.name
        return claim_path(self._state.settings.record_directory, name, suffixes, claim)

    def _move_body(self, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> bool:
        """Lets the present body move to these vertices; false if it is another body, or nothing has moved yet."""
        duration, speed = self._state.settings.body_move_duration, self._state.settings.body_speed
        with self._state.wake:
            run = self._state.run
            begun = run is not None and run.simulation.time > 0.0 and run.simulation.phase != "failed"
        if run is None or duration <= 0.0 or not begun:
            return False
        moved = self._builder.body_has_moved(lambda body: body.moved(vertices, triangles))
        if moved is None:
            return False

        def move() -> None:
            run.simulation.move_body(moved.body.vertices, duration, speed)
            if self._thread.sender is not None:
                self._thread.sender.moved_body(run, moved.message)

        with self._state.wake:
            self._state.refusal = ""
            self._state.add_task(lambda current: self._thread.act_on(run, current, move))
        return True

    # -- called by the builder, in its thread --------------------------------------------------------------------------

    def _on_accepted(self, inputs: SceneInputs, run: Run | None) -> None:
        self._state.refusal = ""
        if run is None:
            RunSender(inputs, self._outlet).body()
            return
        with self._state.wake:
            self._state.next_run = run
            self._state.resetting = False
            self._state.wake.notify_all()

    def _on_refused(self, line: str) -> None:
        with self._state.wake:
            self._state.resetting = False
            if self._state.run is None or self._state.is_over():
                self._state.mode = Mode.PAUSED
            self._state.wake.notify_all()
        self.refuse(line)
