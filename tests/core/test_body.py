"""Bodies: what is refused, what is mended and counted, distance and side, and the three that come with the package."""

import math

import numpy as np
import pytest
import trimesh
from apparatus import body_of
from malformed_bodies import MALFORMED, TETRAHEDRON
from naive_geometry import point_triangle_distance

from cloth_core.body import Body, builtin_bodies
from cloth_core.errors import BodyError
from cloth_core.mesh_distance import distances_to_mesh


@pytest.mark.parametrize("what", MALFORMED)
def test_malformed_body_is_refused_with_its_name_and_the_reason(what):
    vertices, triangles, message = MALFORMED[what]
    with pytest.raises(BodyError) as caught:
        Body.from_arrays(vertices, triangles, "anna")
    text = str(caught.value)
    assert message in text
    assert text.startswith("body 'anna'")
    assert "\n" not in text
    assert len(text) < 250


def test_there_are_at_least_fifteen_of_them():
    assert len(MALFORMED) >= 15


@pytest.mark.parametrize("source", ["nobody", "no/such/file.ply", "nowhere.obj"])
def test_unknown_body_is_refused(source):
    with pytest.raises(BodyError, match=r"nobody|file|nowhere"):
        Body.load(source)


def test_good_body_is_taken_as_it_is():
    body = Body.from_arrays(*TETRAHEDRON)
    assert body.repairs == {}
    assert body.warnings == ()
    np.testing.assert_array_equal(body.vertices, TETRAHEDRON[0])
    np.testing.assert_array_equal(body.triangles, TETRAHEDRON[1])


def test_every_repair_is_counted():
    x, faces = TETRAHEDRON
    x = [*x, [9.0, 9, 9], [0.5, 0, 0], [8.0, 8, 8]]  # two unused vertices, one in the middle of side 0-1
    faces = [*faces, [0, 5, 1], [1, 1, 2], [3, 1, 0], [2, 3, 1], [0, 2, 1]]
    body = Body.from_arrays(x, faces)
    assert body.repairs == {
        "zero-area triangles dropped": 2,
        "duplicate triangles dropped": 3,
        "unused vertices dropped": 3,
    }
    np.testing.assert_array_equal(body.vertices, TETRAHEDRON[0])
    np.testing.assert_array_equal(body.triangles, TETRAHEDRON[1])


def test_inside_out_body_is_turned():
    ball = trimesh.creation.icosphere(subdivisions=2)
    turned = Body.from_arrays(ball.vertices, ball.faces[:, ::-1])
    assert turned.repairs == {"triangles turned outside out": len(ball.faces)}
    assert turned.signed_distance(np.zeros((1, 3)))[0] < 0
    volume = np.linalg.det(turned.vertices[turned.triangles]).sum() / 6
    assert volume == pytest.approx(ball.volume, rel=1e-12)
    # Far from the origin the same.
    far = Body.from_arrays(np.asarray(ball.vertices) + np.array([50.0, -70.0, 3.0]), ball.faces[:, ::-1])
    assert far.repairs == turned.repairs


def test_open_surface_gives_a_warning_with_the_number_of_its_sides():
    ball = trimesh.creation.icosphere(subdivisions=2)
    body = Body.from_arrays(ball.vertices, ball.faces[1:], "bowl")
    assert len(body.warnings) == 1
    assert body.warnings[0].startswith(
        "body 'bowl': 3 sides have one triangle only; the surface is open there, and inside"
    )


def test_arrays_of_any_number_type_are_taken():
    x, faces = TETRAHEDRON
    for numbers, indices in ((np.float32, np.uint8), (np.int64, np.int64), (np.float64, np.uint32)):
        body = Body.from_arrays(np.array(x, dtype=numbers), np.array(faces, dtype=indices))
        assert body.vertices.dtype == np.float64
        assert body.triangles.dtype == np.int32
        np.testing.assert_array_equal(body.vertices, x)


def test_body_does_not_change_with_the_arrays_it_was_made_of():
    x, faces = np.array(TETRAHEDRON[0]), np.array(TETRAHEDRON[1], dtype=np.int32)
    body = Body.from_arrays(x, faces)
    x[:], faces[:] = 7.0, 0
    np.testing.assert_array_equal(body.vertices, TETRAHEDRON[0])
    np.testing.assert_array_equal(body.triangles, TETRAHEDRON[1])


# ---- distance


def winding_number(points: np.ndarray, body: Body) -> np.ndarray:
    """How often the surface encloses each point: the sum of the solid angles of its triangles over 4 pi."""
    a, b, c = (body.vertices[body.triangles[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    above = np.einsum("...i,...i", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(above, below).sum(axis=1) / (2 * math.pi)


def nearest(points: np.ndarray, body: Body) -> np.ndarray:
    """Smallest distance to any triangle, by trimesh, all against all."""
    corners = body.vertices[body.triangles]
    return np.array(
        [
            np.linalg.norm(trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1))) - p, axis=1).min()
            for p in points
        ]
    )


SHAPES = {
    "ball": trimesh.creation.icosphere(subdivisions=2, radius=0.3),
    "box": trimesh.creation.box(extents=[0.5, 0.3, 0.8]),
    "torus": trimesh.creation.torus(0.4, 0.15, 24, 12),
    "spike": trimesh.creation.cone(0.05, 1.0, sections=8),
    "two balls": trimesh.util.concatenate(
        [
            trimesh.creation.icosphere(1, radius=0.2),
            trimesh.creation.icosphere(1, radius=0.3).apply_translation([0.6, 0, 0]),
        ]
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_signed_distance_is_that_of_trimesh_and_negative_inside(shape):
    body = body_of(SHAPES[shape])
    rng = np.random.default_rng(3)
    low, high = body.vertices.min(axis=0) - 0.1, body.vertices.max(axis=0) + 0.1
    corner = body.vertices[body.triangles[rng.integers(0, len(body.triangles), 150)]]
    on_surface = (corner * rng.dirichlet([1, 1, 1], 150)[:, :, None]).sum(axis=1)
    points = np.vstack([rng.uniform(low, high, (250, 3)), on_surface + 0.01 * rng.standard_normal((150, 3))])
    distance = body.signed_distance(points)
    np.testing.assert_allclose(np.abs(distance), nearest(points, body), atol=1e-12)
    inside = winding_number(points, body) > 0.5
    assert 10 < inside.sum() < 390
    np.testing.assert_array_equal(distance < 0, inside)


def test_side_is_right_beyond_edges_and_corners():
    # Straight out from each corner and each side of a spike, where the normal of one face alone would often err.
    body = body_of(SHAPES["spike"])
    middle = body.vertices.mean(axis=0)
    edges = np.array([(body.vertices[t[k]] + body.vertices[t[k - 1]]) / 2 for t in body.triangles for k in range(3)])
    for points in (body.vertices, edges):
        outside, inside = points + 0.01 * (points - middle), points - 0.01 * (points - middle)
        assert (body.signed_distance(outside) > 0).all()
        assert (body.signed_distance(inside) < 0).all()


def test_distance_of_the_builtin_body_is_that_of_the_textbook():
    body = Body.load("young")
    rng = np.random.default_rng(1)
    points = body.vertices[rng.integers(0, len(body.vertices), 12)] + 0.03 * rng.standard_normal((12, 3))
    corners = body.vertices[body.triangles].transpose(1, 0, 2)
    expected = [math.sqrt(point_triangle_distance(p, *corners).min()) for p in points]
    distance = body.signed_distance(points)
    np.testing.assert_allclose(np.abs(distance), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(distance < 0, winding_number(points, body) > 0.5)


# ---- the three women of the paper

HEIGHTS = {"young": 1.660, "middle_aged": 1.600, "elderly": 1.610}
WEIGHTS = {"young": 52.8, "middle_aged": 54.4, "elderly": 63.9}


def test_the_papers_three_women_are_there():
    assert set(builtin_bodies()) == set(HEIGHTS)


@pytest.mark.parametrize("name", HEIGHTS)
def test_builtin_body_has_the_papers_height_and_a_plausible_weight(name):
    body = Body.load(name)
    assert body.name == name
    assert body.repairs == {}
    assert body.warnings == ()
    assert np.ptp(body.vertices[:, 2]) == pytest.approx(HEIGHTS[name], abs=0.01)
    assert body.vertices[:, 2].min() == pytest.approx(0.0, abs=0.01)
    volume = np.linalg.det(body.vertices[body.triangles]).sum() / 6
    assert 1000 * volume == pytest.approx(WEIGHTS[name], rel=0.06)  # a person weighs about as much as water


def test_moved_body_is_searched_where_it_is_and_the_first_one_where_it_was():
    body = body_of(trimesh.creation.icosphere(2, radius=0.2))
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (50, 3))
    way = np.array([0.3, 0.0, 0.1])
    before = distances_to_mesh(points, body.vertices, body.triangles, body.tree)
    # Twice, the second time in another shape, without a search in between.
    moved = body.moved(body.vertices + way).moved(1.5 * body.vertices + way)
    mesh = trimesh.Trimesh(moved.vertices, moved.triangles, process=False)
    _, exact, _ = trimesh.proximity.closest_point(mesh, points)
    found = distances_to_mesh(points, moved.vertices, moved.triangles, moved.tree)
    np.testing.assert_allclose(found, exact, atol=1e-12)
    assert (np.abs(found - before) > 1e-3).any()
    np.testing.assert_array_equal(distances_to_mesh(points, body.vertices, body.triangles, body.tree), before)
    assert (moved.name, moved.repairs, moved.warnings) == (body.name, body.repairs, body.warnings)
