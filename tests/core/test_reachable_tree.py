"""A body's tree that is cut to where the cloth is finds what the whole one finds, in the same order."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, placed, sheet

from cloth_core.aabb_tree import AabbTree, build_tree, overlapping_pairs
from cloth_core.fabric import Fabric
from cloth_core.reachable_tree import ReachableTree
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

POPLIN = Fabric.preset("cotton_poplin")


def leaves(tree: AabbTree) -> set[int]:
    """Triangles in the leaves that can be come to from the root."""
    found, waiting = set(), [0]
    while waiting:
        node = waiting.pop()
        if tree.triangle[node] >= 0:
            found.add(int(tree.triangle[node]))
        elif tree.right[node] > 0:
            waiting += [int(tree.right[node]), node + 1]
    return found


def pairs_of(body: AabbTree, cloth: AabbTree) -> np.ndarray:
    pairs = np.zeros((100_000, 2), dtype=np.int32)
    return pairs[: overlapping_pairs(body, cloth, pairs)]


def scattered(seed: int, count: int, centre: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = centre + size * rng.uniform(-1, 1, (count, 1, 3)) + 0.1 * rng.standard_normal((count, 3, 3))
    return x.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(6))
def test_the_same_pairs_in_the_same_order(seed):
    x, triangles = scattered(seed, 1000, 0.0, 2.0)
    whole, cut = build_tree(x, triangles), ReachableTree()
    for centre in (0.0, 0.0, 0.05, 0.9, -1.5, -1.45, 5.0):  # near what it was cut to before, elsewhere, and nowhere
        cloth = build_tree(*scattered(seed + 100, 50, centre, 0.3))
        tree = cut.of(whole, cloth.lower[0], cloth.upper[0])
        np.testing.assert_array_equal(pairs_of(tree, cloth), pairs_of(whole, cloth))
    assert len(pairs_of(whole, build_tree(*scattered(seed + 100, 50, 0.0, 0.3)))) > 0


@pytest.mark.parametrize("seed", range(4))
def test_no_other_triangles_are_in_it_than_those_near_the_cloth(seed):
    x, triangles = scattered(seed, 300, 0.0, 2.0)
    whole, cut = build_tree(x, triangles), ReachableTree()
    lower, upper = np.array([-0.4, -0.2, 0.1]), np.array([0.5, 0.3, 0.6])
    cut.of(whole, lower, upper)
    kept = leaves(cut.of(whole, lower, upper))
    corners = x[triangles]
    within = lambda room: (  # noqa: E731
        (corners.min(axis=1) <= upper + room).all(axis=1) & (corners.max(axis=1) >= lower - room).all(axis=1)
    )
    assert set(np.flatnonzero(within(0.0))) <= kept <= set(np.flatnonzero(within(0.11)))
    assert 0 < len(kept) < 100


def test_one_that_comes_once_is_searched_whole():
    x, triangles = scattered(1, 50, 0.0, 2.0)
    cut, near = ReachableTree(), (np.zeros(3), np.full(3, 0.1))
    for _ in range(3):
        tree = build_tree(x, triangles)
        assert cut.of(tree, *near) is tree
    assert cut.of(tree, *near) is not tree


def test_a_simulation_searches_no_triangle_out_of_reach_until_cloth_comes_there():
    upper, lower = (trimesh.creation.icosphere(2, radius=0.1) for _ in range(2))
    lower.apply_translation([0.0, 0.0, -0.6])
    body = body_of(trimesh.util.concatenate([upper, lower]))
    height = body.vertices[body.triangles].mean(axis=1)[:, 2]
    start = placed(sheet(0.2, 0.2, 0.05), move=[0.0, 0.0, -0.15])  # below one ball, above the other
    simulation = Simulation(Scene(garment=start, body=body, fabric=POPLIN))
    simulation.advance(0.1)
    reached = leaves(simulation.model.contact.body.reachable.tree)
    assert not (height[list(reached)] < -0.5).any()
    assert simulation.settle().settled
    reached = leaves(simulation.model.contact.body.reachable.tree)
    assert (height[list(reached)] < -0.5).any()
    assert not (height[list(reached)] > -0.1).any()
