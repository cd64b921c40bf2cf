"""Time that passes only while somebody sleeps: what depends on time is tested without depending on the machine."""

__all__ = ["Clock"]


class Clock:
    """Takes the place of the module `time` in the module that is tested."""

    def __init__(self) -> None:
        self._now = 1000.0

    def monotonic(self) -> float:
        """[s]."""
        return self._now

    def sleep(self, duration: float) -> None:
        """Lets time pass [s]."""
        self._now += duration
