"""A body whose triangles lie on top of each other is refused before their pairs with the cloth take up the memory."""

import numpy as np
import pytest

from cloth_core.aabb_tree import build_tree, overlapping_pairs
from cloth_core.body import Body
from cloth_core.errors import SceneError
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene


def heap_of_triangles(count):
    """Large triangles all over the place, each of which passes through nearly all others."""
    rng = np.random.default_rng(1)
    return rng.uniform(-1.0, 1.0, (3 * count, 3)), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def test_a_heap_of_triangles_is_refused():
    body = Body.from_arrays(*heap_of_triangles(20_000), "heap")
    with pytest.raises(SceneError, match=r"^body 'heap': too many of its triangles lie at the same place, more than"):
        Scene.build(Pattern.load("skirt"), body, quality="draft")


def test_the_search_ends_soon_after_the_limit():
    vertices, triangles = heap_of_triangles(300)
    tree = build_tree(vertices, triangles)
    none = np.zeros((0, 2), dtype=np.int32)
    assert overlapping_pairs(tree, tree, none) > 20_000
    assert overlapping_pairs(tree, tree, none, 1000) == 1001
