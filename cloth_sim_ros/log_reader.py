"""Reads the log of a run: what went in, every frame of the garment, and the report."""

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from mcap.reader import SeekingReader
from mcap.records import Channel
from mcap.summary import Summary

from cloth_core.errors import ClothError
from cloth_sim_ros.log_repair import DAMAGE
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import NANOSECONDS, Color, decode_marker, decode_mesh, decode_string
from cloth_sim_ros.topics import BODY, GARMENT, PARAMETERS, PATTERN, REPORT, Topic

__all__ = ["LogReader", "LoggedFrame", "LoggedMessage"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
Decoded = TypeVar("Decoded")


@dataclass(frozen=True)
class LoggedFrame:
    """The garment at one moment."""

    time: float
    """[s] since the first message of the log."""
    corners: FloatArray
    """Corners of the triangles [m], shape (m, 3, 3)."""
    color: Color

    def mesh(self) -> tuple[FloatArray, IntArray]:
        """Vertices [m], (n, 3), and triangles (m, 3): corners at exactly the same place are one vertex."""
        # Adding 0 turns -0 into 0, so that equal places are equal bytes.
        rows = np.ascontiguousarray(self.corners.reshape(-1, 3) + 0.0).view("V24").ravel()
        vertices, triangles = np.unique(rows, return_inverse=True)
        return vertices.view(np.float64).reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32)


@dataclass(frozen=True)
class LoggedMessage:
    """A message as it was sent; `data` is CDR, `log_time` [ns since 1970]."""

    topic: str
    message_type: str
    qos: str
    """The YAML of `offered_qos_profiles`; empty if the log does not say."""
    log_time: int
    data: bytes


class LogReader:
    """An open log. Topics are found by their type and last name, so that a node may have had any name and namespace.

    Raises:
        LogError: here and in every method, if the file is missing, is not an MCAP log, was cut off or is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._stream = open(self.path, "rb")
        except OSError as error:
            raise LogError(f"log {self.path}: {error.strerror}; give the path of an MCAP file") from None
        try:
            self._reader = self._open_reader()
            self._summary = self._read_summary()
        except BaseException:
            self._stream.close()
            raise
        statistics = self._summary.statistics
        self.start = statistics.message_start_time if statistics else 0
        """Time of the first message [ns since 1970]."""
        self.duration = (statistics.message_end_time - self.start) / NANOSECONDS if statistics else 0.0
        """[s] from the first message to the last."""

    def _open_reader(self) -> SeekingReader:
        try:
            return SeekingReader(self._stream, validate_crcs=True)
        except DAMAGE:
            raise LogError(f"log {self.path}: it is not an MCAP file; give the path of one") from None

    def _read_summary(self) -> Summary:
        try:
            summary = self._reader.get_summary()
        except (*DAMAGE, OSError):
            summary = None
        if summary is None:
            raise LogError(f"log {self.path}: it was cut off and has no end; run `cloth-sim recover` on it")
        return summary

    def count(self, topic: Topic) -> int:
        """Count of messages on a topic."""
        statistics = self._summary.statistics
        counts = statistics.channel_message_counts if statistics else {}
        return sum(counts.get(channel.id, 0) for channel in self._channels(topic))

    def _channels(self, topic: Topic) -> list[Channel]:
        return [
            channel
            for channel in self._summary.channels.values()
            if channel.topic.rsplit("/", 1)[-1] == topic.name.rsplit("/", 1)[-1]
            and channel.schema_id in self._summary.schemas
            and self._summary.schemas[channel.schema_id].name == topic.message_type
        ]

    def messages(self, topic: Topic | None = None) -> Iterator[LoggedMessage]:
        """All messages, or those of one topic, in the order of their times."""
        names = None if topic is None else [channel.topic for channel in self._channels(topic)]
        if names == []:
            return
        try:
            for schema, channel, message in self._reader.iter_messages(topics=names):
                yield LoggedMessage(
                    topic=channel.topic,
                    message_type=schema.name if schema else "",
                    qos=channel.metadata.get("offered_qos_profiles", ""),
                    log_time=message.log_time,
                    data=message.data,
                )
        except (*DAMAGE, OSError) as error:
            raise LogError(f"log {self.path}: it is damaged ({error}); record the run again") from None

    def frames(self) -> Iterator[LoggedFrame]:
        """The garment, frame by frame.

        A reset or another pattern starts a new run in the log; its frames follow those of the run before.
        """
        for message in self.messages(GARMENT):
            marker = self._decode(decode_marker, message)
            time = (message.log_time - self.start) / NANOSECONDS
            yield LoggedFrame(time, marker.points.reshape(-1, 3, 3), marker.color)

    def patterns(self) -> list[str]:
        """JSON texts of the patterns."""
        return [self._decode(decode_string, message) for message in self.messages(PATTERN)]

    def body(self) -> tuple[FloatArray, IntArray] | None:
        """Vertices [m], (n, 3), and triangles (m, 3) of the last body, or None."""
        last = self._last(BODY)
        return None if last is None else self._decode(decode_mesh, last)

    def parameters(self) -> dict[str, object]:
        """The parameters of the run; empty if the log has none."""
        return self._last_json(PARAMETERS)

    def report(self) -> dict[str, object]:
        """The last report; empty if the run did not come to rest."""
        return self._last_json(REPORT)

    def _last(self, topic: Topic) -> LoggedMessage | None:
        last = None
        for last in self.messages(topic):  # noqa: B007
            pass
        return last

    def _last_json(self, topic: Topic) -> dict[str, object]:
        last = self._last(topic)
        if last is None:
            return {}
        try:
            content = json.loads(self._decode(decode_string, last))
        except ValueError:
            content = None
        if not isinstance(content, dict):
            raise LogError(f"log {self.path}, {last.topic}: the text is not a JSON object; record the run again")
        return content

    def _decode(self, decoder: Callable[[bytes], Decoded], message: LoggedMessage) -> Decoded:
        try:
            return decoder(message.data)
        except ClothError as error:
            raise LogError(f"log {self.path}, {message.topic}: {error}") from None

    def close(self) -> None:
        """Closes the file."""
        self._stream.close()

    def __enter__(self) -> "LogReader":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
