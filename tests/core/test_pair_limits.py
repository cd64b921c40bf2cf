"""Triangles that lie on top of each other, in body or garment, are refused before their pairs take up the memory."""

import numpy as np
import pytest

from cloth_core.aabb_tree import build_tree, overlapping_pairs
from cloth_core.body import Body
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.errors import SceneError
from cloth_core.self_contact import SelfContact


def heap_of_triangles(count):
    """Large triangles all over the place, each of which passes through nearly all others."""
    rng = np.random.default_rng(1)
    return rng.uniform(-1.0, 1.0, (3 * count, 3)), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def test_a_heap_of_triangles_is_refused():
    vertices, triangles = heap_of_triangles(20_000)
    search = Contact(triangles, BodyContact(Body.from_arrays(vertices, triangles, "heap"), 0.003))
    with pytest.raises(SceneError, match=r"^body 'heap': too many of its triangles lie at the same place, more than"):
        search.search(vertices, 0.001)


def test_the_search_ends_soon_after_the_limit():
    vertices, triangles = heap_of_triangles(300)
    tree = build_tree(vertices, triangles)
    none = np.zeros((0, 2), dtype=np.int32)
    assert overlapping_pairs(tree, tree, none) > 20_000
    assert overlapping_pairs(tree, tree, none, 1000) == 1001


def layers(count):
    """So many squares of 8 x 8 cells of 1 cm at the same place: search for their contacts, and positions."""
    row = np.arange(9) / 100
    square = np.stack([*np.meshgrid(row, row), np.zeros((9, 9))], axis=-1).reshape(-1, 3)
    corner = (9 * np.arange(8)[:, None] + np.arange(8)).ravel()
    cells = np.concatenate(
        [np.stack([corner, corner + 1, corner + 10], 1), np.stack([corner, corner + 10, corner + 9], 1)]
    )
    triangles = np.concatenate([cells + 81 * layer for layer in range(count)]).astype(np.int32)
    x = np.tile(square, (count, 1))
    return SelfContact(triangles, np.arange(len(x)), np.full(len(x), 0.01), 0.001), x


def test_hundreds_of_layers_at_the_same_place_are_refused():
    search, x = layers(100)
    with pytest.raises(SceneError, match=r"^garment: too much of it lies at the same place, more than 2660000 pairs"):
        search.candidates(x, 0.001)
    search, x = layers(3)
    rows, _, _ = search.candidates(x, 0.001)
    assert len(rows) > 1000
