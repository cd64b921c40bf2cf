"""Runs one garment at a time in a thread of its own and answers commands at once. Knows no ROS graph.

The simulation thread steps the present run, a few milliseconds a tick. The builder's thread makes the next one; a scene
that cannot be built leaves the present run as it is, and one that can replaces it between two ticks.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cloth_core.errors import ClothError, SceneError, SimulationError
from cloth_core.grasp import Pose
from cloth_core.mesh_files import write_file, write_mesh
from cloth_core.pattern import Pattern
from cloth_core.report import Report
from cloth_core.simulation import Progress
from cloth_core.springs import spring_strains
from cloth_sim_ros.diagnostics import run_status
from cloth_sim_ros.grippers import Grippers, particles_near
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import Level, encode_clock, encode_diagnostics
from cloth_sim_ros.outlet import Listener, Outlet
from cloth_sim_ros.output_files import claim_path
from cloth_sim_ros.pacing import RealTimePace
from cloth_sim_ros.run_sender import RunSender
from cloth_sim_ros.scene_builder import Run, SceneBuilder
from cloth_sim_ros.scene_inputs import Limits, ReceivedBody, SceneInputs, SceneParameters
from cloth_sim_ros.topics import CLOCK, DEFAULT_NODE_NAME, DIAGNOSTICS

__all__ = ["SimulationWorker", "WorkerSettings"]

CLOSE_TIMEOUT = 5.0
"""How long closing waits for each thread [s]."""
STRAIN_INTERVAL = 1.0
"""Wall-clock time between two measurements of the strain while the garment moves [s]."""
CLOCK_INTERVAL = 0.01
"""Wall-clock time between two messages on /clock while the garment moves [s]."""


@dataclass(frozen=True)
class WorkerSettings:
    """Values that act at once."""

    publish_rate: float = 30.0
    """Frames per second of wall-clock time while the garment moves [Hz]."""
    auto_start: bool = False
    """Start a new garment by itself."""
    paused: bool = False
    """Hold the garment still, whatever was asked for."""
    real_time_factor: float = 0.0
    """Most simulated per wall-clock time; 0 is as fast as possible."""
    step_duration: float = 0.0
    """Simulated time of a step [s]; 0 is 1 / publish_rate."""
    publish_clock: bool = False
    """Send the time of the run."""
    grasp_radius: float = 0.03
    """A gripper takes the particles that are not farther from it [m]."""
    grasp_speed: float = 1.0
    """No held particle is moved faster [m/s]."""
    body_move_duration: float = 0.1
    """Simulated time in which a body that comes again gets to its new place [s]; 0 lets the garment start again."""
    body_speed: float = 2.0
    """No vertex of the body is moved faster [m/s]."""
    record_directory: str = "cloth_sim_records"
    limits: Limits = field(default_factory=Limits)

    @property
    def step(self) -> float:
        """Simulated time of one step [s]."""
        return self.step_duration or 1.0 / self.publish_rate


class _Mode(Enum):
    PAUSED = "paused"
    MOTION = "running"
    DRAPE = "draping"
    STEP = "stepping"


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
        self._settings = settings or WorkerSettings()
        self._outlet = Outlet(listener, node_name)

        # Guarded by _wake: what the simulation thread is to do.
        self._wake = threading.Condition()
        self._closing = False
        self._mode = _Mode.PAUSED
        self._run: Run | None = None
        self._next_run: Run | None = None
        self._resetting = False
        self._tasks: deque[Callable[[Run], None]] = deque()
        self._steps = 1
        self._rested = False
        """Whether the run has paused by itself at rest; what acts from outside lets it go on."""
        self._grippers = Grippers()

        # Replaced whole by one thread, read by others without a lock.
        self._progress: Progress | None = None
        self._largest_strain: float | None = None
        self._refusal = ""
        self._failure = ""
        self._positions = np.zeros((0, 3))

        # Used by the simulation thread alone.
        self._sender: RunSender | None = None
        self._next_frame = 0.0
        self._next_strain = 0.0
        self._next_clock = 0.0
        self._clock = 0
        self._clock_lock = threading.Lock()
        self._pace = RealTimePace()
        self._builder = SceneBuilder(
            parameters or SceneParameters(), self._settings.limits, self._on_accepted, self._on_refused
        )
        self._thread = threading.Thread(target=self._loop, name="cloth_sim simulation", daemon=True)
        self._thread.start()

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
        self._refusal = line
        self._listener.warn(line)

    def configure(self, parameters: SceneParameters, settings: WorkerSettings) -> None:
        """Takes parameters for the next pattern, body or reset, and settings for at once."""
        self._builder.parameters = parameters
        self._builder.limits = settings.limits
        with self._wake:
            self._settings = settings
            self._wake.notify_all()

    def start(self) -> str:
        """Lets the garment move, until it is at rest or something else is asked for."""
        with self._wake:
            self._need_unfinished_run("start")
            return self._set_mode(_Mode.MOTION, "running")

    def drape(self) -> str:
        """Runs to rest, with the extra air drag that calms swinging; a run that is over starts again."""
        with self._wake:
            self._need_garment("drape")
            if self._is_over() and not self._is_building():
                self._resetting = True
                self._builder.rebuild()
            return self._set_mode(_Mode.DRAPE, "draping; the report follows at rest")

    def step(self, count: int = 1) -> str:
        """Moves the garment by `count` steps of `step_duration` and pauses."""
        with self._wake:
            self._need_unfinished_run("step")
            self._steps = count
            steps = "one step" if count == 1 else f"{count} steps"
            return self._set_mode(_Mode.STEP, f"{steps} of {self._settings.step:.4g} s")

    def pause(self) -> str:
        """Halts the garment where it is."""
        with self._wake:
            return self._set_mode(_Mode.PAUSED, "paused")

    def reset(self) -> str:
        """Puts the garment back to its start, paused, with the parameters as they are now."""
        with self._wake:
            self._need_garment("reset")
            self._resetting = True
            self._builder.rebuild()
            return self._set_mode(_Mode.PAUSED, "back at the start, paused")

    def move_gripper(self, name: str, pose: Pose) -> None:
        """Says where a gripper is; what it holds follows."""
        if not self._grippers.set_pose(name, pose):
            return
        with self._wake:
            if self._rested and self._run is not None and name in self._run.simulation.grasps:
                self._add_task(lambda _: None)  # so that the simulation thread looks
                self._resume()

    def grasp(self, name: str) -> str:
        """Holds the particles around a gripper from now on."""
        pose = self._grippers.pose(name)
        with self._wake:
            run = self._run_for("grasp")
            if name in run.simulation.grasps:
                raise SceneError(f"{name}: it holds cloth already; release it first")
            chosen = particles_near(name, pose, self._positions, self._settings.grasp_radius)
            self._add_task(lambda current: self._act_on(run, current, lambda: run.simulation.grasp(name, chosen, pose)))
        return f"{name} holds {len(chosen)} particles"

    def release(self, name: str) -> str:
        """Lets go of what a gripper holds."""
        with self._wake:
            run = self._run_for("release")
            if name not in run.simulation.grasps:
                raise SceneError(f"{name}: it holds nothing; grasp first")
            self._add_task(lambda current: self._act_on(run, current, lambda: run.simulation.release(name)))
        return f"{name} holds nothing"

    def save(self) -> str:
        """Writes the garment (GLB) and its report (JSON) into the record directory, and sends the report."""
        with self._wake:
            if self._run is None:
                raise SceneError("save: there is no garment yet; publish a pattern first")
            try:
                path = self._claim((".json", ".glb"), lambda path: Path(f"{path}.json").touch(exist_ok=False))
            except OSError as error:
                raise ClothError(f"save: {error.filename}: {error.strerror}; set record_directory to another") from None
            report_path, mesh_path = Path(f"{path}.json"), Path(f"{path}.glb")
            self._add_task(lambda run: self._write_result(run, mesh_path, report_path))
        return f"saving {mesh_path} and {report_path}"

    def record(self, on: bool) -> str:
        """Starts or ends a log in the record directory."""
        if not on:
            return f"recorded {self._outlet.stop_log()}"
        path = self._claim((".mcap",), lambda path: self._outlet.start_log(f"{path}.mcap"))
        with self._wake:
            self._add_task(self._send_frame)
        return f"recording {path}.mcap"

    def describe(self) -> dict[str, Any]:
        """State, scene with its terms and their reasons, progress and parameters, as values that JSON can hold."""
        with self._wake:
            run, state = self._run, self._state()
        progress, log_path = self._progress, self._outlet.log_path
        return {
            "state": state,
            "scene": None if run is None else run.description,
            "progress": None if progress is None else asdict(progress),
            "largest_strain": self._largest_strain,
            "grippers": {} if run is None else run.simulation.grasps.describe(),
            "body_moves": run is not None and run.simulation.body_moves,
            "stamp": self._outlet.last_stamp,
            "parameters": self._builder.parameters.to_dict(),
            "settings": asdict(self._settings),
            "recording": None if log_path is None else str(log_path),
            "recording_failure": self._outlet.log_failure or None,
            "refused": self._refusal or None,
            "report": None if run is None or run.report is None else run.report.to_dict(),
        }

    def diagnose(self) -> None:
        """Sends the state of the run as diagnostics."""
        with self._wake:
            run, state = self._run, self._state()
        level, message = Level.OK, state
        if self._refusal:
            level, message = Level.WARN, f"{state}; {self._refusal}"
        if self._outlet.log_failure:
            level, message = Level.WARN, f"{message}; {self._outlet.log_failure}"
        if self._failure:
            level, message = Level.ERROR, self._failure
        details: dict[str, object] = {"state": state}
        if run is not None:
            details |= {
                "garment": run.scene.garment.name,
                "particles": run.description["particles"],
                "triangles": run.description["triangles"],
                "time step [s]": run.description["time_step"],
                "largest strain": self._largest_strain,
            }
        details["recording"] = self._outlet.log_path or "no"
        status = run_status(self._node_name, level, message, self._progress, details)
        self._outlet.send(DIAGNOSTICS, encode_diagnostics(time.time_ns(), [status]))
        # For those who have come late, while time stands still.
        self._send_clock(self._outlet.last_stamp)

    def close(self) -> None:
        """Ends the threads and the log; to be called once."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._thread.join(CLOSE_TIMEOUT)
        self._builder.close(CLOSE_TIMEOUT)
        if self._outlet.log_path is not None:
            try:
                self._listener.inform(f"recorded {self._outlet.stop_log()}")
            except LogError as error:
                self._listener.warn(str(error))

    # -- parts of commands; _wake is held ------------------------------------------------------------------------------

    def _need_garment(self, command: str) -> None:
        if self._run is None and not self._is_building():
            raise SceneError(f"{command}: there is no garment; {self._refusal or 'publish a pattern first'}")

    def _need_unfinished_run(self, command: str) -> None:
        self._need_garment(command)
        if self._is_over() and not self._is_building():
            raise SceneError(f"{command}: the run is over; reset it first")

    def _is_building(self) -> bool:
        # In this order: a run is handed over before the builder ceases to be busy.
        return self._builder.busy or self._next_run is not None

    def _is_over(self) -> bool:
        return self._run is not None and self._run.simulation.phase in ("rest", "failed")

    def _run_for(self, command: str) -> Run:
        """The run on which something from outside is to act."""
        if self._run is None:
            raise SceneError(f"{command}: there is no garment yet; publish a pattern first")
        if self._run.simulation.phase == "failed":
            raise SimulationError(f"{command}: the run has failed; reset it first")
        return self._run

    def _resume(self) -> None:
        """Lets a run that has paused by itself at rest go on."""
        if self._rested and self._mode is _Mode.PAUSED:
            self._mode = _Mode.MOTION
        self._rested = False
        self._wake.notify_all()

    def _is_held(self, mode: _Mode) -> bool:
        return self._settings.paused and mode in (_Mode.MOTION, _Mode.DRAPE)

    def _set_mode(self, mode: _Mode, answer: str) -> str:
        self._mode = mode
        self._rested = False
        self._wake.notify_all()
        if self._is_building():
            return f"{answer}, once the garment is built"
        if self._is_held(mode):
            return f"{answer}, once the parameter paused is false"
        return f"{answer}; {self._refusal}" if self._refusal else answer

    def _add_task(self, task: Callable[[Run], None]) -> None:
        self._tasks.append(task)
        self._wake.notify_all()

    def _state(self) -> str:
        if self._is_building():
            return "building"
        if self._run is None:
            return "waiting for a pattern"
        if self._is_over():
            return self._run.simulation.phase
        return "paused" if self._is_held(self._mode) else self._mode.value

    def _claim(self, suffixes: tuple[str, ...], claim: Callable[[Path], object]) -> Path:
        run = self._run
        name = "cloth_sim" if run is None else run.scene.garment.name
        return claim_path(self._settings.record_directory, name, suffixes, claim)

    def _move_body(self, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> bool:
        """Lets the present body move to these vertices; false if it is another body, or nothing has moved yet."""
        duration, speed = self._settings.body_move_duration, self._settings.body_speed
        with self._wake:
            run = self._run
            begun = run is not None and run.simulation.time > 0.0 and run.simulation.phase != "failed"
        if run is None or duration <= 0.0 or not begun:
            return False
        moved = self._builder.body_has_moved(lambda body: body.moved(vertices, triangles))
        if moved is None:
            return False

        def move() -> None:
            run.simulation.move_body(moved.body.vertices, duration, speed)
            if self._sender is not None:
                self._sender.moved_body(run, moved.message)

        with self._wake:
            self._refusal = ""
            self._add_task(lambda current: self._act_on(run, current, move))
        return True

    # -- called by the builder, in its thread --------------------------------------------------------------------------

    def _on_accepted(self, inputs: SceneInputs, run: Run | None) -> None:
        self._refusal = ""
        if run is None:
            RunSender(inputs, self._outlet).body()
            return
        with self._wake:
            self._next_run = run
            self._resetting = False
            self._wake.notify_all()

    def _on_refused(self, line: str) -> None:
        with self._wake:
            self._resetting = False
            if self._run is None or self._is_over():
                self._mode = _Mode.PAUSED
            self._wake.notify_all()
        self.refuse(line)

    # -- simulation thread ---------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._next_run or self._has_work())
                if self._closing:
                    break
                new = self._next_run
                run = new or self._run
            assert run is not None
            try:
                if new is not None:
                    self._begin(new)
                self._move(run, self._take_over(run))
            except Exception as error:  # the last good state stays, and the node goes on
                self._fail(run, error)
        if self._run is not None:
            self._do_tasks(self._run)

    def _take_over(self, run: Run) -> _Mode:
        """Makes a run the present one, and says what it is to do."""
        with self._wake:
            if run is self._next_run:
                self._run, self._next_run = run, None
                if self._settings.auto_start and self._mode is _Mode.PAUSED:
                    self._mode = _Mode.MOTION
            return _Mode.PAUSED if self._resetting or self._is_held(self._mode) else self._mode

    def _has_work(self) -> bool:
        if self._run is None:
            return False
        still = self._mode is _Mode.PAUSED or self._is_held(self._mode)
        return bool(self._tasks) or not (still or self._resetting or self._is_over())

    def _begin(self, run: Run) -> None:
        self._failure = ""
        self._sender = RunSender(run.inputs, self._outlet)
        self._sender.begin(run)
        self._next_strain = 0.0
        self._send_time_of(run)
        self._take_snapshot(run)
        for warning in run.scene.warnings:
            self._listener.inform(warning)
        particles = run.description["particles"]
        self._listener.inform(f"garment '{run.scene.garment.name}' is ready: {particles} particles")

    def _move(self, run: Run, mode: _Mode) -> None:
        """Does what the mode asks for until something else is to be done, and the tasks that have come up."""
        simulation = run.simulation
        report = None
        self._pace.restart()
        interrupted = self._between_ticks(run, mode)
        if interrupted or mode is _Mode.PAUSED:
            pass
        elif mode is _Mode.STEP:
            simulation.advance(self._steps * self._settings.step, lambda _: self._between_ticks(run, mode))
            self._pause_after(mode)
        elif mode is _Mode.DRAPE:
            report = simulation.settle(lambda _: self._between_ticks(run, mode))
            interrupted = not simulation.settled and self._between_ticks(run, mode)
        else:
            while not (interrupted or simulation.settled):
                simulation.tick()
                interrupted = self._between_ticks(run, mode)
            report = simulation.report() if simulation.settled else None
        self._take_snapshot(run)
        self._send_last_frame(run)
        self._send_time_of(run)
        if report is not None and not interrupted:
            self._pause_after(mode, rested=simulation.settled)
            self._send_report(run, report)
            self._listener.inform(f"the run ended after {simulation.time:.3g} s: {report.rest_reason}")

    def _pause_after(self, mode: _Mode, rested: bool = False) -> None:
        """Pauses, unless another command has come in meanwhile."""
        with self._wake:
            if self._mode is mode:
                self._mode = _Mode.PAUSED
                self._rested = rested

    def _between_ticks(self, run: Run, mode: _Mode) -> bool:
        """Sends and measures what is due and does the tasks; true if the present motion is to end."""
        now = time.monotonic()
        if now >= self._next_frame and self._outlet.wants_frames():
            self._next_frame = now + 1.0 / self._settings.publish_rate
            self._send_last_frame(run)
        if now >= self._next_clock:
            self._next_clock = now + CLOCK_INTERVAL
            self._send_time_of(run)
        self._take_snapshot(run)
        self._do_tasks(run)
        with self._wake:
            if not self._has_news(mode):
                delay = self._pace.delay(run.simulation.time, self._settings.real_time_factor)
                self._wake.wait_for(lambda: self._tasks or self._has_news(mode), delay)
            return self._has_news(mode)

    def _has_news(self, mode: _Mode) -> bool:
        """Whether the present motion is to end; _wake is held."""
        changed = self._mode is not mode or self._is_held(mode)
        return self._closing or self._next_run is not None or self._resetting or changed

    def _do_tasks(self, run: Run) -> None:
        with self._wake:
            tasks, self._tasks = self._tasks, deque()
        run.simulation.limit_grasp_speed(self._settings.grasp_speed)
        for task in tasks:
            task(run)
        for name, pose in self._grippers.take_moved().items():
            if run.simulation.phase != "failed":
                run.simulation.move_grasp(name, pose)

    def _act_on(self, run: Run, current: Run, action: Callable[[], object]) -> None:
        """Does something to a run, unless another one has taken its place, and lets it go on if it was at rest."""
        if run is not current:
            return
        try:
            action()
        except ClothError as error:
            self._listener.warn(str(error))
            return
        run.report = None
        with self._wake:
            self._resume()

    def _take_snapshot(self, run: Run) -> None:
        self._progress = run.simulation.progress
        self._positions = run.simulation.positions
        now = time.monotonic()
        if now >= self._next_strain:
            self._next_strain = now + STRAIN_INTERVAL
            positions, _ = run.simulation.sewn_mesh()
            self._largest_strain = float(spring_strains(positions, run.simulation.model.springs).max(initial=0.0))

    def _fail(self, run: Run, error: Exception) -> None:
        line = str(error) if isinstance(error, ClothError) else f"{type(error).__name__}: {error}; please report it"
        self._failure = f"the run failed: {line}"
        self._take_over(run)
        with self._wake:
            self._mode = _Mode.PAUSED
        self._progress = run.simulation.progress
        self._send_last_frame(run)
        self._listener.warn(self._failure)

    def _write_result(self, run: Run, mesh_path: Path, report_path: Path) -> None:
        try:
            report = run.report or run.simulation.report()
            self._send_report(run, report)
            write_file(report_path, report.to_json().encode("utf-8"))
            write_mesh(mesh_path, *run.simulation.sewn_mesh())
            self._listener.inform(f"saved {mesh_path} and {report_path}")
        except ClothError as error:
            self._listener.warn(str(error))

    def _send_frame(self, run: Run) -> None:
        if self._sender is not None:
            self._sender.frame(run)

    def _send_last_frame(self, run: Run) -> None:
        if self._sender is not None and self._sender.is_behind(run):
            self._sender.frame(run)

    def _send_time_of(self, run: Run) -> None:
        if self._sender is not None:
            self._send_clock(self._sender.stamp(run))

    def _send_clock(self, stamp: int) -> None:
        """Sends a time [ns since 1970] on /clock, which two threads do: it never runs back."""
        if not self._settings.publish_clock:
            return
        with self._clock_lock:
            self._clock = max(self._clock, stamp)
            self._listener.send(CLOCK, encode_clock(self._clock))

    def _send_report(self, run: Run, report: Report) -> None:
        if run.simulation.settled:
            run.report = report
        if self._sender is not None:
            self._sender.report(run, report)
