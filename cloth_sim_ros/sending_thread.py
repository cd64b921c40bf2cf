"""A thread that sends messages in their order, so that nobody who has one to send waits for subscribers."""

import threading
from collections import deque
from collections.abc import Callable

from cloth_sim_ros.deferred_message import Message

__all__ = ["SendingThread"]

CAPACITY = 64_000_000
"""Messages that wait may hold as much [bytes]; who comes with the next one waits."""


class SendingThread:
    """Runs from the beginning. Any thread may call.

    Args:
        on_error: gets what was being sent, and what that has raised
        capacity: of messages that wait [bytes]
    """

    def __init__(self, on_error: Callable[[str, Exception], None], capacity: int = CAPACITY) -> None:
        self._on_error = on_error
        self._capacity = capacity
        self._waiting: deque[tuple[str, Callable[[Message], None], Message]] = deque()
        self._bytes = 0
        self._sending = False
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._loop, name="cloth_sim sending", daemon=True)
        self._thread.start()

    def send(self, what: str, publish: Callable[[Message], None], message: Message) -> None:
        """Has `publish(message)` called after all that was given before; waits while too much is waiting.

        Args:
            what: for the line about an error
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closing or not self._bytes or self._has_room(message))
            self._waiting.append((what, publish, message))
            self._bytes += len(message)
            self._changed.notify_all()

    def is_behind(self) -> bool:
        """Whether messages wait for one that is still being sent."""
        return bool(self._waiting) and self._sending

    def close(self, timeout: float) -> None:
        """Sends what waits and ends, no later than after this time [s]."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(timeout)

    def _has_room(self, message: Message) -> bool:
        return self._bytes + len(message) <= self._capacity

    def _loop(self) -> None:
        while True:
            with self._changed:
                self._sending = False
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                what, publish, message = self._waiting.popleft()
                self._sending = True
            try:
                publish(message)
            except Exception as error:  # as other threads, it outlives what it cannot send
                self._on_error(what, error)
            with self._changed:
                self._bytes -= len(message)
                self._changed.notify_all()
