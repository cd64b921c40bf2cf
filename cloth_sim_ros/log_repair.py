"""Gives an MCAP log that was cut off a proper end again: all whole chunks stay, the summary is rebuilt from them.

Layout of the file: https://mcap.dev/spec. Data section (header, chunks each followed by its message indexes), end of
data, summary, footer.
"""

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from cloth_core.errors import ClothError

__all__ = ["DAMAGE", "Recovery", "end_log", "recover_log"]

DAMAGE = (McapError, ZstdError, ValueError, KeyError, struct.error, RuntimeError, MemoryError, OverflowError)
"""What the mcap library and its decompressors raise on bytes that are not what they should be."""

_RECORD_HEAD = struct.Struct("<BQ")
_BLOCK = 1024 * 1024


@dataclass(frozen=True)
class Recovery:
    """What `recover_log` found."""

    messages: int
    chunks: int
    duration: float
    """Between the first message and the last [s]."""
    lost_bytes: int
    """Bytes of the data section that are in no whole chunk."""
    was_whole: bool
    """Whether the file had lost nothing."""


@dataclass
class _WholeChunk:
    """A chunk whose bytes, checksum and message indexes are all there."""

    start: int
    """Position of its first byte."""
    index: ChunkIndex
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    message_counts: dict[int, int]
    end: int
    """Position behind its message indexes [bytes]."""


def end_log(stream: BinaryIO) -> int:
    """Cuts an open log behind its last whole chunk and writes the end that is missing.

    On a full disk the summary may not fit either; then the last chunk makes room for it, and so on.

    Args:
        stream: open for reading and writing, unbuffered or flushed

    Returns:
        count of messages that the log now holds

    Raises:
        OSError: not even an empty log can be written.
    """
    start, found = _whole_chunks(stream)
    chunks: list[_WholeChunk] = []
    for chunk in found:
        if chunk.start != (chunks[-1].end if chunks else start):
            break
        chunks.append(chunk)
    for kept in range(len(chunks), 0, -1):
        try:
            return _write_end(stream, chunks[kept - 1].end, chunks[:kept])
        except OSError:
            continue
    return _write_end(stream, start, [])


def recover_log(broken: str | os.PathLike[str], good: str | os.PathLike[str]) -> Recovery:
    """Copies all whole chunks of a log into a new one that ends as it should; the broken one is only read.

    A chunk that is damaged in the middle of the file is left out; so are later ones whose topics were introduced there.

    Args:
        broken: log of a process that was killed, or of a disk that was full
        good: file to be made, or to be replaced; it appears only once it is whole

    Raises:
        ClothError: the broken file cannot be read, is no MCAP log or holds no whole chunk, or the good one cannot be
            written.
    """
    source, target = Path(broken), Path(good)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with open(source, "rb") as stream:
            if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise ClothError(f"log {source}: it is not an MCAP file; give the path of one")
            start, found = _whole_chunks(stream)
            chunks = _readable_chunks(found)
            if not chunks:
                raise ClothError(f"log {source}: it was cut off before its first whole chunk; nothing can be recovered")
            data_end = _data_end(stream)
            try:
                with open(temporary, "xb+") as copy:
                    _copy(stream, copy, 0, start)
                    moved = [_moved(chunk, _copy(stream, copy, chunk.start, chunk.end)) for chunk in chunks]
                    messages = _write_end(copy, copy.tell(), moved)
                os.replace(temporary, target)
            finally:
                temporary.unlink(missing_ok=True)
            end = stream.seek(0, os.SEEK_END) if data_end is None else data_end
    except OSError as error:
        where = source if error.filename == str(source) else target
        raise ClothError(f"log {where}: {error.strerror}; give the path of a log and of a file to be made") from None
    lost = end - start - sum(chunk.end - chunk.start for chunk in chunks)
    times = [(chunk.index.message_start_time, chunk.index.message_end_time) for chunk in chunks]
    duration = (max(last for _, last in times) - min(first for first, _ in times)) / 1e9
    return Recovery(messages, len(chunks), duration, lost, was_whole=lost == 0 and data_end is not None)


def _readable_chunks(chunks: Sequence[_WholeChunk]) -> list[_WholeChunk]:
    """Those whose messages are of channels that they or chunks before them introduce."""
    known: set[int] = set()
    readable = []
    for chunk in chunks:
        known |= set(chunk.channels)
        if known.issuperset(chunk.message_counts):
            readable.append(chunk)
    return readable


def _moved(chunk: _WholeChunk, start: int) -> _WholeChunk:
    """The chunk as it is when its first byte stands at `start`."""
    by = start - chunk.start
    offsets = {channel: offset + by for channel, offset in chunk.index.message_index_offsets.items()}
    index = replace(chunk.index, chunk_start_offset=start, message_index_offsets=offsets)
    return replace(chunk, start=start, index=index, end=chunk.end + by)


def _copy(source: BinaryIO, target: BinaryIO, start: int, end: int) -> int:
    """Appends bytes of the source from `start` to `end`; the position at which they begin in the target."""
    position = target.tell()
    for block in _blocks(source, start, end):
        target.write(block)
    return position


def _blocks(stream: BinaryIO, start: int, end: int) -> Iterator[bytes]:
    stream.seek(start)
    while start < end:
        block = stream.read(min(_BLOCK, end - start))
        if not block:
            return
        start += len(block)
        yield block


def _data_end(stream: BinaryIO) -> int | None:
    """Position of the record that ends the data, if the file goes on to its very end; else None."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - len(MCAP0_MAGIC), 0))
    if stream.read() != MCAP0_MAGIC:
        return None
    position = len(MCAP0_MAGIC)
    while position + _RECORD_HEAD.size <= size:
        stream.seek(position)
        opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
        if opcode == Opcode.DATA_END:
            return position
        position += _RECORD_HEAD.size + length
    return None


def _whole_chunks(stream: BinaryIO) -> tuple[int, list[_WholeChunk]]:
    """Position behind the header, and the chunks that are whole, in order."""
    size = stream.seek(0, os.SEEK_END)
    start = position = len(MCAP0_MAGIC)
    chunks: list[_WholeChunk] = []
    current: _WholeChunk | None = None
    while position + _RECORD_HEAD.size <= size:
        stream.seek(position)
        opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
        end = position + _RECORD_HEAD.size + length
        if end > size:
            break
        if opcode == Opcode.HEADER:
            start = end
        elif opcode == Opcode.CHUNK:
            try:
                current = _read_chunk(stream.read(length), position, end)
            except DAMAGE:
                current = None
        elif opcode == Opcode.MESSAGE_INDEX:
            if current is not None and _add_index(current, stream.read(length), position, end):
                chunks.append(current)
                current = None
        else:
            break
        position = end
    return start, chunks


def _add_index(chunk: _WholeChunk, content: bytes, position: int, end: int) -> bool:
    """Adds the message index that stands at `position`; true if it was the chunk's last one."""
    try:
        channel = MessageIndex.read(ReadDataStream(BytesIO(content))).channel_id
    except DAMAGE:
        return False
    chunk.index.message_index_offsets[channel] = position
    chunk.index.message_index_length = end - chunk.start - chunk.index.chunk_length
    chunk.end = end
    return chunk.index.message_index_offsets.keys() == chunk.message_counts.keys()


def _read_chunk(content: bytes, start: int, end: int) -> _WholeChunk:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    index = ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
    whole = _WholeChunk(start, index, {}, {}, {}, end)
    for record in breakup_chunk(chunk, validate_crc=True):
        if isinstance(record, Schema):
            whole.schemas[record.id] = record
        elif isinstance(record, Channel):
            whole.channels[record.id] = record
        elif isinstance(record, Message):
            whole.message_counts[record.channel_id] = whole.message_counts.get(record.channel_id, 0) + 1
    return whole


def _write_end(stream: BinaryIO, position: int, chunks: list[_WholeChunk]) -> int:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    message_counts: dict[int, int] = {}
    for chunk in chunks:
        schemas |= chunk.schemas
        channels |= chunk.channels
        for channel, count in chunk.message_counts.items():
            message_counts[channel] = message_counts.get(channel, 0) + count
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=message_counts,
        chunk_count=len(chunks),
        message_count=sum(message_counts.values()),
        message_end_time=max((chunk.index.message_end_time for chunk in chunks), default=0),
        message_start_time=min((chunk.index.message_start_time for chunk in chunks), default=0),
        metadata_count=0,
        schema_count=len(schemas),
    )
    checksum = 0
    for block in _blocks(stream, 0, position):
        checksum = zlib.crc32(block, checksum)
    builder = RecordBuilder()
    DataEnd(checksum).write(builder)
    data_end = builder.end()

    summary_start = position + len(data_end)
    groups: dict[Opcode, Sequence[McapRecord]] = {
        Opcode.SCHEMA: list(schemas.values()),
        Opcode.CHANNEL: list(channels.values()),
        Opcode.STATISTICS: [statistics],
        Opcode.CHUNK_INDEX: [chunk.index for chunk in chunks],
    }
    offsets = []
    for opcode, records in groups.items():
        group_start = builder.count
        for record in records:
            record.write(builder)
        offsets.append(SummaryOffset(opcode, summary_start + group_start, builder.count - group_start))
    summary_offset_start = summary_start + builder.count
    for offset in offsets:
        offset.write(builder)
    summary = builder.end()

    footer_fields = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, summary_offset_start)
    Footer(summary_start, summary_offset_start, zlib.crc32(footer_fields, zlib.crc32(summary))).write(builder)
    stream.truncate(position)
    stream.seek(position)
    missing = memoryview(data_end + summary + builder.end() + MCAP0_MAGIC)
    while missing:
        missing = missing[stream.write(missing) :]
    return statistics.message_count
