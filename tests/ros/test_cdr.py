"""CDR bytes: rclpy reads what is written here, and is read; whatever the bytes say, no more of them is taken."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from hypothesis import given
from hypothesis import strategies as st
from malformed_body_messages import MALFORMED_BODIES
from rclpy.serialization import deserialize_message, serialize_message
from shape_msgs.msg import Mesh, MeshTriangle
from small_scenes import BOX_TRIANGLES, BOX_VERTICES
from std_msgs.msg import String
from visualization_msgs.msg import Marker

from cloth_core.body import Body
from cloth_core.errors import BodyError, ClothError
from cloth_sim_ros.cdr import CdrError
from cloth_sim_ros.messages import (
    Level,
    MarkerEncoder,
    Status,
    decode_marker,
    decode_mesh,
    decode_string,
    encode_diagnostics,
    encode_mesh,
    encode_string,
)

STAMP = 1_700_000_000_123_456_789
COLOR = (0.25, 0.5, 0.75, 1.0)

texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40)


def random_mesh(vertex_count, triangle_count):
    rng = np.random.default_rng(vertex_count + triangle_count)
    return rng.normal(size=(vertex_count, 3)), rng.integers(0, vertex_count, (triangle_count, 3)).astype(np.int32)


def mesh_message(vertices, triangles):
    """The mesh as rclpy builds it, object by object."""
    return Mesh(
        triangles=[MeshTriangle(vertex_indices=np.array(row, dtype=np.uint32)) for row in triangles],
        vertices=[Point(x=float(x), y=float(y), z=float(z)) for x, y, z in vertices],
    )


@given(texts)
def test_string(text):
    assert deserialize_message(encode_string(text), String).data == text
    assert decode_string(serialize_message(String(data=text))) == text


# An odd count of triangles puts the vertices at another place relative to their alignment than an even one.
@pytest.mark.parametrize(("vertex_count", "triangle_count"), [(3, 1), (4, 2), (50, 77), (1, 0)])
def test_mesh(vertex_count, triangle_count):
    vertices, triangles = random_mesh(vertex_count, triangle_count)
    assert deserialize_message(encode_mesh(vertices, triangles), Mesh) == mesh_message(vertices, triangles)
    read_vertices, read_triangles = decode_mesh(serialize_message(mesh_message(vertices, triangles)))
    assert read_vertices.tobytes() == vertices.tobytes()
    assert read_triangles.tobytes() == triangles.tobytes()


def test_mesh_without_anything():
    nothing = np.empty((0, 3))
    assert deserialize_message(encode_mesh(nothing, nothing.astype(np.int32)), Mesh) == Mesh()
    vertices, triangles = decode_mesh(serialize_message(Mesh()))
    assert vertices.shape == triangles.shape == (0, 3)


# Every length of the frame's name shifts what follows, so all alignments occur.
@pytest.mark.parametrize("frame_id", ["", "m", "ma", "map", "odom", "world", "base_link"])
@pytest.mark.parametrize("triangle_count", [0, 1, 8])
def test_marker(frame_id, triangle_count):
    vertices, triangles = random_mesh(9, triangle_count)
    data = MarkerEncoder(frame_id, "garment", 3, COLOR).encode(STAMP, vertices, triangles)

    expected = Marker(ns="garment", id=3, type=Marker.TRIANGLE_LIST, action=Marker.ADD)
    expected.header.frame_id = frame_id
    expected.header.stamp.sec, expected.header.stamp.nanosec = divmod(STAMP, 10**9)
    expected.pose.orientation.w = 1.0
    expected.scale.x = expected.scale.y = expected.scale.z = 1.0
    expected.color.r, expected.color.g, expected.color.b, expected.color.a = COLOR
    expected.points = [Point(x=x, y=y, z=z) for x, y, z in vertices[triangles].reshape(-1, 3).tolist()]
    assert deserialize_message(data, Marker) == expected
    assert len(serialize_message(expected)) == len(data)

    read = decode_marker(serialize_message(expected))
    assert read.points.tobytes() == vertices[triangles].tobytes()
    assert (read.stamp, read.frame_id, read.namespace, read.identifier) == (STAMP, frame_id, "garment", 3)
    assert read.color == COLOR


def test_one_encoder_makes_equal_bytes_of_equal_frames():
    vertices, triangles = random_mesh(9, 5)
    encoder = MarkerEncoder("map", "garment", 0, COLOR)
    first = encoder.encode(STAMP, vertices, triangles)
    assert encoder.encode(STAMP + 1, vertices, triangles) != first
    assert encoder.encode(STAMP, vertices, triangles) == first


@given(texts, texts, st.lists(st.tuples(texts, texts), max_size=3), st.sampled_from(Level))
def test_diagnostics(name, message, values, level):
    expected = DiagnosticStatus(level=bytes([level]), name=name, message=message, hardware_id="cloth")
    expected.values = [KeyValue(key=key, value=value) for key, value in values]
    status = Status(level, name, message, "cloth", tuple(values))
    read = deserialize_message(encode_diagnostics(STAMP, [status, status]), DiagnosticArray)
    assert read.status == [expected, expected]
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == divmod(STAMP, 10**9)


@pytest.mark.parametrize("what", MALFORMED_BODIES)
def test_malformed_body(what):
    data, complaint = MALFORMED_BODIES[what]
    with pytest.raises(BodyError) as caught:
        Body.from_arrays(*decode_mesh(data, max_triangles=1000))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_forged_count_takes_no_memory():
    import tracemalloc

    data = MALFORMED_BODIES["four billion vertices"][0]
    tracemalloc.start()
    try:
        with pytest.raises(BodyError):
            decode_mesh(data)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@given(st.binary(max_size=80))
def test_any_bytes_are_read_or_refused(data):
    for decode in (decode_string, decode_mesh, decode_marker):
        for candidate in (data, b"\x00\x01\x00\x00" + data):
            complaint = ""
            try:
                assert decode(candidate) is not None
            except ClothError as error:
                complaint = str(error)
            assert "\n" not in complaint


@given(st.integers(0, 10_000), st.integers(0, 255))
def test_a_changed_byte_is_read_or_refused(place, value):
    data = bytearray(encode_mesh(BOX_VERTICES, BOX_TRIANGLES))
    data[place % len(data)] = value
    try:
        vertices, triangles = decode_mesh(bytes(data))
    except BodyError:
        return
    assert triangles.size == 0 or triangles.max() < len(vertices)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"\x00\x01\x00\x00\x05\x00\x00\x00abc", "data needs 5 bytes but only 3 are left"),
        (b"\x00\x01\x00\x00\x03\x00\x00\x00abc", "does not end with a zero byte"),
        (b"\x00\x01\x00\x00\x03\x00\x00\x00\xff\xfe\x00", "not UTF-8 at byte 0"),
        (b"\x00\x01\x00\x00\xff\xff\xff\xffabc\x00", "needs 4294967295 bytes"),
    ],
)
def test_malformed_string(data, complaint):
    with pytest.raises(CdrError, match=complaint):
        decode_string(data)


def test_a_marker_of_another_type_is_refused():
    with pytest.raises(CdrError, match="type 2 is not a triangle list"):
        decode_marker(serialize_message(Marker(type=Marker.SPHERE)))
