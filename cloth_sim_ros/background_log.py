"""A log that is written by a thread of its own, so that compression and disk do not hold up a simulation."""

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Queue

from cloth_sim_ros.deferred_message import Message
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.topics import Topic

__all__ = ["BackgroundLog"]

MOST_WAITING = 16
"""Messages that wait to be written; whoever sends another one waits too, so that memory stays bounded."""


class BackgroundLog:
    """Hands messages to a `LogWriter` in the order in which they came.

    Args:
        log: that is written; this closes it
        failed: called once, in the log's thread, if a message cannot be written; those after it are dropped
    """

    def __init__(self, log: LogWriter, failed: Callable[["BackgroundLog", LogError], None]) -> None:
        self.path: Path = log.path
        self._log = log
        self._failed = failed
        self._waiting: Queue[tuple[Topic, int, Message] | None] = Queue(MOST_WAITING)
        self._error: LogError | None = None
        self._thread = threading.Thread(target=self._loop, name="cloth_sim recording", daemon=True)
        self._thread.start()

    def write(self, topic: Topic, log_time: int, message: Message) -> None:
        """Takes a CDR message at `log_time` [ns since 1970]."""
        self._waiting.put((topic, log_time, message))

    def close(self) -> None:
        """Ends the log; it is complete on return.

        Raises:
            LogError: its end, or a message before it, could not be written.
        """
        self._waiting.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error
        self._log.close()

    def _loop(self) -> None:
        while (message := self._waiting.get()) is not None:
            if self._error is not None:
                continue
            try:
                self._log.write(*message)
            except Exception as error:  # a thread that ended here would leave all who send waiting
                if not isinstance(error, LogError):
                    with suppress(LogError):
                        self._log.close()
                    error = LogError(f"log {self.path}: {type(error).__name__}: {error}; please report it")
                self._error = error
                self._failed(self, error)
