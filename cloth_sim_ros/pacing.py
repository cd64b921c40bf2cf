"""Keeps simulated time from running ahead of the wall clock."""

import time
from collections.abc import Callable

__all__ = ["RealTimePace"]

MOST_ARREARS = 0.1
"""A run that is farther behind than this does not catch up [s]: it goes on at its pace from where it is."""


class RealTimePace:
    """Simulated per wall-clock time, held at or below a factor.

    Args:
        clock: wall-clock time [s]
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._factor = 0.0
        self._began: tuple[float, float] | None = None

    def restart(self) -> None:
        """Forgets what has been run so far; to be called when the garment has stood still."""
        self._began = None

    def delay(self, simulated_time: float, factor: float) -> float:
        """How long to wait at a simulated time [s] before going on [s]; a factor of 0 never waits."""
        if factor <= 0.0:
            self._began = None
            return 0.0
        now = self._clock()
        if self._began is None or factor != self._factor or simulated_time < self._began[1]:
            self._began, self._factor = (now, simulated_time), factor
        due = self._began[0] + (simulated_time - self._began[1]) / factor
        if now - due > MOST_ARREARS:
            self._began = (now, simulated_time)
        return max(due - now, 0.0)
