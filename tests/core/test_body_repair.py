"""Bodies as they come: soup, holes, shells, any winding; held against libigl and trimesh."""

import igl
import numpy as np
import pytest
import trimesh
from apparatus import body_of
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.aabb_tree import build_tree
from cloth_core.body import Body
from cloth_core.errors import BodyError


def ball(radius: float = 1.0, at=(0.0, 0.0, 0.0), fineness: int = 2) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(fineness, radius).apply_translation(at)


def soup(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Each triangle with corners of its own, as in an STL file."""
    corners = np.asarray(mesh.vertices)[mesh.faces].reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def some_turned(faces: np.ndarray, share: float, seed: int = 0) -> tuple[np.ndarray, int]:
    turned = np.random.default_rng(seed).random(len(faces)) < share
    return np.where(turned[:, None], faces[:, ::-1], faces), int(turned.sum())


def volume(body: Body) -> float:
    return float(np.linalg.det(body.vertices[body.triangles]).sum() / 6)


def as_trimesh(body: Body) -> trimesh.Trimesh:
    return trimesh.Trimesh(body.vertices, body.triangles, process=False)


def around(body: Body, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    size = np.ptp(body.vertices, axis=0)
    return rng.uniform(body.vertices.min(axis=0) - 0.2 * size, body.vertices.max(axis=0) + 0.2 * size, (count, 3))


# ---- vertices


def test_triangle_soup_is_put_together():
    mesh = ball()
    body = Body.from_arrays(*soup(mesh))
    assert body.repairs == {"duplicate vertices merged": 3 * len(mesh.faces) - len(mesh.vertices)}
    assert body.warnings == ()
    assert as_trimesh(body).is_watertight
    assert volume(body) == pytest.approx(mesh.volume, rel=1e-12)


def test_corners_that_rounding_moved_apart_are_one():
    mesh = ball()
    x, faces = soup(mesh)
    x = np.round(x * 0.85, 6)  # an ASCII file with six digits
    x += np.random.default_rng(1).uniform(-2e-7, 2e-7, x.shape)
    body = Body.from_arrays(x, faces)
    assert len(body.vertices) == len(mesh.vertices)
    assert as_trimesh(body).is_watertight
    # Corners a tenth of a millimetre apart are two: a gap that can be seen is not closed.
    apart = np.vstack([mesh.vertices, mesh.vertices[:1] + 1e-4])
    other = np.array(mesh.faces)
    first = np.flatnonzero((other == 0).any(axis=1))[0]
    other[first] = np.where(other[first] == 0, len(mesh.vertices), other[first])
    assert len(Body.from_arrays(apart, other).vertices) == len(mesh.vertices) + 1


def test_merging_does_not_depend_on_the_place():
    # A box has thousands of vertices with one coordinate in common, and far away coordinates have fewer digits.
    mesh = trimesh.creation.box(extents=[1, 2, 3]).subdivide().subdivide().subdivide()
    for place in ((0, 0, 0), (1e4, -1e4, 1e4)):
        body = Body.from_arrays(*soup(mesh.copy().apply_translation(place)))
        assert len(body.vertices) == len(mesh.vertices)
        assert as_trimesh(body).is_watertight


# ---- winding


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_mixed_winding_is_made_to_agree(share):
    mesh = ball()
    faces, turned = some_turned(np.asarray(mesh.faces), share)
    body = Body.from_arrays(mesh.vertices, faces)
    assert body.repairs == {"triangles turned to agree with their neighbours": turned}
    assert as_trimesh(body).is_winding_consistent
    assert volume(body) == pytest.approx(mesh.volume, rel=1e-12)


def test_each_shell_is_turned_by_itself():
    one, other = ball(0.5), ball(0.3, at=(2, 0, 0))
    other.invert()
    both = trimesh.util.concatenate([one, other])
    body = Body.from_arrays(both.vertices, both.faces)
    assert body.repairs == {"triangles turned outside out": len(other.faces)}
    assert volume(body) == pytest.approx(one.volume - other.volume, rel=1e-12)  # the inverted volume is negative
    assert (body.signed_distance(np.array([[0.0, 0, 0], [2, 0, 0]])) < 0).all()


def test_open_shell_is_turned_by_what_it_would_enclose():
    mesh = ball()
    faces = np.asarray(mesh.faces)[mesh.triangles_center[:, 2] < 0.8]
    body = Body.from_arrays(mesh.vertices, faces[:, ::-1])
    assert body.repairs["triangles turned outside out"] == len(faces)
    assert "one triangle only" in body.warnings[0]
    normals = as_trimesh(body).face_normals
    assert (np.einsum("ij,ij->i", normals, as_trimesh(body).triangles_center) > 0).all()


def test_fragments_go_with_the_body_that_they_were_torn_from():
    # Without a third of its triangles a body has hundreds of fragments, many of them hollow seen from outside.
    woman = Body.load("young")
    kept = woman.triangles[np.random.default_rng(0).random(len(woman.triangles)) > 0.3]
    for wound, turned in ((kept, 0), (kept[:, ::-1], len(kept))):
        body = Body.from_arrays(woman.vertices, wound)
        assert body.repairs.get("triangles turned outside out", 0) == turned
        points = around(body, 2000)
        distance = woman.signed_distance(points)
        clear = np.abs(distance) > 0.02
        assert ((body.signed_distance(points) < 0) != (distance < 0))[clear].sum() == 0


def test_thin_closed_plate_has_an_inside():
    plate = trimesh.creation.box(extents=[1, 1, 1e-4])
    body = Body.from_arrays(plate.vertices, plate.faces[:, ::-1])
    assert body.repairs == {"triangles turned outside out": 12}
    assert body.signed_distance(np.zeros((1, 3)))[0] == pytest.approx(-5e-5)


def test_flat_sheet_keeps_the_winding_of_most_of_it():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(36)])
    quads = np.array([6 * j + i for j in range(5) for i in range(5)])
    faces = np.vstack([np.column_stack([quads, quads + 1, quads + 7]), np.column_stack([quads, quads + 7, quads + 6])])
    for wound, up in ((faces, 1), (faces[:, ::-1], -1)):
        turned = wound.copy()
        turned[[3, 17, 30]] = turned[[3, 17, 30], ::-1]
        body = Body.from_arrays(points, turned)
        assert body.repairs == {"triangles turned to agree with their neighbours": 3}
        np.testing.assert_array_equal(np.sign(as_trimesh(body).face_normals[:, 2]), up)
        assert (body.signed_distance(around(body, 200)) >= 0).all()  # a sheet has no inside


def test_inner_shell_is_reported_and_counts_as_inside():
    outer, inner = ball(1.0), ball(0.4, at=(0.2, 0, 0))
    inner.invert()  # as the wall of a hollow body would be given
    both = trimesh.util.concatenate([outer, inner])
    body = Body.from_arrays(both.vertices, both.faces, "hollow")
    assert len(body.warnings) == 1
    assert body.warnings[0].startswith("body 'hollow': 1 shells lie inside another one, the largest with 320 triangles")
    assert "(0.2, " in body.warnings[0]
    distance = body.signed_distance(np.array([[0.2, 0, 0], [-0.5, 0, 0], [1.5, 0, 0]]))
    np.testing.assert_array_equal(distance < 0, [True, True, False])
    # Side by side, or halfway into each other, is not inside.
    beside = trimesh.util.concatenate([outer, ball(0.4, at=(1.0, 0, 0))])
    assert Body.from_arrays(beside.vertices, beside.faces).warnings == ()


def test_moebius_strip_is_left_as_it_is_and_named():
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    across = np.column_stack([np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)])
    middle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(24)])
    points = np.vstack([middle - 0.3 * across, middle + 0.3 * across])
    faces = []
    for i in range(24):
        a, b, c, d = i, i + 24, (i + 1) % 24, (i + 1) % 24 + 24
        if i == 23:
            c, d = d, c
        faces += [[a, c, b], [b, c, d]]
    body = Body.from_arrays(points, faces)
    assert any("one side only" in w for w in body.warnings)
    assert body.repairs == {}
    np.testing.assert_array_equal(body.triangles, faces)


def test_side_of_four_triangles_is_counted_and_both_pieces_face_outwards():
    one = trimesh.creation.box(extents=[1, 1, 1])
    other = trimesh.creation.box(extents=[1, 1, 1]).apply_translation([1, 1, 0])  # they share the side at (0.5, 0.5)
    other.invert()
    both = trimesh.util.concatenate([one, other])
    body = Body.from_arrays(both.vertices, both.faces)
    assert body.repairs["duplicate vertices merged"] == 2
    assert body.repairs["triangles turned outside out"] == 12
    assert body.warnings == (
        "body 'body': 1 sides have more than two triangles; which way is out is decided for each piece",
    )
    assert volume(body) == pytest.approx(2.0)


def test_triangles_that_do_not_hang_together_keep_their_winding_and_are_named():
    mesh = ball()
    x, faces = soup(mesh)
    middle = np.repeat(mesh.triangles_center, 3, axis=0)
    body = Body.from_arrays(middle + 0.98 * (x - middle), faces, "shards")  # gaps that can be seen
    assert body.repairs == {}
    assert f"{len(faces)} of {len(faces)} triangles share no side with exactly one other" in body.warnings[1]
    inside = np.linalg.norm(around(body, 500), axis=1) < 0.9
    outside = np.linalg.norm(around(body, 500), axis=1) > 1.1
    distance = body.signed_distance(around(body, 500))
    assert (distance[inside] < 0).all()
    assert (distance[outside] > 0).all()


# ---- what is inside


def winding_by_igl(points: np.ndarray, body: Body) -> np.ndarray:
    return np.asarray(igl.winding_number(body.vertices, body.triangles.astype(np.int64), points))


def test_winding_number_is_that_of_libigl_on_a_body_with_holes():
    woman = Body.load("young")
    centres = woman.vertices[woman.triangles].mean(axis=1)
    keep = np.ones(len(centres), dtype=bool)
    for place, radius in (((0, 0, 1.6), 0.06), ((0.1, -0.1, 1.0), 0.08), ((0, 0.1, 1.25), 0.1), ((0, 0, 0.0), 0.1)):
        keep &= np.linalg.norm(centres - place, axis=1) > radius
    scan = Body.from_arrays(woman.vertices, woman.triangles[keep], "scan")
    assert "sides have one triangle only" in scan.warnings[0]
    points = np.vstack([around(scan, 300), scan.vertices[::60] + 0.01 * np.random.default_rng(0).standard_normal(3)])
    exact = winding_by_igl(points, scan)
    np.testing.assert_allclose(scan.winding_number(points), exact, atol=0.02)
    clear = np.abs(exact - 0.5) > 0.02
    np.testing.assert_array_equal(scan.signed_distance(points)[clear] < 0, exact[clear] > 0.5)
    # Away from the holes the scan has the inside of the whole body.
    far = np.abs(exact - np.round(exact)) < 0.1
    assert far.mean() > 0.8
    np.testing.assert_array_equal(woman.signed_distance(points)[far] < 0, exact[far] > 0.5)


def test_hand_that_goes_into_the_hip_is_inside_with_it():
    hip, hand = ball(0.3), trimesh.creation.capsule(0.5, 0.08, count=[12, 12]).apply_translation([0.32, 0, -0.3])
    both = trimesh.util.concatenate([hip, hand])
    body = Body.from_arrays(both.vertices, both.faces)
    assert body.warnings == ()
    points = around(body, 2000)
    inside = body_of(hip).signed_distance(points) < 0
    inside |= body_of(hand).signed_distance(points) < 0
    assert 50 < inside.sum() < 1900
    np.testing.assert_array_equal(body.signed_distance(points) < 0, inside)


def test_side_is_right_close_to_a_thin_part():
    finger = body_of(trimesh.creation.capsule(0.06, 0.004, count=[10, 10]))
    triangle = finger.vertices[finger.triangles]
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for depth in (1e-9, 1e-6, 1e-3):
        for side in (1, -1):
            distance = finger.signed_distance(triangle.mean(axis=1) + side * depth * normal)
            np.testing.assert_allclose(distance, side * depth, rtol=1e-5)


# ---- whatever comes


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60))
def test_any_mesh_is_repaired_once_and_for_all_or_refused(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 4, (20, 3)) / 4.0  # many coincide or lie in line
    faces = rng.integers(0, 20, (count, 3))
    try:
        body = Body.from_arrays(points, faces)
    except BodyError as error:
        assert "no triangle with an area is left" in str(error)  # noqa: PT017
        return
    again = Body.from_arrays(body.vertices, body.triangles)
    assert again.repairs == {}
    np.testing.assert_array_equal(again.triangles, body.triangles)
    np.testing.assert_array_equal(again.vertices, body.vertices)
    corner = body.vertices[body.triangles]
    assert (np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) > 0).all()
    assert np.isfinite(body.signed_distance(around(body, 20))).all()


def test_large_body_is_repaired_and_its_tree_is_shallow():
    mesh = trimesh.creation.uv_sphere(count=[200, 256])
    faces, turned = some_turned(np.asarray(mesh.faces), 0.4)
    body = Body.from_arrays(mesh.vertices, faces)
    assert body.repairs["triangles turned to agree with their neighbours"] == turned
    assert as_trimesh(body).is_watertight
    # Stacks of traversals hold 128 entries and need one for each level.
    for x, triangles in ((body.vertices, body.triangles), (np.zeros((3, 3)), np.zeros((5000, 3), dtype=np.int32))):
        tree = build_tree(x, triangles)
        depth = np.zeros(len(tree.triangle), dtype=int)
        for node in np.flatnonzero(tree.triangle < 0):
            depth[node + 1] = depth[tree.right[node]] = depth[node] + 1
        assert depth.max() == int(np.ceil(np.log2(len(triangles))))
