"""Where all messages of a node leave: to its listener, and to a log while one is being recorded."""

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from cloth_sim_ros.background_log import BackgroundLog
from cloth_sim_ros.deferred_message import Message
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.topics import GARMENT, Topic

__all__ = ["Listener", "Outlet"]


class Listener(Protocol):
    """Who hears from a worker, from any of its threads. Must not block for long and must not raise."""

    def wants_frames(self) -> bool:
        """Whether a frame sent now would reach anybody."""

    def send(self, topic: Topic, message: Message) -> None:
        """A CDR message for a topic."""

    def inform(self, line: str) -> None:
        """Something went as asked."""

    def warn(self, line: str) -> None:
        """Something was refused or failed; one line."""


class Outlet:
    """Sends messages and keeps the last one of each latched topic, with which a new log starts. Any thread may call."""

    def __init__(self, listener: Listener, node_name: str) -> None:
        self._listener = listener
        self._node_name = node_name
        self._lock = threading.Lock()
        self._log: BackgroundLog | None = None
        self._log_failure = ""
        self._latched: dict[Topic, Message | Callable[[], bytes]] = {}
        self._last_stamp = 0

    @property
    def log_path(self) -> Path | None:
        """File that is being recorded, or None."""
        log = self._log
        return None if log is None else log.path

    @property
    def log_failure(self) -> str:
        """Why the last log ended by itself, in one line; empty if it did not, or once another one has been started."""
        return self._log_failure

    @property
    def last_stamp(self) -> int:
        """Time of the last message [ns since 1970]; now, if there is none."""
        return self._last_stamp or time.time_ns()

    def next_start(self) -> int:
        """Stamp [ns since 1970] at which another run can start: now, but after all that has been sent."""
        return max(time.time_ns(), self._last_stamp + 1)

    def wants_frames(self) -> bool:
        """Whether a frame sent now would be recorded or reach anybody."""
        return self._log is not None or self._listener.wants_frames()

    def send(
        self, topic: Topic, message: Message, stamp: int | None = None, latched: Callable[[], bytes] | None = None
    ) -> None:
        """Sends at a time of the run [ns since 1970], by default that of the message before.

        A log that cannot be written ends with one warning; sending goes on. A log that starts later begins with what
        `latched` gives by then instead of `message`, if it is given.
        """
        with self._lock:
            self._last_stamp = stamp or self._last_stamp or time.time_ns()
            if topic.qos.latched:
                self._latched[topic] = message if latched is None else latched
            log = self._log
            if log is not None:
                log.write(topic, self._last_stamp, message)
        self._listener.send(topic, message)

    def forget(self, topic: Topic) -> None:
        """A log that starts from now on does not start with this topic's last message."""
        with self._lock:
            self._latched.pop(topic, None)

    def start_log(self, path: str | os.PathLike[str]) -> None:
        """Records from now on, latched messages first, but for the garment, of which the next frame follows.

        Raises:
            LogError: a log is being recorded already, or the file cannot be created.
        """
        with self._lock:
            if self._log is not None:
                raise LogError(f"record: {self._log.path} is being recorded; stop that first")
            log = BackgroundLog(LogWriter(path, self._node_name), self._on_log_failed)
            for topic, last in self._latched.items():
                if topic != GARMENT:
                    log.write(topic, self._last_stamp, last() if callable(last) else last)
            self._log, self._log_failure = log, ""

    def stop_log(self) -> Path:
        """Ends the log; it is complete on return.

        Raises:
            LogError: nothing is being recorded, or the end cannot be written.
        """
        with self._lock:
            log, self._log = self._log, None
        if log is None:
            raise LogError(f"record: nothing is being recorded; {self._log_failure or 'start a recording first'}")
        log.close()
        return log.path

    def _on_log_failed(self, log: BackgroundLog, error: LogError) -> None:
        """Called by the log's thread; no lock is held, since whoever has it may be waiting for that thread."""
        if self._log is log:
            self._log = None
            self._log_failure = f"recording stopped: {error}"
            self._listener.warn(self._log_failure)
