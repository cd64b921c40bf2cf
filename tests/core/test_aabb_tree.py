"""AABB trees: their shape, their boxes after a refit, and the double traversal against brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.aabb_tree import AabbTree, boxes_overlap, build_tree, overlapping_pairs, refit_tree
from cloth_core.body import Body


def random_mesh(rng: np.random.Generator, count: int, size: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """Triangles anywhere in a unit cube, some flat along an axis, some sharing corners."""
    x = (
        rng.uniform(0, 1, (count, 1, 3))
        + size * rng.standard_normal((count, 3, 3)) * rng.uniform(0, 1, (count, 1, 3)) ** 2
    )
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    shared = rng.random(count) < 0.3
    triangles[shared, 0] = rng.integers(0, 3 * count, int(shared.sum()))
    return x.reshape(-1, 3), triangles


def children(tree: AabbTree, node: int) -> tuple[int, int]:
    return node + 1, int(tree.right[node])


def below(tree: AabbTree, node: int) -> list[int]:
    """Triangles in the leaves under a node, by recursion over the children."""
    if tree.triangle[node] >= 0:
        return [int(tree.triangle[node])]
    left, right = children(tree, node)
    return below(tree, left) + below(tree, right)


def depth(tree: AabbTree, node: int = 0) -> int:
    return 1 if tree.triangle[node] >= 0 else 1 + max(depth(tree, c) for c in children(tree, node))


def assert_boxes_fit(tree: AabbTree, x: np.ndarray, triangles: np.ndarray, margin: float) -> None:
    for node in range(len(tree.triangle)):
        corners = x[triangles[below(tree, node)]].reshape(-1, 3)
        np.testing.assert_array_equal(tree.lower[node], corners.min(axis=0) - margin)
        np.testing.assert_array_equal(tree.upper[node], corners.max(axis=0) + margin)


@pytest.mark.parametrize("count", [1, 2, 3, 10, 257])
def test_every_triangle_is_in_one_leaf_and_every_box_is_that_of_its_triangles(count):
    x, triangles = random_mesh(np.random.default_rng(count), count)
    tree = build_tree(x, triangles)
    assert len(tree.triangle) == 2 * count - 1
    assert sorted(below(tree, 0)) == list(range(count))
    assert sorted(tree.triangle[tree.triangle >= 0]) == list(range(count))
    assert_boxes_fit(tree, x, triangles, 0.0)
    assert depth(tree) <= int(np.ceil(np.log2(count))) + 1  # balanced


def test_refit_moves_and_enlarges_the_boxes_and_keeps_the_nodes():
    rng = np.random.default_rng(8)
    x, triangles = random_mesh(rng, 60)
    tree = build_tree(x, triangles)
    nodes = tree.right.copy(), tree.triangle.copy()
    moved = x + rng.standard_normal(x.shape)
    refit_tree(tree, moved, triangles, 0.125)
    assert_boxes_fit(tree, moved, triangles, 0.125)
    np.testing.assert_array_equal(tree.right, nodes[0])
    np.testing.assert_array_equal(tree.triangle, nodes[1])


def test_no_triangles_make_an_empty_tree_that_meets_nothing():
    empty = build_tree(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    full = build_tree(*random_mesh(np.random.default_rng(0), 4))
    pairs = np.zeros((8, 2), dtype=np.int32)
    assert len(empty.triangle) == 0
    assert overlapping_pairs(empty, full, pairs) == 0
    assert overlapping_pairs(full, empty, pairs) == 0


def test_triangles_in_one_place_still_split():
    x = np.tile(np.eye(3), (50, 1))
    tree = build_tree(x, np.arange(150, dtype=np.int32).reshape(-1, 3))
    assert sorted(below(tree, 0)) == list(range(50))
    assert depth(tree) == 7


@pytest.mark.parametrize("gap", [1e-9, 0.0, -1e-9])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_boxes_that_touch_overlap(axis, gap):
    x = np.eye(3)
    one = build_tree(x, np.array([[0, 1, 2]], dtype=np.int32))
    other = build_tree(x + np.eye(3)[axis] * (1.0 + gap), np.array([[0, 1, 2]], dtype=np.int32))
    assert boxes_overlap(one, 0, other, 0) == (gap <= 0.0)
    assert boxes_overlap(other, 0, one, 0) == (gap <= 0.0)


def brute_force(body, cloth, margin: float) -> set[tuple[int, int]]:
    """All (cloth triangle, body triangle) whose boxes, the cloth's enlarged, have a point in common."""
    (bx, bt), (cx, ct) = body, cloth
    b_low, b_high = bx[bt].min(axis=1), bx[bt].max(axis=1)
    c_low, c_high = cx[ct].min(axis=1) - margin, cx[ct].max(axis=1) + margin
    meet = ((c_low[:, None] <= b_high[None]) & (b_low[None] <= c_high[:, None])).all(axis=2)
    return set(zip(*(i.tolist() for i in np.nonzero(meet)), strict=True))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6), body_count=st.integers(1, 120), cloth_count=st.integers(1, 120),
    margin=st.sampled_from([0.0, 0.01, 0.2]), size=st.sampled_from([0.02, 0.2, 1.0]),
)  # fmt: skip
def test_double_traversal_finds_what_brute_force_finds(seed, body_count, cloth_count, margin, size):
    rng = np.random.default_rng(seed)
    body, cloth = random_mesh(rng, body_count, size), random_mesh(rng, cloth_count, size)
    body_tree, cloth_tree = build_tree(*body), build_tree(*cloth)
    # The cloth has moved since its tree was built.
    cloth = (cloth[0] + 0.1 * rng.standard_normal(cloth[0].shape), cloth[1])
    refit_tree(cloth_tree, cloth[0], cloth[1], margin)
    pairs = np.zeros((body_count * cloth_count, 2), dtype=np.int32)
    found = overlapping_pairs(body_tree, cloth_tree, pairs)
    listed = [tuple(p) for p in pairs[:found].tolist()]
    assert len(set(listed)) == len(listed)  # none twice
    assert set(listed) == brute_force(body, cloth, margin)


def test_traversal_counts_what_it_has_no_room_for_and_always_has_the_same_order():
    rng = np.random.default_rng(5)
    body, cloth = random_mesh(rng, 80, 0.5), random_mesh(rng, 70, 0.5)
    trees = build_tree(*body), build_tree(*cloth)
    expected = len(brute_force(body, cloth, 0.0))
    short, long, again = (np.full((n, 2), -1, dtype=np.int32) for n in (7, expected + 5, expected + 5))
    assert overlapping_pairs(*trees, short) == expected > 7
    assert overlapping_pairs(*trees, long) == expected
    overlapping_pairs(build_tree(*body), build_tree(*cloth), again)
    np.testing.assert_array_equal(long, again)
    np.testing.assert_array_equal(short, long[:7])
    assert (long[expected:] == -1).all()  # nothing is written beyond


def test_the_bodys_tree_is_built_once():
    body = Body.load("young")
    assert body.tree is body.tree
    assert len(body.tree.triangle) == 2 * len(body.triangles) - 1
