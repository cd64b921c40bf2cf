"""Writes MCAP logs with the `ros2` profile, which `ros2 bag`, Foxglove and other readers open as they are."""

import errno
import fcntl
import os
import threading
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, IndexType, Writer

from cloth_core.errors import ClothError
from cloth_sim_ros.deferred_message import Message
from cloth_sim_ros.log_compression import FastWriter
from cloth_sim_ros.log_repair import end_log
from cloth_sim_ros.messages import message_definition
from cloth_sim_ros.topics import DEFAULT_NODE_NAME, Topic

__all__ = ["LogError", "LogExistsError", "LogWriter", "is_being_written"]

CHUNK_SIZE = 1024 * 1024
"""Bytes of messages that are compressed together."""
FLUSH_INTERVAL = 0.5
"""Wall-clock time after which a chunk is written, however small it is [s]: what a killed process loses at most."""


class LogError(ClothError):
    """A log cannot be written or read."""


class LogExistsError(LogError):
    """A file of that name is there already."""


def is_being_written(path: str | os.PathLike[str]) -> bool:
    """Whether a `LogWriter` of this machine, in whichever process, has the file open."""
    try:
        with open(path, "rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # there is none, or its file system knows no locks
        return False
    return False


class LogWriter:
    """A new MCAP log: zstd chunks with checksums, message indexes, statistics, and the QoS of every topic.

    If writing fails, the file is cut behind its last whole chunk and still ends as a log that readers open. If the
    process is killed, `log_repair` saves all but the last half second. Any thread may call.

    Args:
        path: file to be created
        node_name: fully qualified name of the node below which the topics lie

    Raises:
        LogExistsError: the file exists already, whoever made it and however shortly before.
        LogError: it cannot be created.
    """

    def __init__(self, path: str | os.PathLike[str], node_name: str = DEFAULT_NODE_NAME) -> None:
        self.path = Path(path)
        self._lock = threading.RLock()
        self._failure: LogError | None = None
        self._node_name = node_name
        self._channels: dict[Topic, int] = {}
        self._schemas: dict[str, int] = {}
        try:
            self._stream = _UnbufferedFile(self.path)
        except FileExistsError:
            raise LogExistsError(f"log {self.path}: the file exists; choose another name or remove it") from None
        except OSError as error:
            raise LogError(f"log {self.path}: {error.strerror}; choose a directory that can be written") from None
        self._writer: Writer | None = FastWriter(
            self._stream,  # type: ignore[arg-type]  # it only writes, flushes and asks for the position
            chunk_size=CHUNK_SIZE,
            compression=CompressionType.ZSTD,
            index_types=IndexType.ALL,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        try:
            self._writer.start(profile="ros2", library="cloth_sim_ros")
        except OSError as error:
            raise self._broken(error) from None
        self._ended = threading.Event()
        threading.Thread(target=self._flush_regularly, name="cloth_sim log", daemon=True).start()

    @property
    def closed(self) -> bool:
        """True after `close` and after a failed write."""
        return self._writer is None

    def write(self, topic: Topic, log_time: int, message: Message) -> None:
        """Appends a CDR message at `log_time` [ns since 1970].

        Raises:
            LogError: the log is closed, or bytes could not be written, now or since the last call; the log has been
                closed then.
        """
        with self._lock:
            self._raise_failure()
            if self._writer is None:
                raise LogError(f"log {self.path}: it is closed; start another one")
            data = bytes(message)
            try:
                if topic not in self._channels:
                    self._channels[topic] = self._register(self._writer, topic)
                self._writer.add_message(
                    channel_id=self._channels[topic], log_time=log_time, publish_time=log_time, data=data
                )
            except OSError as error:
                raise self._broken(error) from None

    def _flush_regularly(self) -> None:
        """In a thread of its own, since nobody may write for a long time after a message that is worth keeping."""
        while not self._ended.wait(FLUSH_INTERVAL):
            with self._lock:
                if self._writer is None:
                    return
                try:
                    self._writer.flush()
                except OSError as error:
                    self._failure = self._broken(error)
                    return

    def _raise_failure(self) -> None:
        """Raises, once, what went wrong in the other thread."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _register(self, writer: Writer, topic: Topic) -> int:
        if topic.message_type not in self._schemas:
            definition = message_definition(topic.message_type).encode("utf-8")
            self._schemas[topic.message_type] = writer.register_schema(topic.message_type, "ros2msg", definition)
        return writer.register_channel(
            topic=topic.resolve(self._node_name),
            message_encoding="cdr",
            schema_id=self._schemas[topic.message_type],
            metadata={"offered_qos_profiles": topic.qos.to_yaml()},
        )

    def close(self) -> None:
        """Writes the summary and closes the file; once closed, does nothing.

        Raises:
            LogError: the last messages could not be written, or the file has been removed meanwhile.
        """
        self._ended.set()
        with self._lock:
            self._raise_failure()
            if self._writer is None:
                return
            try:
                self._writer.finish()
                self._stream.close()
            except OSError as error:
                raise self._broken(error) from None
            finally:
                self._writer = None

    def _broken(self, error: OSError) -> LogError:
        """Closes the log behind its last whole chunk and says why."""
        self._writer = None
        reason = error.strerror or str(error)
        try:
            kept = 0 if self._stream.removed else end_log(self._stream.file)
        except OSError:
            kept = 0
        self._stream.file.close()
        return LogError(
            f"log {self.path}: {reason}, {kept} messages before it are kept; make room and start another one"
        )

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class _UnbufferedFile:
    """Each write is complete on return or raises, so that a failure belongs to the write that caused it."""

    def __init__(self, path: Path) -> None:
        self.file = open(path, "xb+", buffering=0)
        try:
            fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            pass  # a file system without locks; creation was exclusive all the same

    def write(self, data: bytes) -> None:
        missing = memoryview(data)
        while missing:
            missing = missing[self.file.write(missing) :]
        if self.removed:
            raise FileNotFoundError(errno.ENOENT, "the file was removed while it was written")

    @property
    def removed(self) -> bool:
        """True if no directory holds the file any more, so that what is written will be lost."""
        return os.fstat(self.file.fileno()).st_nlink == 0

    def tell(self) -> int:
        return self.file.tell()

    def flush(self) -> None:
        """Nothing is kept back."""

    def close(self) -> None:
        self.file.close()
