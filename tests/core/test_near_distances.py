"""Distances of many pairs at once against textbook formulas, and where segments and triangles are degenerate."""

import numpy as np
import pytest
from naive_geometry import edge_edge_distance, point_triangle_distance

from cloth_core.boxes import edge_boxes, in_box, overlap, triangle_boxes
from cloth_core.near_distances import point_triangle_distances, segment_distances


def some_pairs(rng: np.random.Generator, count: int, first: int, second: int) -> np.ndarray:
    return np.column_stack([rng.integers(0, first, count), rng.integers(0, second, count)]).astype(np.int32)


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 5000])
def test_distances_are_those_of_the_textbook(count):
    rng = np.random.default_rng(count)
    size = 10.0 ** rng.uniform(-3.0, 1.0)
    x, y = size * rng.standard_normal((200, 3)), size * rng.standard_normal((150, 3))
    edges, others = rng.integers(0, 200, (60, 2)).astype(np.int32), rng.integers(0, 150, (50, 2)).astype(np.int32)
    triangles = rng.integers(0, 150, (70, 3)).astype(np.int32)
    pairs = some_pairs(rng, count, 60, 50)
    p, q = x[edges[pairs[:, 0]]].transpose(1, 0, 2)
    a, b = y[others[pairs[:, 1]]].transpose(1, 0, 2)
    expected = np.sqrt(edge_edge_distance(p, q, a, b))
    np.testing.assert_allclose(segment_distances(x, edges, y, others, pairs), expected, atol=1e-9 * size)
    pairs = some_pairs(rng, count, 200, 70)
    corners = y[triangles[pairs[:, 1]]].transpose(1, 0, 2)
    expected = np.sqrt(point_triangle_distance(x[pairs[:, 0]], *corners))
    np.testing.assert_allclose(point_triangle_distances(x, y, triangles, pairs), expected, atol=1e-7 * size)


def lattice_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """On a small lattice touching, parallel and collapsed parts are common."""
    return rng.integers(-2, 3, (count, 3)).astype(float)


def test_touching_parallel_and_collapsed_parts():
    rng = np.random.default_rng(1)
    x, y = lattice_points(rng, 100), lattice_points(rng, 100)
    edges, triangles = rng.integers(0, 100, (400, 2)).astype(np.int32), rng.integers(0, 100, (400, 3)).astype(np.int32)
    pairs = some_pairs(rng, 20_000, 400, 400)
    p, q = x[edges[pairs[:, 0]]].transpose(1, 0, 2)
    a, b = y[edges[pairs[:, 1]]].transpose(1, 0, 2)
    expected = np.sqrt(edge_edge_distance(p, q, a, b))
    assert (expected == 0.0).sum() > 50
    np.testing.assert_allclose(segment_distances(x, edges, y, edges, pairs), expected, atol=1e-7)
    pairs = some_pairs(rng, 20_000, 100, 400)
    corners = y[triangles[pairs[:, 1]]].transpose(1, 0, 2)
    expected = np.sqrt(point_triangle_distance(x[pairs[:, 0]], *corners))
    np.testing.assert_allclose(point_triangle_distances(x, y, triangles, pairs), expected, atol=1e-7)


def test_nearly_parallel_segments_and_slivers_are_never_said_to_be_farther_than_they_are():
    # A distance at the broad phase is a lower bound later on; and nobody may be lost.
    rng = np.random.default_rng(2)
    for thinness in 10.0 ** np.arange(-12.0, -2.0):
        p, u, r = rng.standard_normal((3, 500, 3))
        first = np.stack([p, p + u], axis=1).reshape(-1, 3)
        second = np.stack([p + 0.01 * r, p + 0.01 * r + u * (1.0 + thinness) + thinness * r], axis=1).reshape(-1, 3)
        rows = np.arange(1000, dtype=np.int32).reshape(-1, 2)
        pairs = np.repeat(np.arange(500, dtype=np.int32)[:, None], 2, axis=1)
        found = segment_distances(first, rows, second, rows, pairs)
        along = np.linspace(0.0, 1.0, 41)[:, None, None]
        one, other = first[::2] + along * u, second[::2] + along * (second[1::2] - second[::2])
        sampled = np.linalg.norm(one[:, None] - other[None], axis=-1).min(axis=(0, 1))
        assert (found <= sampled + 1e-9).all()


def test_boxes_hold_whatever_moves_by_no_more_than_its_margin():
    rng = np.random.default_rng(5)
    x, margin = rng.standard_normal((30, 3)), rng.uniform(0.0, 0.3, 30)
    edges, triangles = rng.integers(0, 30, (40, 2)).astype(np.int32), rng.integers(0, 30, (40, 3)).astype(np.int32)
    for corners, boxes in ((edges, edge_boxes(x, edges, margin)), (triangles, triangle_boxes(x, triangles, margin))):
        more = margin[corners].max(axis=1)
        np.testing.assert_array_equal(boxes[:, :3], x[corners].min(axis=1) - more[:, None])
        np.testing.assert_array_equal(boxes[:, 3:6], x[corners].max(axis=1) + more[:, None])
        np.testing.assert_array_equal(boxes[:, 6], more)
    for i in range(40):
        for j in range(40):
            apart = (boxes[i, :3] > boxes[j, 3:6]).any() or (boxes[j, :3] > boxes[i, 3:6]).any()
            assert overlap(boxes, i, boxes, j) == (not apart)
        for k in range(30):
            inside = (x[k] + 0.1 >= boxes[i, :3]).all() and (x[k] - 0.1 <= boxes[i, 3:6]).all()
            assert in_box(x, k, 0.1, boxes, i) == inside
