"""The four message types of the simulator, to and from CDR bytes, assembled from arrays.

Layouts are those of std_msgs, shape_msgs, visualization_msgs and diagnostic_msgs of ROS 2 Jazzy. Points of a marker and
vertices of a mesh lie in the message as one run of little-endian float64, so that they are copied once and never become
Python objects.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

from cloth_core.errors import BodyError
from cloth_sim_ros.cdr import CdrError, CdrReader, CdrWriter

__all__ = [
    "Color",
    "Level",
    "MarkerEncoder",
    "Status",
    "TriangleMarker",
    "decode_marker",
    "decode_mesh",
    "decode_string",
    "encode_clock",
    "encode_diagnostics",
    "encode_mesh",
    "encode_string",
    "message_definition",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
Color = tuple[float, float, float, float]

TRIANGLE_LIST = 11
NANOSECONDS = 1_000_000_000
STAMP_OFFSET = 4
"""Where `header.stamp` starts in a stamped message: right behind the encapsulation header."""


class Level(IntEnum):
    """`diagnostic_msgs/DiagnosticStatus.level`."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Status:
    """`diagnostic_msgs/DiagnosticStatus`."""

    level: Level
    name: str
    message: str
    hardware_id: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class TriangleMarker:
    """What the simulator puts into a `visualization_msgs/Marker`."""

    stamp: int
    """[ns] since 1970."""
    frame_id: str
    namespace: str
    identifier: int
    color: Color
    points: FloatArray
    """Corners of the triangles [m], shape (3m, 3)."""


@cache
def message_definition(message_type: str) -> str:
    """The .msg text of a type such as ``std_msgs/msg/String`` with all it depends on, as MCAP and rosbag2 store it."""
    package, _, name = message_type.split("/")
    folder = resources.files("cloth_sim_ros") / "data" / "message_definitions"
    return (folder / f"{package}.{name}.msg").read_text(encoding="utf-8")


def encode_string(text: str) -> bytes:
    """`std_msgs/String`."""
    writer = CdrWriter()
    writer.string(text)
    return writer.to_bytes()


def decode_string(data: bytes, what: str = "string message") -> str:
    """Text of a `std_msgs/String`.

    Raises:
        CdrError: the bytes are not a string message.
    """
    reader = CdrReader(data, what)
    text = reader.string("data")
    reader.end()
    return text


def encode_mesh(vertices: FloatArray, triangles: npt.NDArray[np.integer]) -> bytes:
    """`shape_msgs/Mesh` of vertices [m], (n, 3), and vertex indices (m, 3)."""
    writer = CdrWriter()
    writer.uint32(len(triangles))
    writer.array(np.ascontiguousarray(triangles, dtype=np.uint32))
    writer.uint32(len(vertices))
    writer.array(np.ascontiguousarray(vertices, dtype=np.float64))
    return writer.to_bytes()


def decode_mesh(data: bytes, max_triangles: int | None = None) -> tuple[FloatArray, IntArray]:
    """Vertices [m], (n, 3), and triangles, (m, 3), of a `shape_msgs/Mesh`; no value is changed.

    Raises:
        BodyError: counts that the bytes do not hold, more than `max_triangles` or than the vertices of so many, or an
            index without a vertex. The counts are checked before memory is taken.
    """
    try:
        reader = CdrReader(data, "body message")
        triangle_count = reader.uint32("count of triangles")
        if max_triangles is not None and triangle_count > max_triangles:
            raise BodyError(
                f"body message: {triangle_count} triangles are more than max_triangles = {max_triangles}; "
                "send a coarser mesh or raise the parameter"
            )
        indices = reader.array("<u4", 3 * triangle_count, f"triangles[{triangle_count}]")
        triangles: npt.NDArray[np.uint32] = indices.astype(np.uint32, copy=False).reshape(-1, 3)
        vertex_count = reader.uint32("count of vertices")
        vertices = reader.array("<f8", 3 * vertex_count, f"vertices[{vertex_count}]").reshape(-1, 3)
        reader.end()
    except CdrError as error:
        raise BodyError(str(error)) from None
    if max_triangles is not None and vertex_count > 3 * max_triangles:
        raise BodyError(
            f"body message: {vertex_count} vertices are more than max_triangles = {max_triangles} can have; "
            "leave out the unused ones or raise the parameter"
        )
    outside = (triangles >= vertex_count).any(axis=1)
    if outside.any():
        worst = int(outside.argmax())
        raise BodyError(
            f"body message, triangle {worst}: index {int(triangles[worst].max())} has no vertex; "
            f"send indices from 0 to {vertex_count - 1}, the last vertex"
        )
    return vertices.astype(np.float64), triangles.astype(np.int32)


class MarkerEncoder:
    """Encodes `visualization_msgs/Marker` triangle lists that differ only in stamp and points.

    All other fields are encoded once, so that a frame costs one copy of its points.
    """

    def __init__(self, frame_id: str, namespace: str, identifier: int, color: Color) -> None:
        self._before_count = _marker_fields_before_points(frame_id, namespace, identifier, color)
        self._after_points = _marker_fields_after_points()

    def size(self, triangle_count: int) -> int:
        """Length [bytes] of a message of so many triangles."""
        head = len(self._before_count) + 4
        if triangle_count:
            head += (4 - head) % 8
        return head + 3 * 24 * triangle_count + len(self._after_points)

    def encode(self, stamp: int, vertices: FloatArray, triangles: IntArray) -> bytes:
        """Marker at `stamp` [ns since 1970] of the triangles (m, 3) of the vertices [m], (n, 3)."""
        head = bytearray(self._before_count)
        struct.pack_into("<iI", head, STAMP_OFFSET, *divmod(stamp, NANOSECONDS))
        points = vertices.take(triangles, axis=0).astype("<f8", copy=False)
        head += struct.pack("<I", 3 * len(triangles))
        if len(triangles):
            # Elements of eight bytes start at a multiple of eight behind the four bytes of encapsulation.
            head += bytes((4 - len(head)) % 8)
        return b"".join((head, points.data if points.size else b"", self._after_points))


def _marker_fields_before_points(frame_id: str, namespace: str, identifier: int, color: Color) -> bytes:
    writer = CdrWriter()
    writer.int32(0)
    writer.uint32(0)
    writer.string(frame_id)
    writer.string(namespace)
    writer.int32(identifier)
    writer.int32(TRIANGLE_LIST)
    writer.int32(0)  # action ADD
    writer.array(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))  # pose: position, orientation x y z w
    writer.array(np.ones(3))  # scale
    writer.array(np.array(color, dtype=np.float32))
    writer.int32(0)  # lifetime 0: for ever
    writer.uint32(0)
    writer.uint8(0)  # frame_locked
    encoded = writer.to_bytes()
    return encoded + bytes(-len(encoded) % 4)


def _marker_fields_after_points() -> bytes:
    """They start at a multiple of four whatever the count of points is, and hold nothing larger than that."""
    writer = CdrWriter()
    writer.uint32(0)  # colors
    writer.string("")  # texture_resource
    writer.int32(0)  # texture.header.stamp
    writer.uint32(0)
    writer.string("")  # texture.header.frame_id
    writer.string("")  # texture.format
    writer.uint32(0)  # texture.data
    writer.uint32(0)  # uv_coordinates
    writer.string("")  # text
    writer.string("")  # mesh_resource
    writer.string("")  # mesh_file.filename
    writer.uint32(0)  # mesh_file.data
    writer.uint8(0)  # mesh_use_embedded_materials
    return writer.to_bytes()[4:]


def decode_marker(data: bytes) -> TriangleMarker:
    """The triangles of a `visualization_msgs/Marker`; fields that the simulator leaves empty are not looked at.

    Raises:
        CdrError: the bytes are not a triangle list.
    """
    reader = CdrReader(data, "marker message")
    stamp = reader.int32("stamp.sec") * NANOSECONDS + reader.uint32("stamp.nanosec")
    frame_id = reader.string("frame_id")
    namespace = reader.string("ns")
    identifier = reader.int32("id")
    kind = reader.int32("type")
    if kind != TRIANGLE_LIST:
        raise CdrError(f"marker message: type {kind} is not a triangle list; send type {TRIANGLE_LIST}")
    reader.int32("action")
    reader.array("<f8", 10, "pose and scale")
    red, green, blue, alpha = (float(value) for value in reader.array("<f4", 4, "color"))
    reader.array("<i4", 2, "lifetime")
    reader.uint8("frame_locked")
    count = reader.uint32("count of points")
    if count % 3:
        raise CdrError(f"marker message: {count} points do not make triangles; send three for each")
    points = reader.array("<f8", 3 * count, f"points[{count}]").astype(np.float64).reshape(-1, 3)
    return TriangleMarker(stamp, frame_id, namespace, identifier, (red, green, blue, alpha), points)


def encode_clock(stamp: int) -> bytes:
    """`rosgraph_msgs/Clock` at `stamp` [ns since 1970]."""
    writer = CdrWriter()
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    writer.int32(seconds)
    writer.uint32(nanoseconds)
    return writer.to_bytes()


def encode_diagnostics(stamp: int, statuses: Sequence[Status]) -> bytes:
    """`diagnostic_msgs/DiagnosticArray` at `stamp` [ns since 1970]."""
    writer = CdrWriter()
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    writer.int32(seconds)
    writer.uint32(nanoseconds)
    writer.string("")
    writer.uint32(len(statuses))
    for status in statuses:
        writer.uint8(status.level)
        writer.string(status.name)
        writer.string(status.message)
        writer.string(status.hardware_id)
        writer.uint32(len(status.values))
        for key, value in status.values:
            writer.string(key)
            writer.string(value)
    return writer.to_bytes()
