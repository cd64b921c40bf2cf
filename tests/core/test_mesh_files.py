"""Meshes that are written are read by plain parsers of the formats, written here after their specifications."""

import json
import socket
import struct

import numpy as np
import pytest

from cloth_core.errors import BodyError, ClothError
from cloth_core.mesh_files import READABLE, WRITABLE, read_mesh, write_mesh

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def grid(count=7):
    """A bumpy sheet; every vertex is used, in no special order."""
    rng = np.random.default_rng(5)
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 0.6, count), np.linspace(0, 0.9, count)))
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    triangles = np.concatenate(
        [
            np.column_stack([corner, corner + 1, corner + count]),
            np.column_stack([corner + 1, corner + count + 1, corner + count]),
        ]
    )
    order = rng.permutation(count * count)
    vertices = np.column_stack([u, rng.normal(0, 0.02, u.size), v + 0.7])[order]
    return vertices, np.argsort(order)[rng.permutation(triangles)], np.column_stack([u, v])[order]


def signed_volume(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("kx,kx->", a, np.cross(b, c)) / 6)


def parse_ply(content):
    header, body = content.split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    names = [line.split()[-1] for line in lines if line.startswith("property float")]
    vertices = np.frombuffer(body, dtype="<f4", count=counts["vertex"] * len(names)).reshape(-1, len(names))
    assert "property list uchar int vertex_indices" in lines
    faces = np.frombuffer(body[vertices.nbytes :], dtype=[("count", "u1"), ("corners", "<i4", 3)])
    assert len(faces) == counts["face"]
    assert (faces["count"] == 3).all()
    return names, vertices, faces["corners"]


def parse_obj(content):
    rows = {"v": [], "vt": [], "f": []}
    for line in content.decode().splitlines():
        kind, *values = line.split() or [""]
        assert kind in {"", "#", "v", "vt", "f"}
        if kind in rows:
            rows[kind].append(values)
    corners = [[[int(part) for part in corner.split("/") if part] for corner in face] for face in rows["f"]]
    return np.array(rows["v"], dtype=float), np.array(rows["vt"], dtype=float), np.array(corners) - 1


def parse_glb(content):
    """Attributes and indices of the only primitive, after the glTF 2.0 specification, sections 3.6 and 4.4."""
    magic, version, length, json_length, json_kind = struct.unpack_from("<4sIII4s", content)
    assert (magic, version, length, json_kind) == (b"glTF", 2, len(content), b"JSON")
    document = json.loads(content[20 : 20 + json_length])
    binary_length, binary_kind = struct.unpack_from("<I4s", content, 20 + json_length)
    assert binary_kind == b"BIN\0"
    binary = content[28 + json_length :][:binary_length]

    def accessor(index):
        entry = document["accessors"][index]
        view = document["bufferViews"][entry["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[entry["type"]]
        kind = {5123: "<u2", 5125: "<u4", 5126: "<f4"}[entry["componentType"]]
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        assert "byteStride" not in view
        return np.frombuffer(binary, kind, entry["count"] * width, start).reshape(-1, width)

    assert [set(node) & {"matrix", "rotation", "scale", "translation"} for node in document["nodes"]] == [set()] * len(
        document["nodes"]
    )
    (mesh,) = document["meshes"]
    (primitive,) = mesh["primitives"]
    attributes = {name: accessor(index) for name, index in primitive["attributes"].items()}
    return document, attributes, accessor(primitive["indices"]).reshape(-1, 3)


def test_ply_holds_the_mesh_z_up_in_order(tmp_path):
    vertices, triangles, rest = grid()
    write_mesh(tmp_path / "sheet.ply", vertices, triangles, rest=rest)
    names, values, corners = parse_ply((tmp_path / "sheet.ply").read_bytes())
    assert names == ["x", "y", "z", "s", "t"]
    np.testing.assert_array_equal(values, np.column_stack([vertices, rest]).astype(np.float32))
    np.testing.assert_array_equal(corners, triangles)


def test_ply_without_rest_shape_has_positions_only(tmp_path):
    vertices, triangles, _ = grid()
    write_mesh(tmp_path / "sheet.ply", vertices, triangles)
    names, values, _ = parse_ply((tmp_path / "sheet.ply").read_bytes())
    assert names == ["x", "y", "z"]
    np.testing.assert_array_equal(values, vertices.astype(np.float32))


def test_obj_holds_the_mesh_z_up_in_order(tmp_path):
    vertices, triangles, rest = grid()
    write_mesh(tmp_path / "sheet.obj", vertices, triangles, rest=rest)
    positions, texture, corners = parse_obj((tmp_path / "sheet.obj").read_bytes())
    np.testing.assert_allclose(positions, vertices, rtol=0, atol=1e-7)
    np.testing.assert_allclose(texture, rest, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(corners, np.stack([triangles, triangles], axis=-1))


def test_glb_is_y_up_in_order_and_two_sided(tmp_path):
    vertices, triangles, rest = grid()
    write_mesh(tmp_path / "sheet.glb", vertices, triangles, rest=rest)
    document, attributes, corners = parse_glb((tmp_path / "sheet.glb").read_bytes())
    x, y, z = vertices.T.astype(np.float32)
    np.testing.assert_array_equal(attributes["POSITION"], np.column_stack([x, z, -y]))
    np.testing.assert_allclose(attributes["TEXCOORD_0"], np.column_stack([rest[:, 0], 1 - rest[:, 1]]), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(attributes["NORMAL"], axis=1), 1, atol=1e-5)
    np.testing.assert_array_equal(corners, triangles)
    assert [material["doubleSided"] for material in document["materials"]] == [True]


def test_glb_keeps_outsides_outside(tmp_path):
    write_mesh(tmp_path / "solid.glb", TETRAHEDRON, OUTWARD)
    _, attributes, corners = parse_glb((tmp_path / "solid.glb").read_bytes())
    assert signed_volume(attributes["POSITION"].astype(float), corners) == pytest.approx(1.0)
    away_from_centre = attributes["POSITION"] - attributes["POSITION"].mean(axis=0)
    assert (np.einsum("kx,kx->k", away_from_centre, attributes["NORMAL"]) > 0).all()


@pytest.mark.parametrize("suffix", WRITABLE)
@pytest.mark.parametrize("with_rest", [False, True])
def test_what_was_written_is_read_back(tmp_path, suffix, with_rest):
    vertices, triangles, rest = grid()
    write_mesh(tmp_path / f"sheet{suffix}", vertices, triangles, rest=rest if with_rest else None)
    points, faces = read_mesh(tmp_path / f"sheet{suffix}")
    assert (points.dtype, faces.dtype) == (np.float64, np.int32)
    np.testing.assert_allclose(points, vertices, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(faces, triangles)


def test_seam_sides_stay_apart_in_a_ply(tmp_path):
    vertices = np.concatenate([TETRAHEDRON[:3], TETRAHEDRON[:3]])
    write_mesh(tmp_path / "seam.ply", vertices, [[0, 1, 2], [5, 4, 3]])
    points, faces = read_mesh(tmp_path / "seam.ply")
    np.testing.assert_array_equal(points, vertices)
    np.testing.assert_array_equal(faces, [[0, 1, 2], [5, 4, 3]])


def test_binary_stl_comes_back_as_a_closed_surface(tmp_path):
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *TETRAHEDRON[face].ravel(), 0) for face in OUTWARD)
    (tmp_path / "body.stl").write_bytes(b"solid or not".ljust(80) + struct.pack("<I", len(OUTWARD)) + records)
    points, faces = read_mesh(tmp_path / "body.stl")
    assert len(points) == 4
    assert signed_volume(points, faces) == pytest.approx(1.0)
    np.testing.assert_array_equal(points[faces], TETRAHEDRON[OUTWARD])


def test_ascii_stl_comes_back_as_a_closed_surface(tmp_path):
    corners = ["".join(f"vertex {x} {y} {z}\n" for x, y, z in TETRAHEDRON[face]) for face in OUTWARD]
    facets = "".join(f"facet normal 0 0 0\nouter loop\n{text}endloop\nendfacet\n" for text in corners)
    (tmp_path / "body.stl").write_text(f"solid body\n{facets}endsolid body\n")
    points, faces = read_mesh(tmp_path / "body.stl")
    assert len(points) == 4
    np.testing.assert_array_equal(points[faces], TETRAHEDRON[OUTWARD])


def test_obj_polygons_are_cut_and_texture_cuts_closed(tmp_path):
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    lines += [f"vt {k / 24} 0.5" for k in range(24)]
    quads = [(1, 4, 3, 2), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8)]
    lines += [" ".join(["f", *(f"{v}/{4 * q + k + 1}" for k, v in enumerate(quad))]) for q, quad in enumerate(quads)]
    (tmp_path / "cube.obj").write_text("mtllib nowhere.mtl\n" + "\n".join(lines) + "\n")
    points, faces = read_mesh(tmp_path / "cube.obj")
    assert (len(points), len(faces)) == (8, 12)
    assert signed_volume(points, faces) == pytest.approx(1.0)


PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = "element face 1\nproperty list uchar int vertex_indices\n"
PLY_POINTS = "end_header\n0 0 0\n1 0 0\n0 1 0\n"
REMOTE_BUFFER = json.dumps(
    {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "http://192.0.2.1/body.bin", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
).encode()
REMOTE_BUFFER += b" " * (-len(REMOTE_BUFFER) % 4)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("body.off", b"OFF\n", ".ply, .obj, .stl, .glb"),
        ("body", b"", ".ply, .obj, .stl, .glb"),
        ("body.ply", b"", "not a readable PLY"),
        ("body.ply", b"\x00\xff" * 40, "not a readable PLY"),
        ("body.ply", (PLY_HEAD + PLY_POINTS).encode(), "no triangles"),
        ("body.ply", (PLY_HEAD + PLY_FACES + PLY_POINTS + "3 0 1 7\n").encode(), "outside 0..2"),
        ("body.ply", (PLY_HEAD + PLY_FACES + "end_header\n0 0 0\n").encode(), "body.ply"),
        ("body.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("body.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "not a readable OBJ"),
        ("body.stl", b"abc", "no triangles"),
        ("body.stl", b"x" * 80 + struct.pack("<I", 1000) + b"\0" * 50, "body.stl"),
        ("body.glb", b"glTF1234", "not a readable GLB"),
        ("body.glb", struct.pack("<4sIII4s", b"glTF", 2, 40, 4, b"JSON") + b"{}  ", "no triangles"),
    ],
)
def test_broken_bodies_are_refused_in_one_line(tmp_path, name, content, reason):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BodyError) as caught:
        read_mesh(tmp_path / name)
    message = str(caught.value)
    assert reason in message
    assert name in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("path", ["missing.ply", "https://192.0.2.1/body.ply"])
def test_only_local_files_are_opened(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BodyError, match="cannot be read"):
        read_mesh(path)


def test_references_to_other_places_are_not_followed(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(socket.socket, "connect", lambda self, address: asked.append(address))
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(REMOTE_BUFFER), len(REMOTE_BUFFER), b"JSON")
    (tmp_path / "body.glb").write_bytes(head + REMOTE_BUFFER)
    with pytest.raises(BodyError, match=r"body\.glb"):
        read_mesh(tmp_path / "body.glb")
    assert asked == []


@pytest.mark.parametrize(
    ("name", "vertices", "triangles", "rest", "reason"),
    [
        ("cloth.fbx", TETRAHEDRON, OUTWARD, None, ".glb, .obj, .ply"),
        ("cloth.stl", TETRAHEDRON, OUTWARD, None, ".glb, .obj, .ply"),
        ("cloth.ply", TETRAHEDRON[:, :2], OUTWARD, None, "shape"),
        ("cloth.ply", TETRAHEDRON, OUTWARD[:0], None, "no triangles"),
        ("cloth.glb", TETRAHEDRON * np.nan, OUTWARD, None, "not finite"),
        ("cloth.obj", TETRAHEDRON, OUTWARD + 1, None, "outside 0..3"),
        ("cloth.obj", TETRAHEDRON, OUTWARD, TETRAHEDRON[:3, :2], "rest has shape"),
        ("nowhere/cloth.ply", TETRAHEDRON, OUTWARD, None, "cannot be written"),
    ],
)
def test_what_cannot_be_written_leaves_nothing_behind(tmp_path, name, vertices, triangles, rest, reason):
    with pytest.raises(ClothError) as caught:
        write_mesh(tmp_path / name, vertices, triangles, rest=rest)
    assert reason in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "cloth.ply"
    write_mesh(path, TETRAHEDRON, OUTWARD)
    before = path.read_bytes()

    def disk_full(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cloth_core.mesh_files.os.replace", disk_full)
    with pytest.raises(ClothError, match="No space left"):
        write_mesh(path, 2 * TETRAHEDRON, OUTWARD)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_formats_that_are_written_can_be_read():
    assert set(WRITABLE) < set(READABLE)
