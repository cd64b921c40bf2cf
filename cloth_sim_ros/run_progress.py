"""Shows on stderr how a run gets on: a bar on a terminal, a plain line every few seconds elsewhere."""

from __future__ import annotations

import signal
import sys
import time
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from cloth_core.simulation import Progress

__all__ = ["Interruption", "ProgressDisplay", "progress_line"]

LINE_INTERVAL = 5.0
"""Between two plain lines [s]."""


def progress_line(progress: Progress) -> str:
    """One line: phase, simulated time, its speed, largest particle speed, expected rest."""
    line = (
        f"{progress.phase}: {progress.simulated_time:.2f} s, {progress.speed:.2f} x real time, "
        f"{progress.largest_speed:.2f} m/s"
    )
    if progress.estimated_rest_time is None:
        return line
    return f"{line}, rest at about {progress.estimated_rest_time:.1f} s"


class ProgressDisplay:
    """What a command is doing, from `step` to `step`; while a run goes on, `show` says how far it is."""

    def __init__(self) -> None:
        self._bar: Bar | None = None
        self._task: Any = None
        self._next_line = 0.0

    def __enter__(self) -> ProgressDisplay:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, SpinnerColumn, TextColumn
            from rich.progress import Progress as Bar
            from rich.table import Column

            self._bar = Bar(
                SpinnerColumn(),
                BarColumn(bar_width=12),
                TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
                console=Console(stderr=True),
                transient=True,
            )
            self._task = self._bar.add_task("", total=None)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self, what: str) -> None:
        """Says what comes next."""
        self._next_line = 0.0
        if self._bar is not None:
            self._bar.update(self._task, description=what, total=None)
        else:
            print(what, file=sys.stderr, flush=True)

    def show(self, progress: Progress) -> None:
        """Where the run stands; cheap enough to be called after every tick."""
        if self._bar is not None:
            self._bar.update(
                self._task,
                description=progress_line(progress),
                completed=progress.simulated_time,
                total=progress.estimated_rest_time,
            )
        else:
            self._line(progress_line(progress))

    def share(self, what: str, done: float, total: float) -> None:
        """How much of something is done; `what` has the places {done} and {total} for both numbers."""
        line = what.format(done=round(done, 1), total=round(total, 1))
        if self._bar is not None:
            self._bar.update(self._task, description=line, completed=done, total=total)
        else:
            self._line(line)

    def _line(self, line: str) -> None:
        now = time.monotonic()
        if now >= self._next_line:
            self._next_line = now + LINE_INTERVAL
            print(line, file=sys.stderr, flush=True)


class Interruption:
    """The first Ctrl-C (or SIGTERM) only asks to stop, so that what there is can be kept; a second one ends."""

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
