"""Finds out whether each byte of an MCAP log is as it was written, and if not, where the first damage is.

Each part of the file is covered by a checksum: the messages of a chunk, all records before the end of the data, and the
summary with the footer. Layout: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass, field
from datetime import datetime, timezone
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Message
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from cloth_sim_ros.log_repair import DAMAGE
from cloth_sim_ros.log_writer import LogError
from cloth_sim_ros.messages import NANOSECONDS

__all__ = ["check_log"]

_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER_LENGTH = 20
_TAIL_LENGTH = _RECORD_HEAD.size + _FOOTER_LENGTH + len(MCAP0_MAGIC)
_BLOCK = 1024 * 1024
_FARTHEST = 2**40


@dataclass
class _Walk:
    """What has been seen on the way through the file."""

    topics: dict[int, str] = field(default_factory=dict)
    chunks: int = 0
    last_time: int | None = None
    """Of the messages so far [ns since 1970]."""


def check_log(path: str | os.PathLike[str]) -> int:
    """Reads a log from its first byte to its last.

    Returns:
        count of chunks

    Raises:
        LogError: it cannot be read, was cut off, or a byte is not as it was written; the line says where: position in
            the file, chunk, topics and time, as far as they can still be read.
    """
    source = Path(path)
    try:
        with open(source, "rb") as stream:
            return _check(source, stream)
    except OSError as error:
        raise LogError(f"log {source}: {error.strerror}; give the path of an MCAP file") from None


def _check(path: Path, stream: BinaryIO) -> int:
    size = stream.seek(0, os.SEEK_END)
    if _read(stream, 0, len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise LogError(f"log {path}: byte 0: it does not begin as an MCAP file; give the path of one")
    if size < _TAIL_LENGTH or _read(stream, size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise LogError(
            f"log {path}: byte {max(size - len(MCAP0_MAGIC), 0)}: it has no end; run `cloth-sim recover` on it"
        )
    walk = _Walk()
    position = len(MCAP0_MAGIC)
    while True:
        opcode, end = _record(path, stream, position, size, walk)
        if opcode == Opcode.CHUNK:
            _check_chunk(path, stream, position, end, walk)
        if opcode == Opcode.DATA_END:
            break
        position = end
    _check_data(path, stream, position, end)
    _check_summary(path, stream, end, size)
    return walk.chunks


def _record(path: Path, stream: BinaryIO, position: int, size: int, walk: _Walk) -> tuple[int, int]:
    """Opcode and end of the record at a position of the data section."""
    allowed = (Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.DATA_END)
    if position + _RECORD_HEAD.size <= size:
        opcode, length = _RECORD_HEAD.unpack(_read(stream, position, _RECORD_HEAD.size))
        end = position + _RECORD_HEAD.size + length
        if opcode in allowed and end <= size - _TAIL_LENGTH:
            return opcode, end
    raise LogError(
        f"log {path}: byte {position}: no record begins there, {_after(walk)}; "
        "a byte before was changed; take a copy of the log that is whole"
    )


def _check_chunk(path: Path, stream: BinaryIO, position: int, end: int, walk: _Walk) -> None:
    walk.chunks += 1
    content = _read(stream, position + _RECORD_HEAD.size, end - position - _RECORD_HEAD.size)
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        for record in breakup_chunk(chunk, validate_crc=True):
            if isinstance(record, Channel):
                walk.topics[record.id] = record.topic
            elif isinstance(record, Message):
                walk.last_time = max(record.log_time, walk.last_time or 0)
    except DAMAGE:
        topics = ", ".join(_topics_of_chunk(stream, end, walk)) or "topics unknown"
        raise LogError(
            f"log {path}: bytes {position} to {end}: chunk {walk.chunks} ({topics}), {_after(walk)}, does not match "
            "its checksum; a byte of it was changed; `cloth-sim recover` saves the other chunks"
        ) from None


def _topics_of_chunk(stream: BinaryIO, position: int, walk: _Walk) -> list[str]:
    """From the message indexes that follow a chunk."""
    topics: list[str] = []
    while True:
        head = _read(stream, position, _RECORD_HEAD.size + 2)
        if len(head) < _RECORD_HEAD.size + 2 or head[0] != Opcode.MESSAGE_INDEX:
            return topics
        channel = int.from_bytes(head[-2:], "little")
        topics.append(walk.topics.get(channel, f"channel {channel}"))
        # A length that was changed may lead to where no file can be read.
        position += _RECORD_HEAD.size + min(_RECORD_HEAD.unpack(head[: _RECORD_HEAD.size])[1], _FARTHEST)


def _check_data(path: Path, stream: BinaryIO, data_end: int, end: int) -> None:
    content = _read(stream, data_end + _RECORD_HEAD.size, end - data_end - _RECORD_HEAD.size)
    stated = DataEnd.read(ReadDataStream(BytesIO(content))).data_section_crc if len(content) == 4 else -1
    checksum = 0
    stream.seek(0)
    for start in range(0, data_end, _BLOCK):
        checksum = zlib.crc32(stream.read(min(_BLOCK, data_end - start)), checksum)
    # 0 stands for "none": other programs write logs without it.
    if stated not in (0, checksum):
        raise LogError(
            f"log {path}: bytes 0 to {end}: all chunks are as they were written, but their indexes, the header or the "
            "checksum of all this is not; `cloth-sim recover` makes new ones"
        )


def _check_summary(path: Path, stream: BinaryIO, start: int, size: int) -> None:
    footer_at = size - _TAIL_LENGTH
    head = _read(stream, footer_at, _RECORD_HEAD.size)
    footer = Footer.read(ReadDataStream(BytesIO(_read(stream, footer_at + _RECORD_HEAD.size, _FOOTER_LENGTH))))
    summary = _read(stream, start, footer_at - start)
    fields = struct.pack("<BQQQ", Opcode.FOOTER, _FOOTER_LENGTH, footer.summary_start, footer.summary_offset_start)
    wrong_head = head != _RECORD_HEAD.pack(Opcode.FOOTER, _FOOTER_LENGTH)
    wrong_sum = footer.summary_crc not in (0, zlib.crc32(fields, zlib.crc32(summary)))
    if wrong_head or wrong_sum or footer.summary_start not in (0, start):
        raise LogError(
            f"log {path}: bytes {start} to {size}: all messages are as they were written, but the summary behind them "
            "is not; `cloth-sim recover` makes a new one"
        )


def _after(walk: _Walk) -> str:
    if walk.last_time is None:
        return "before the first message"
    moment = datetime.fromtimestamp(walk.last_time / NANOSECONDS, timezone.utc)
    return f"after the messages until {moment.isoformat(timespec='milliseconds')}"


def _read(stream: BinaryIO, position: int, count: int) -> bytes:
    stream.seek(position)
    return stream.read(count)
