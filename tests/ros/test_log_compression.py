"""Chunks of logs are compressed for meshes, and remain what every reader of zstd takes."""

import io

import numpy as np
import zstandard
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from cloth_sim_ros.log_compression import compress
from cloth_sim_ros.log_writer import LogWriter
from cloth_sim_ros.run_messages import RunMessages
from cloth_sim_ros.topics import GARMENT


def frames(count):
    """A wavy sheet of 3,200 triangles, with digits as real frames have them."""
    side = 40
    u, v = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1), indexing="ij")
    x = np.stack([u, v, 0.05 * np.sin(9 * u + 5 * v)], axis=-1).reshape(-1, 3)
    x += np.random.default_rng(1).normal(0.0, 1e-4, x.shape)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1)
    a, b, c, d = corner, corner + side + 1, corner + side + 2, corner + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    messages = RunMessages(0, "map")
    return [messages.garment(k / 30.0, x + 1e-3 * k, triangles) for k in range(count)]


def chunks(content):
    return [r for r in StreamReader(io.BytesIO(content), emit_chunks=True).records if isinstance(r, Chunk)]


def test_chunks_of_a_log_are_compressed_for_meshes(tmp_path):
    data = frames(20)
    with LogWriter(tmp_path / "run.mcap") as log:
        for number, frame in enumerate(data):
            log.write(GARMENT, number, frame)
    found = chunks((tmp_path / "run.mcap").read_bytes())
    assert len(found) > 1
    for chunk in found:
        assert chunk.compression == "zstd"
        plain = zstandard.decompress(chunk.data)
        assert len(plain) == chunk.uncompressed_size
        assert chunk.data == compress(plain)  # it is this way of compression that was used


def test_little_is_lost_against_the_usual_level():
    """A point comes six times in a triangle list, so that 1 / 6 of the bytes is what can be reached."""
    data = b"".join(frames(4))
    assert zstandard.decompress(compress(data)) == data
    assert len(compress(data)) < 1.05 * len(zstandard.compress(data, 3))
    assert len(zstandard.compress(data, 3)) < 0.25 * len(data)


def test_writers_of_others_stay_as_they_are():
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start()
    channel = writer.register_channel("/topic", "text", 0)
    writer.add_message(channel, 0, frames(1)[0], 0)
    writer.finish()
    (chunk,) = chunks(stream.getvalue())
    assert chunk.data == zstandard.compress(zstandard.decompress(chunk.data))
