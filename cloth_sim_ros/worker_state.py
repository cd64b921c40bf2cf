"""What the simulation thread is to do, and what it has come to: shared by all threads of a worker."""

import threading
from collections import deque
from collections.abc import Callable
from enum import Enum

import numpy as np

from cloth_core.simulation import Progress
from cloth_sim_ros.scene_builder import Run
from cloth_sim_ros.worker_settings import WorkerSettings

__all__ = ["Mode", "WorkerState"]


class Mode(Enum):
    """What a run is to do; the value is what users read."""

    PAUSED = "paused"
    MOTION = "running"
    DRAPE = "draping"
    STEP = "stepping"


class WorkerState:
    """What is asked for, guarded by `wake`, which is held where a method is called; and what anybody may read.

    Args:
        settings: act at once
        builder_is_busy: whether a garment is being built or waits to be
    """

    def __init__(self, settings: WorkerSettings, builder_is_busy: Callable[[], bool]) -> None:
        self._builder_is_busy = builder_is_busy
        self.wake = threading.Condition()
        self.closing = False
        self.settings = settings
        self.mode = Mode.PAUSED
        self.run: Run | None = None
        self.next_run: Run | None = None
        self.resetting = False
        self.tasks: deque[Callable[[Run], None]] = deque()
        self.steps = 1
        self.rested = False
        """Whether the run has paused by itself at rest; what acts from outside lets it go on."""

        # Replaced whole by one thread, read by others without a lock.
        self.progress: Progress | None = None
        self.largest_strain: float | None = None
        self.refusal = ""
        self.failure = ""
        self.positions = np.zeros((0, 3))

    def is_building(self) -> bool:
        """Whether a garment is on its way."""
        # In this order: a run is handed over before the builder ceases to be busy.
        return self._builder_is_busy() or self.next_run is not None

    def is_over(self) -> bool:
        """Whether the present run has come to its end."""
        return self.run is not None and self.run.simulation.phase in ("rest", "failed")

    def is_held(self, mode: Mode) -> bool:
        """Whether the parameter `paused` keeps a run from what the mode asks for."""
        return self.settings.paused and mode in (Mode.MOTION, Mode.DRAPE)

    def has_work(self) -> bool:
        """Whether the simulation thread has anything to do."""
        if self.run is None:
            return False
        still = self.mode is Mode.PAUSED or self.is_held(self.mode)
        return bool(self.tasks) or not (still or self.resetting or self.is_over())

    def has_news(self, mode: Mode) -> bool:
        """Whether the present motion is to end."""
        changed = self.mode is not mode or self.is_held(mode)
        return self.closing or self.next_run is not None or self.resetting or changed

    def set_mode(self, mode: Mode, answer: str) -> str:
        """Asks for a mode; returns the answer, with what it waits for."""
        self.mode = mode
        self.rested = False
        self.wake.notify_all()
        if self.is_building():
            return f"{answer}, once the garment is built"
        if self.is_held(mode):
            return f"{answer}, once the parameter paused is false"
        return f"{answer}; {self.refusal}" if self.refusal else answer

    def resume(self) -> None:
        """Lets a run that has paused by itself at rest go on."""
        if self.rested and self.mode is Mode.PAUSED:
            self.mode = Mode.MOTION
        self.rested = False
        self.wake.notify_all()

    def add_task(self, task: Callable[[Run], None]) -> None:
        """Lets the simulation thread do something between two ticks."""
        self.tasks.append(task)
        self.wake.notify_all()

    def name(self) -> str:
        """The state as users read it."""
        if self.is_building():
            return "building"
        if self.run is None:
            return "waiting for a pattern"
        if self.is_over():
            return self.run.simulation.phase
        return "paused" if self.is_held(self.mode) else self.mode.value
