"""Closest points against textbook formulas, against dense sampling, and where things are degenerate."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from naive_geometry import edge_edge_distance, point_triangle_distance

from cloth_core.closest_points import point_triangle, segment_segment

# A small lattice: touching, parallel and degenerate cases are common on it.
lattice = st.tuples(*[st.integers(-2, 2)] * 3).map(lambda p: np.array(p, dtype=float))
anywhere = st.tuples(*[st.floats(-2, 2, allow_subnormal=False)] * 3).map(np.array)
point = st.one_of(lattice, anywhere)


def scale(*points: np.ndarray) -> float:
    return 1.0 + max(float(np.abs(p).max()) for p in points)


@settings(max_examples=200, deadline=None)
@given(point, point, point, point)
def test_point_and_triangle(p, a, b, c):
    assume(np.linalg.norm(np.cross(b - a, c - a)) > 1e-9 * scale(p, a, b, c) ** 2)
    squared, u, v, w = point_triangle(p, a, b, c)
    tolerance = 1e-7 * scale(p, a, b, c) ** 2
    assert min(u, v, w) >= -1e-12
    assert u + v + w == pytest.approx(1.0, abs=1e-12)
    at = u * a + v * b + w * c
    assert squared == pytest.approx(float(((p - at) ** 2).sum()), abs=tolerance)
    # No corner, and no point of a dense sample of the triangle, is nearer.
    s, t = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12))
    inside = s + t <= 1 + 1e-12
    sample = a + s[inside, None] * (b - a) + t[inside, None] * (c - a)
    assert squared <= ((sample - p) ** 2).sum(axis=1).min() + tolerance


@settings(max_examples=200, deadline=None)
@given(point, point, point, point)
def test_two_segments(p, q, a, b):
    squared, s, t = segment_segment(p, q, a, b)
    tolerance = 1e-7 * scale(p, q, a, b) ** 2
    assert 0.0 <= s <= 1.0
    assert 0.0 <= t <= 1.0
    gap = p + s * (q - p) - a - t * (b - a)
    assert squared == pytest.approx(float(gap @ gap), abs=tolerance)
    along = np.linspace(0, 1, 25)[:, None]
    sample = (p + along * (q - p))[:, None] - (a + along * (b - a))[None]
    assert squared <= (sample**2).sum(axis=-1).min() + tolerance


def test_distances_are_those_of_the_textbook():
    rng = np.random.default_rng(11)
    for _ in range(1500):
        p, a, b, c = rng.standard_normal((4, 3)) * 10.0 ** rng.uniform(-3, 1)
        assert point_triangle(p, a, b, c)[0] == pytest.approx(point_triangle_distance(p, a, b, c), rel=1e-9)
        assert segment_segment(p, a, b, c)[0] == pytest.approx(edge_edge_distance(p, a, b, c), rel=1e-9)


@pytest.mark.parametrize("sharpness", [1e-3, 1e-6])
def test_slivers(sharpness):
    # A needle: the answer is that of its long side to within its width.
    a, b, c = np.array([0.0, 0, 0]), np.array([1.0, 0, 0]), np.array([0.5, sharpness, 0])
    for p in (np.array([0.3, 0.2, 0.4]), np.array([-1.0, 0.1, 0]), np.array([0.5, -0.3, 1.0])):
        side = segment_segment(p, p, a, b)[0]
        assert point_triangle(p, a, b, c)[0] == pytest.approx(side, abs=3 * sharpness)


@settings(max_examples=100, deadline=None)
@given(point, point, point, st.sampled_from([0.0, 1.0, 0.25, -1.0, 3.0]), st.permutations(range(3)))
def test_triangle_that_has_collapsed_to_a_line(p, a, b, share, order):
    # Its distance is that of its longest side.
    corners = [a, b, a + share * (b - a)]
    nearest = min(segment_segment(p, p, corners[i], corners[j])[0] for i, j in ((0, 1), (1, 2), (2, 0)))
    found = point_triangle(p, *(corners[k] for k in order))[0]
    assert found == pytest.approx(nearest, abs=1e-6 * scale(p, a, b) ** 2)


def test_triangle_that_has_collapsed_to_a_line_is_no_farther_than_its_sides():
    # Rounding gave it a face far from where it is.
    p, a = np.array([1.0, 2.0, -1.0]), np.array([2.0, 0.055, 1.8502584565266593])
    nearest = segment_segment(p, p, a, -2.0 * a)[0]
    assert point_triangle(p, -2.0 * a, np.zeros(3), a)[0] == pytest.approx(nearest, rel=1e-9)


def test_one_point_in_place_of_a_triangle_or_segment():
    p, a = np.array([1.0, 2.0, 2.0]), np.zeros(3)
    assert point_triangle(p, a, a, a)[0] == pytest.approx(9.0)
    assert segment_segment(p, p, a, a)[0] == pytest.approx(9.0)
    assert segment_segment(p, p, a, 2 * p)[0] == pytest.approx(0.0, abs=1e-15)


def test_all_regions_of_a_triangle():
    a, b, c = np.array([0.0, 0, 0]), np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
    cases = {
        (0.25, 0.25, 2.0): (4.0, (0.5, 0.25, 0.25)),  # face
        (-1, -1, 0): (2.0, (1, 0, 0)),  # corners
        (3, 0, 0): (4.0, (0, 1, 0)),
        (0, 3, 0): (4.0, (0, 0, 1)),
        (0.5, -1, 0): (1.0, (0.5, 0.5, 0)),  # sides
        (-1, 0.5, 0): (1.0, (0.5, 0, 0.5)),
        (1, 1, 0): (0.5, (0, 0.5, 0.5)),
    }
    for p, (squared, weights) in cases.items():
        found = point_triangle(np.array(p, dtype=float), a, b, c)
        assert found == pytest.approx((squared, *weights))
