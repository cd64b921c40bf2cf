"""The thread that steps the present run, a few milliseconds a tick, and sends what comes of it."""

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from cloth_core.errors import ClothError
from cloth_core.mesh_files import write_file, write_mesh
from cloth_core.report import Report
from cloth_core.springs import spring_strains
from cloth_sim_ros.grippers import Grippers
from cloth_sim_ros.messages import encode_clock
from cloth_sim_ros.outlet import Listener, Outlet
from cloth_sim_ros.pacing import RealTimePace
from cloth_sim_ros.run_sender import RunSender
from cloth_sim_ros.scene_builder import Run
from cloth_sim_ros.topics import CLOCK
from cloth_sim_ros.worker_state import Mode, WorkerState

__all__ = ["SimulationThread"]

STRAIN_INTERVAL = 1.0
"""Wall-clock time between two measurements of the strain while the garment moves [s]."""
CLOCK_INTERVAL = 0.01
"""Wall-clock time between two messages on /clock while the garment moves [s]."""


class SimulationThread:
    """Does what the state asks for, and tasks between two ticks; runs from the beginning.

    Args:
        state: shared with those who command
        outlet, listener: where messages and lines go
        grippers: whose poses held cloth follows

    Attributes:
        sender: of the present run; used in tasks.
    """

    def __init__(self, state: WorkerState, outlet: Outlet, listener: Listener, grippers: Grippers) -> None:
        self._state = state
        self._outlet = outlet
        self._listener = listener
        self._grippers = grippers
        self.sender: RunSender | None = None
        self._next_frame = 0.0
        self._next_strain = 0.0
        self._next_clock = 0.0
        self._clock = 0
        self._clock_lock = threading.Lock()
        self._pace = RealTimePace()
        self._thread = threading.Thread(target=self._loop, name="cloth_sim simulation", daemon=True)
        self._thread.start()

    def join(self, timeout: float) -> None:
        """Waits for its end once the state is closing, no longer than this [s]."""
        self._thread.join(timeout)

    def _loop(self) -> None:
        while True:
            with self._state.wake:
                self._state.wake.wait_for(lambda: self._state.closing or self._state.next_run or self._state.has_work())
                if self._state.closing:
                    break
                new = self._state.next_run
                run = new or self._state.run
            assert run is not None
            try:
                if new is not None:
                    self._begin(new)
                self._move(run, self._take_over(run))
            except Exception as error:  # the last good state stays, and the node goes on
                self._fail(run, error)
        if self._state.run is not None:
            self._do_tasks(self._state.run)

    def _take_over(self, run: Run) -> Mode:
        """Makes a run the present one, and says what it is to do."""
        with self._state.wake:
            if run is self._state.next_run:
                self._state.run, self._state.next_run = run, None
                if self._state.settings.auto_start and self._state.mode is Mode.PAUSED:
                    self._state.mode = Mode.MOTION
            return Mode.PAUSED if self._state.resetting or self._state.is_held(self._state.mode) else self._state.mode

    def _begin(self, run: Run) -> None:
        self._state.failure = ""
        self.sender = RunSender(run.inputs, self._outlet)
        self.sender.begin(run)
        self._next_strain = 0.0
        self._send_time_of(run)
        self._take_snapshot(run)
        for warning in run.scene.warnings:
            self._listener.inform(warning)
        particles = run.description["particles"]
        self._listener.inform(f"garment '{run.scene.garment.name}' is ready: {particles} particles")

    def _move(self, run: Run, mode: Mode) -> None:
        """Does what the mode asks for until something else is to be done, and the tasks that have come up."""
        simulation = run.simulation
        report = None
        self._pace.restart()
        interrupted = self._between_ticks(run, mode)
        if interrupted or mode is Mode.PAUSED:
            pass
        elif mode is Mode.STEP:
            simulation.advance(self._state.steps * self._state.settings.step, lambda _: self._between_ticks(run, mode))
            self._pause_after(mode)
        elif mode is Mode.DRAPE:
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

    def _pause_after(self, mode: Mode, rested: bool = False) -> None:
        """Pauses, unless another command has come in meanwhile."""
        with self._state.wake:
            if self._state.mode is mode:
                self._state.mode = Mode.PAUSED
                self._state.rested = rested

    def _between_ticks(self, run: Run, mode: Mode) -> bool:
        """Sends and measures what is due and does the tasks; true if the present motion is to end."""
        now = time.monotonic()
        if now >= self._next_frame and self._outlet.wants_frames():
            self._next_frame = now + 1.0 / self._state.settings.publish_rate
            self._send_last_frame(run)
        if now >= self._next_clock:
            self._next_clock = now + CLOCK_INTERVAL
            self._send_time_of(run)
        self._take_snapshot(run)
        self._do_tasks(run)
        with self._state.wake:
            if not self._state.has_news(mode):
                delay = self._pace.delay(run.simulation.time, self._state.settings.real_time_factor)
                self._state.wake.wait_for(lambda: self._state.tasks or self._state.has_news(mode), delay)
            return self._state.has_news(mode)

    def _do_tasks(self, run: Run) -> None:
        with self._state.wake:
            tasks, self._state.tasks = self._state.tasks, deque()
        run.simulation.limit_grasp_speed(self._state.settings.grasp_speed)
        for task in tasks:
            task(run)
        for name, pose in self._grippers.take_moved().items():
            if run.simulation.phase != "failed":
                run.simulation.move_grasp(name, pose)

    def act_on(self, run: Run, current: Run, action: Callable[[], object]) -> None:
        """Does something to a run, unless another one has taken its place, and lets it go on if it was at rest."""
        if run is not current:
            return
        try:
            action()
        except ClothError as error:
            self._listener.warn(str(error))
            return
        run.report = None
        with self._state.wake:
            self._state.resume()

    def _take_snapshot(self, run: Run) -> None:
        self._state.progress = run.simulation.progress
        self._state.positions = run.simulation.positions
        now = time.monotonic()
        if now >= self._next_strain:
            self._next_strain = now + STRAIN_INTERVAL
            positions, _ = run.simulation.sewn_mesh()
            self._state.largest_strain = float(spring_strains(positions, run.simulation.model.springs).max(initial=0.0))

    def _fail(self, run: Run, error: Exception) -> None:
        line = str(error) if isinstance(error, ClothError) else f"{type(error).__name__}: {error}; please report it"
        self._state.failure = f"the run failed: {line}"
        self._take_over(run)
        with self._state.wake:
            self._state.mode = Mode.PAUSED
        self._state.progress = run.simulation.progress
        self._send_last_frame(run)
        self._listener.warn(self._state.failure)

    def write_result(self, run: Run, mesh_path: Path, report_path: Path) -> None:
        """Writes mesh and report into files and sends the report."""
        try:
            report = run.report or run.simulation.report()
            self._send_report(run, report)
            write_file(report_path, report.to_json().encode("utf-8"))
            write_mesh(mesh_path, *run.simulation.sewn_mesh())
            self._listener.inform(f"saved {mesh_path} and {report_path}")
        except ClothError as error:
            self._listener.warn(str(error))

    def send_frame(self, run: Run) -> None:
        """Sends the garment as it is."""
        if self.sender is not None:
            self.sender.frame(run)

    def _send_last_frame(self, run: Run) -> None:
        if self.sender is not None and self.sender.is_behind(run):
            self.sender.frame(run)

    def _send_time_of(self, run: Run) -> None:
        if self.sender is not None:
            self.send_clock(self.sender.stamp(run))

    def send_clock(self, stamp: int) -> None:
        """Sends a time [ns since 1970] on /clock, which two threads do: it never runs back."""
        if not self._state.settings.publish_clock:
            return
        with self._clock_lock:
            self._clock = max(self._clock, stamp)
            self._listener.send(CLOCK, encode_clock(self._clock))

    def _send_report(self, run: Run, report: Report) -> None:
        if run.simulation.settled:
            run.report = report
        if self.sender is not None:
            self.sender.report(run, report)
