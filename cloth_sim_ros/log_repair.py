"""Gives an MCAP log that was cut off a proper end again: all whole chunks stay, the summary is rebuilt from them.

Layout of the file: https://mcap.dev/spec. Data section (header, chunks each followed by its message indexes), end of
data, summary, footer.
"""

import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
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

__all__ = ["DAMAGE", "end_log"]

DAMAGE = (McapError, ZstdError, ValueError, KeyError, struct.error, RuntimeError)
"""What the mcap library and its decompressors raise on bytes that are not what they should be."""

_RECORD_HEAD = struct.Struct("<BQ")


@dataclass
class _WholeChunk:
    """A chunk whose bytes, checksum and message indexes are all there."""

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
    start, chunks = _whole_chunks(stream)
    for kept in range(len(chunks), 0, -1):
        try:
            return _write_end(stream, chunks[kept - 1].end, chunks[:kept])
        except OSError:
            continue
    return _write_end(stream, start, [])


def _whole_chunks(stream: BinaryIO) -> tuple[int, list[_WholeChunk]]:
    """Position behind the header, and the chunks in order up to the first that is not whole."""
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
                break
        elif opcode == Opcode.MESSAGE_INDEX and current is not None:
            channel = MessageIndex.read(ReadDataStream(BytesIO(stream.read(length)))).channel_id
            current.index.message_index_offsets[channel] = position
            current.index.message_index_length = end - current.end
            if len(current.index.message_index_offsets) == len(current.message_counts):
                current.end = end
                chunks.append(current)
                current = None
        else:
            break
        position = end
    return start, chunks


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
    whole = _WholeChunk(index, {}, {}, {}, end)
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
    builder = RecordBuilder()
    DataEnd(0).write(builder)
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
