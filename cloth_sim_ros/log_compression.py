"""Compression of logs: zstd with parameters that suit meshes as triangle lists.

In a triangle list each point comes about six times, a few kilobytes apart, and its digits repeat nowhere else. A fast
search (`ZSTD_fast`) with a hash table for that distance, which looks for long matches and strides over what has none,
finds nearly all that level 3 finds in half of the time; the fast levels of zstd itself have too small a table.
"""

from types import FunctionType, SimpleNamespace
from typing import Any

import mcap.writer
import zstandard

__all__ = ["FastWriter", "compress"]

_PARAMETERS = zstandard.ZstdCompressionParameters(
    strategy=zstandard.STRATEGY_FAST,
    window_log=20,  # a chunk
    hash_log=16,
    chain_log=16,
    search_log=1,
    min_match=7,
    target_length=7,  # with this strategy: how fast it strides
)


def compress(data: bytes) -> bytes:
    """A zstd frame with its content size, as any reader of MCAP takes it."""
    return zstandard.ZstdCompressor(compression_params=_PARAMETERS).compress(data)


class FastWriter(mcap.writer.Writer):
    """A `Writer` whose zstd chunks are made by `compress`.

    The library calls `zstandard.compress` by that name where it ends a chunk, and offers no other way; so this class
    has that method with a name of its own, and writers of others in the same process stay as they are.
    """


_END_CHUNK = "_Writer__finalize_chunk"
_end_chunk: Any = getattr(mcap.writer.Writer, _END_CHUNK)
_names = {**vars(mcap.writer), "zstandard": SimpleNamespace(compress=compress)}
setattr(FastWriter, _END_CHUNK, FunctionType(_end_chunk.__code__, _names, _end_chunk.__name__))
