"""Counting of crossings: against ipctk's predicate and exact fractions, on random and on constructed meshes."""

from fractions import Fraction

import ipctk
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.intersections import crossing_edges, self_crossing_edges
from cloth_core.mesh_topology import representatives, unique_edges


def sides_of(triangles: np.ndarray) -> list[tuple[int, int]]:
    return sorted({tuple(sorted((t[k], t[(k + 1) % 3]))) for t in triangles.tolist() for k in range(3)})


def volume(a, b, c, d) -> Fraction:
    """Six times the signed volume of a tetrahedron, exactly."""
    u, v, w = ([Fraction(float(q[k])) - Fraction(float(a[k])) for k in range(3)] for q in (b, c, d))
    return w[0] * (u[1] * v[2] - u[2] * v[1]) + w[1] * (u[2] * v[0] - u[0] * v[2]) + w[2] * (u[0] * v[1] - u[1] * v[0])


def crosses_exactly(p, q, a, b, c) -> bool:
    """Whether segment pq passes through the inside of triangle abc."""
    above, below = volume(a, b, c, p), volume(a, b, c, q)
    signs = {(v > 0) - (v < 0) for v in (volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a))}
    return above * below < 0 and signs in ({1}, {-1})


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


def as_list(edges: np.ndarray) -> list[tuple[int, int]]:
    return [tuple(e) for e in edges.tolist()]


def random_mesh(rng: np.random.Generator, vertices: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    triangles = np.array([rng.choice(vertices, 3, replace=False) for _ in range(count)], dtype=np.int32)
    return rng.uniform(-1, 1, (vertices, 3)), triangles


@pytest.mark.parametrize("seed", range(6))
def test_crossings_of_random_meshes_are_those_of_ipctk(seed):
    rng = np.random.default_rng(seed)
    one, other = random_mesh(rng, 25, 30), random_mesh(rng, 20, 25)
    expected = naive(*one, *other, ipctk.is_edge_intersecting_triangle)
    assert len(expected) > 10
    assert as_list(crossing_edges(*one, *other)) == expected
    expected = naive(*one, *one, ipctk.is_edge_intersecting_triangle, same=True)
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
    assert sorted(triangles[own.owns_vertex].tolist()) == sorted(set(triangles.ravel().tolist()))
    assert sorted(own.triangle_edges[own.owns_edge].tolist()) == list(range(len(edges)))
