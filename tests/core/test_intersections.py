"""Counting of crossings: against ipctk, libigl and exact fractions, on random and on constructed meshes."""

from fractions import Fraction

import igl.predicates
import naive_geometry
import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.flat_separation import certainly_apart
from cloth_core.intersections import (
    crossing_edges,
    crossing_pairs,
    segment_crosses,
    self_crossing_edges,
    self_crossing_pairs,
)
from cloth_core.mesh_topology import point_neighbours, representatives, unique_edges
from cloth_core.orientation import exact_orientation, orientation


def sides_of(triangles: np.ndarray) -> list[tuple[int, int]]:
    return sorted({tuple(sorted((t[k], t[(k + 1) % 3]))) for t in triangles.tolist() for k in range(3)})


def volume(a, b, c, d) -> Fraction:
    """Six times the signed volume of a tetrahedron, exactly."""
    u, v, w = ([Fraction(float(q[k])) - Fraction(float(a[k])) for k in range(3)] for q in (b, c, d))
    return w[0] * (u[1] * v[2] - u[2] * v[1]) + w[1] * (u[2] * v[0] - u[0] * v[2]) + w[2] * (u[0] * v[1] - u[1] * v[0])


def crosses_exactly(p, q, a, b, c) -> bool:
    """Whether segment pq passes from one side of triangle abc to the other, its sides and corners included."""
    above, below = volume(a, b, c, p), volume(a, b, c, q)
    signs = {(v > 0) - (v < 0) for v in (volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a))}
    return above * below < 0 and not {1, -1} <= signs


def naive(x, triangles, other_x, other_triangles, test, same: bool = False) -> list[tuple[int, int]]:
    """Sides that cross any triangle, all against all."""
    found = []
    for i, j in sides_of(triangles):
        for t in other_triangles:
            if same and {i, j} & set(t.tolist()):
                continue
            if test(x[i], x[j], *other_x[t]):
                found.append((i, j))
                break
    return found


def sign(value: Fraction) -> int:
    return (value > 0) - (value < 0)


def exact_pairs(x, triangles, other_x, other_triangles, same: bool = False) -> set[tuple[int, int, int]]:
    """Sides (two numbers) and triangles that they cross, by the whole rule in exact fractions, all against all."""
    found, ending = set(), {}
    for i, j in sides_of(triangles):
        for t, corners in enumerate(other_triangles.tolist()):
            if same and {i, j} & set(corners):
                continue
            abc = other_x[corners]
            above, below = sign(volume(*abc, x[i])), sign(volume(*abc, x[j]))
            through = {sign(volume(x[i], x[j], abc[k], abc[(k + 1) % 3])) for k in range(3)}
            if above == below or {1, -1} <= through:
                continue
            if above * below < 0:
                found.add((i, j, t))
            else:
                ending.setdefault((j if below == 0 else i, t), []).append((above + below, (i, j, t)))
    for ways in ending.values():
        if {side for side, _ in ways} == {1, -1}:
            found |= {pair for _, pair in ways}
    return found


def as_list(edges: np.ndarray) -> list[tuple[int, int]]:
    return [tuple(e) for e in edges.tolist()]


def random_mesh(rng: np.random.Generator, vertices: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    triangles = np.array([rng.choice(vertices, 3, replace=False) for _ in range(count)], dtype=np.int32)
    return rng.uniform(-1, 1, (vertices, 3)), triangles


@pytest.mark.parametrize("seed", range(6))
def test_crossings_of_random_meshes_are_those_of_ipctk(seed):
    rng = np.random.default_rng(seed)
    one, other = random_mesh(rng, 25, 30), random_mesh(rng, 20, 25)
    expected = naive(*one, *other, naive_geometry.is_edge_intersecting_triangle)
    assert len(expected) > 10
    assert as_list(crossing_edges(*one, *other)) == expected
    expected = naive(*one, *one, naive_geometry.is_edge_intersecting_triangle, same=True)
    assert len(expected) > 10
    assert as_list(self_crossing_edges(*one)) == expected


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(1e-6, 1e3))
def test_crossings_of_random_meshes_are_the_exact_ones(seed, size):
    rng = np.random.default_rng(seed)
    one, other = random_mesh(rng, 8, 6), random_mesh(rng, 8, 6)
    one, other = (one[0] * size, one[1]), (other[0] * size, other[1])
    assert as_list(crossing_edges(*one, *other)) == naive(*one, *other, crosses_exactly)
    assert as_list(self_crossing_edges(*one)) == naive(*one, *one, crosses_exactly, same=True)


# Meshes on a lattice, where nearly everything lies in something else; "turned" ones miss it by rounding.
PLANES = {
    "space": np.eye(3),
    "level": np.diag([1.0, 1.0, 0.0]),
    "upright": np.diag([0.0, 1.0, 1.0]),
    "inclined": np.array([[1.0, 0, 1], [0, 1, 1], [0, 0, 0]]),
    "turned": np.diag([1.0, 1.0, 0.0]) @ np.linalg.qr(np.array([[1.0, 2, 3], [3, 1, 2], [1, 5, 1]]))[0],
}


def lattice_mesh(rng: np.random.Generator, plane: str, vertices: int = 24, count: int = 18):
    """Random points of a lattice, laid into a plane, the last quarter left in space; and triangles of them."""
    _, triangles = random_mesh(rng, vertices, count)
    flat = rng.integers(-2, 3, (vertices, 3)) @ PLANES[plane]
    loose = rng.integers(-2, 3, (vertices, 3)).astype(float)
    return np.where(np.arange(vertices)[:, None] < 3 * vertices // 4, flat, loose), triangles


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("plane", PLANES)
def test_pairs_on_a_lattice_are_the_exact_ones(plane, seed):
    rng = np.random.default_rng(seed)
    one, other = lattice_mesh(rng, plane), lattice_mesh(rng, plane, 12, 10)
    for found, expected in (
        (crossing_pairs(*one, *other), exact_pairs(*one, *other)),
        (self_crossing_pairs(*one), exact_pairs(*one, *one, same=True)),
    ):
        edges, pairs = found
        assert len(expected) > 5
        assert {(*edges[e].tolist(), t) for e, t in pairs.tolist()} == expected


@pytest.mark.parametrize(("plane", "axes"), [("level", [0, 1]), ("upright", [1, 2]), ("inclined", [0, 1])])
def test_apart_in_a_plane_is_what_shapely_calls_disjoint(plane, axes):
    rng = np.random.default_rng(7)
    seen = []
    for _ in range(400):
        flat = rng.integers(-3, 4, (5, 3))
        segment, triangle = shapely.LineString(flat[:2, axes]), shapely.Polygon(flat[2:, axes])
        if triangle.area > 0.0 and segment.length > 0.0:
            seen.append(segment.disjoint(triangle))
            assert certainly_apart(*(flat @ PLANES[plane])) == seen[-1]
    assert min(np.bincount(seen)) > 50


def test_apart_is_not_said_of_what_rounding_decides():
    # Segments that end on a triangle's side as well as rounding allows, and come from beyond it.
    rng = np.random.default_rng(9)
    reach_in = 0
    for _ in range(400):
        a, b, c = np.column_stack([rng.uniform(-1, 1, (3, 2)), np.zeros(3)])
        p, q = a + rng.uniform(0.2, 0.8) * (b - a), a + b - c
        lift = np.array([0.0, 0.0, 1.0])
        if volume(a, b, p, c + lift) * volume(a, b, q, c + lift) <= 0:  # p is not strictly on q's side of ab
            reach_in += 1
            assert not certainly_apart(p, q, a, b, c)
    assert reach_in > 100


@pytest.mark.parametrize("plane", PLANES)
def test_what_is_apart_does_not_cross(plane):
    rng = np.random.default_rng(8)
    apart = 0
    for _ in range(400):
        points = rng.integers(-3, 4, (5, 3)) @ PLANES[plane]
        if certainly_apart(*points):
            apart += 1
            assert not crosses_exactly(*points)
    assert apart > 50


def test_two_boxes():
    outer = trimesh.creation.box(extents=[2, 2, 2])
    inner = trimesh.creation.box(extents=[1, 1, 1])
    pushed = trimesh.creation.box(extents=[1, 1, 1])
    pushed.apply_translation([1.0, 0.1, 0.05])

    def count(a, b) -> int:
        faces = (np.asarray(m.faces, dtype=np.int32) for m in (a, b))
        return len(crossing_edges(np.asarray(a.vertices), next(faces), np.asarray(b.vertices), next(faces)))

    assert count(inner, outer) == 0  # wholly inside is not crossed
    assert count(outer, inner) == 0
    # The four edges along x pass through the outer face, and so does one diagonal of each of the four faces at them.
    assert count(pushed, outer) == 8
    assert count(outer, pushed) <= 1  # at most the diagonal of the face that is pierced


def test_touching_is_not_crossing():
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    for z, count in ((1e-12, 0), (0.0, 0), (-1e-12, 2)):
        # A triangle that stands on its tip: two of its sides pass through the square once the tip is below.
        tip = np.array([[0.3, 0.1, z], [0.2, 0.1, 1.0], [0.4, 0.1, 1.0]])
        assert len(crossing_edges(tip, np.array([[0, 1, 2]], dtype=np.int32), square, faces)) == count


def test_neighbours_do_not_count_as_crossing():
    ball = trimesh.creation.icosphere(subdivisions=2)
    x, faces = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32)
    assert len(self_crossing_edges(x, faces)) == 0
    # Two balls that overlap, in one mesh: exactly the crossings of the one with the other, both ways.
    shifted = x + np.array([1.1, 0.05, 0.02])
    both = np.vstack([x, shifted]), np.vstack([faces, faces + len(x)]).astype(np.int32)
    expected = len(crossing_edges(x, faces, shifted, faces)) + len(crossing_edges(shifted, faces, x, faces))
    assert expected > 10
    assert len(self_crossing_edges(*both)) == expected


def test_nothing_crosses_nothing():
    none = np.zeros((0, 3), dtype=np.int32)
    x, faces = np.eye(3), np.array([[0, 1, 2]], dtype=np.int32)
    assert crossing_edges(x, none, x, faces).shape == (0, 2)
    assert crossing_edges(x, faces, np.zeros((0, 3)), none).shape == (0, 2)
    assert self_crossing_edges(x, none).shape == (0, 2)


# ---- exact signs


def hard_points(seed: int) -> np.ndarray:
    """Four points of which the last lies nearly or exactly in the plane of the others, also far from the origin."""
    rng = np.random.default_rng(seed)
    points = rng.integers(-3, 4, (4, 3)) * rng.choice([1.0, 0.1, 1e-7, 1 / 3])
    if seed % 3 == 0:
        points = rng.uniform(-1, 1, (4, 3))
        points[3] = rng.dirichlet([1, 1, 1]) @ points[:3]
    if seed % 4 == 0:
        points[2] = (points[0] + points[1]) / 2 + rng.uniform(-1e-15, 1e-15, 3)
    if seed % 2 == 0:
        points += rng.uniform(-1e4, 1e4, 3)
    return points


def test_orientation_is_exact_where_rounding_decides():
    points = np.array([hard_points(seed) for seed in range(600)])
    exact = np.array([(v > 0) - (v < 0) for v in (volume(*p) for p in points)])
    assert min(np.bincount(exact + 1)) > 50
    np.testing.assert_array_equal([orientation(*p) for p in points], exact)
    np.testing.assert_array_equal([exact_orientation(*p) for p in points], exact)
    # libigl's predicates (Shewchuk's own code) take the other side for the positive one.
    np.testing.assert_array_equal(igl.predicates.orient3d(*(points[:, k].copy() for k in range(4))), -exact)
    u, v, w = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0], points[:, 3] - points[:, 0]
    assert (np.sign((np.cross(u, v) * w).sum(-1)) != exact).sum() > 20  # plain floating point is often wrong here


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["plain", "slivers", "far from the origin"])
def test_pairs_of_triangles_that_meet_are_those_of_libigl(kind, seed):
    rng = np.random.default_rng(seed)
    meshes = []
    for _ in range(2):
        x, triangles = random_mesh(rng, 30, 40)
        if kind == "slivers" and not meshes:  # each third corner lies nearly between the two others
            triangles = np.arange(120, dtype=np.int32).reshape(-1, 3)
            x = rng.uniform(-1, 1, (120, 3))
            x[2::3] = (x[0::3] + x[1::3]) / 2 + rng.uniform(-1e-9, 1e-9, (40, 3))
        if kind == "far from the origin":
            x += np.array([1e4, -1e4, 1e4])
        meshes.append((x, triangles))
    one, other = meshes
    found = set()
    for first, second, swap in ((one, other, False), (other, one, True)):
        edges, pairs = crossing_pairs(*first, *second)
        for e, t in pairs.tolist():
            owners = np.flatnonzero(np.isin(first[1], edges[e]).sum(axis=1) == 2)
            found |= {(t, o) if swap else (o, t) for o in owners.tolist()}
    _, pairs, _ = igl.predicates.find_intersections(
        one[0], one[1].astype(np.int64), other[0], other[1].astype(np.int64)
    )
    expected = {tuple(pair) for pair in pairs.tolist()}
    assert len(expected) > 50
    assert found == expected


# ---- the rule where things only just meet

SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
FIN = np.array([[0, 1, 2]], dtype=np.int32)
PLACES = [(0.0, 0.0, 0.0), (1e4, -2e4, 3e4), (0.1, 0.2, 0.3)]


def through_square(points: np.ndarray, faces: np.ndarray, place) -> int:
    """Crossings of a mesh and a square of two triangles in the plane z = 0, both moved."""
    move = np.asarray(place)
    return len(crossing_edges(np.asarray(points) + move, faces, SQUARE + move, HALVES))


@pytest.mark.parametrize("place", PLACES)
def test_side_through_the_common_side_or_a_corner_of_triangles_counts_once(place):
    # Sides 0-1 and 0-2 go down, both through the diagonal or one of its ends.
    for start, first, second in (((0.0, 0, 1), (0, 0, -1), (1, 1, -1)), ((0.5, 0.5, 1), (0.5, 0.5, -1), (1, 1, -1))):
        assert through_square([start, first, second], FIN, (0, 0, 0)) == 2
    assert through_square([(0.25, 0.25, 1), (0.25, 0.25, -1), (3, 0, 1)], FIN, place) >= 1
    assert segment_crosses(*(np.array(p, dtype=float) for p in ((1, 1, 1), (1, 1, -1), *SQUARE[:3])))
    assert not segment_crosses(
        *(np.array(p, dtype=float) for p in ((1, 1 + 2.0**-50, 1), (1, 1 + 2.0**-50, -1), *SQUARE[:3]))
    )


@pytest.mark.parametrize("place", PLACES[:2])
def test_lying_on_each_other_is_not_crossing(place):
    flat = np.array([[-0.5, -0.5, 0], [0.7, -0.2, 0], [0.1, 2.0, 0]])
    assert through_square(flat, FIN, place) == 0  # overlaps in the plane
    hinge = np.array([[-0.5, -0.5, 0], [0.7, -0.2, 0], [0.1, 0.3, 1]])
    assert through_square(hinge, FIN, place) == 0  # one side lies in the plane
    for z in (1.0, -1.0):
        tip = np.array([[0.25, 0.125, 0], [0.5, 0.25, z], [0.25, 0.5, z]])
        assert through_square(tip, FIN, place) == 0  # a tip that touches, from either side


@pytest.mark.parametrize("place", PLACES[:2])
def test_surface_that_passes_through_at_a_row_of_its_corners_is_seen(place):
    # An upright strip with its middle row of vertices exactly in the plane: no side has its ends on both sides.
    x = np.array([[0.25 * i - 0.5, 0.125, z] for z in (1.0, 0.0, -1.0) for i in range(5)])
    quads = np.array([5 * j + i for j in range(2) for i in range(4)])
    faces = np.vstack([np.column_stack([quads, quads + 1, quads + 6]), np.column_stack([quads, quads + 6, quads + 5])])
    faces = faces.astype(np.int32)
    # All sides that end in the middle row from above or below: 5 upright and 4 diagonal ones each way.
    assert through_square(x, faces, place) == 18
    # The same strip folded up at that row only touches.
    folded = x.copy()
    folded[10:, 2] = 1.0
    folded[10:, 1] += 0.5
    assert through_square(folded, faces, place) == 0


def test_panels_that_are_sewn_but_not_merged_do_not_cross_at_their_seam():
    # Two squares whose facing sides are to be sewn; the gap is so small that they overlap by a micrometre.
    left, right = SQUARE.copy(), SQUARE + np.array([2.0 - 1e-6, 0, 0])
    right[[0, 3], 2] = [1e-7, -1e-7]
    right[[1, 2], 2] = [-0.3, 0.3]
    x, faces = np.vstack([left, right]), np.vstack([HALVES, HALVES + 4]).astype(np.int32)
    sewn = np.array([0, 1, 2, 3, 1, 4, 5, 2], dtype=np.int32)  # 1 with 4 and 2 with 7
    assert len(self_crossing_edges(x, faces)) > 0
    assert len(self_crossing_edges(x, faces, sewn)) == 0
    merged = np.empty((6, 3))
    merged[sewn] = x
    assert len(self_crossing_edges(merged, sewn[faces])) == 0


# ---- who stands for which vertex and side


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_every_vertex_and_side_belongs_to_one_triangle_that_has_it(seed, count):
    rng = np.random.default_rng(seed)
    _, triangles = random_mesh(rng, 12, count)
    edges, table = unique_edges(triangles)
    assert as_list(edges) == sides_of(triangles)
    own = representatives(triangles)
    for t, triangle in enumerate(triangles):
        for k in range(3):
            assert sorted(edges[table[t, k]]) == sorted((triangle[k], triangle[(k + 1) % 3]))
    for owned, table, there in (
        (own.own_vertices, triangles, set(triangles.ravel().tolist())),
        (own.own_edges, own.triangle_edges, set(range(len(edges)))),
    ):
        named = [row[1 : 1 + row[0]] for row in owned.tolist()]
        assert all(set(mine) <= set(row) for mine, row in zip(named, table.tolist(), strict=True))
        assert sorted(entry for mine in named for entry in mine) == sorted(there)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_neighbours_of_a_point_are_the_corners_beside_it(seed, count):
    # Points that have met are one, so that triangles may have a corner twice: such a point is its own neighbour.
    triangles = np.random.default_rng(seed).integers(0, 12, (count, 3)).astype(np.int32)
    start, neighbours = point_neighbours(triangles)
    assert len(start) == triangles.max() + 2
    for point in range(len(start) - 1):
        beside = {t[k - m] for t in triangles.tolist() for k in range(3) for m in (1, 2) if t[k] == point}
        assert neighbours[start[point] : start[point + 1]].tolist() == sorted(beside)
