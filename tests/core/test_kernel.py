"""Kernels that borrow arrays: references are not counted in them, so none may make an array or hand one out."""

import ast
import importlib
import pkgutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

import cloth_core
from cloth_core.aabb_tree import build_tree
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.mesh_distance import distances_to_mesh
from cloth_core.pair_list import PairRoom

NUMBERS = {"None", "int", "float", "bool"}


def borrowing_kernels() -> Iterator[tuple[str, ast.FunctionDef, Dispatcher]]:
    """File name, definition and compiled function of each of them."""
    for module in pkgutil.iter_modules(cloth_core.__path__):
        source = Path(cloth_core.__path__[0]) / f"{module.name}.py"
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and any(
                isinstance(d, ast.Name) and d.id == "borrowing_kernel" for d in node.decorator_list
            ):
                yield module.name, node, getattr(importlib.import_module(f"cloth_core.{module.name}"), node.name)


def test_borrowing_kernels_return_nothing_but_numbers():
    found = list(borrowing_kernels())
    assert len(found) > 50
    for module, node, function in found:
        assert function.targetoptions["_nrt"] is False
        assert node.returns is not None
        names = {ast.unparse(part) for part in ast.walk(node.returns) if isinstance(part, ast.Name | ast.Constant)}
        lanes = module == "near_distances"  # eight numbers at once, for which there is no type hint
        assert names <= NUMBERS | {"tuple"} | ({"Any"} if lanes else set()), f"{module}.{node.name}"


def test_borrowing_kernel_that_makes_an_array_does_not_compile():
    def makes(count: int) -> float:
        return float(np.zeros(count).sum())

    # It cannot be cached, since it is not in a module of the package.
    makes.__module__ = "cloth_core.kernel"
    with pytest.raises(NumbaError, match="Only accept returning of array passed"):
        borrowing_kernel(makes)(3)


def test_kernel_that_makes_arrays_compiles_when_a_borrowing_one_calls_it_first():
    def largest(count: int) -> float:
        return float(np.arange(count).max())

    def twice(count: int) -> float:
        return 2.0 * inner(count)

    largest.__module__ = twice.__module__ = "cloth_core.kernel"
    inner = kernel(largest)
    assert borrowing_kernel(twice)(8) == 14.0


def test_rows_that_a_kernel_passes_on_keep_their_array_alive_and_let_go_of_it():
    points = np.random.default_rng(3).random((500, 3))
    triangles = np.arange(30, dtype=np.int32).reshape(10, 3)
    tree = build_tree(points, triangles)
    before = sys.getrefcount(points), sys.getrefcount(triangles), sys.getrefcount(tree.lower)
    first = distances_to_mesh(points, points, triangles, tree)
    for _ in range(5):
        np.testing.assert_array_equal(distances_to_mesh(points, points, triangles, tree), first)
    assert (sys.getrefcount(points), sys.getrefcount(triangles), sys.getrefcount(tree.lower)) == before


def test_room_for_pairs_grows_as_asked_and_keeps_what_was_found():
    room = PairRoom(7, columns=3)
    expected = np.zeros((0, 3), dtype=np.int32)
    rng = np.random.default_rng(5)
    while len(expected) < 100_000:
        room.make_room()
        assert len(room.pairs) - room.count[0] >= 7
        # As many as the kernels write before they look again: until there is no room for seven more.
        more = rng.integers(0, 1000, (len(room.pairs) - room.count[0] - 6, 3)).astype(np.int32)
        room.pairs[room.count[0] : room.count[0] + len(more)] = more
        room.count[0] += len(more)
        expected = np.concatenate([expected, more])
    np.testing.assert_array_equal(room.found, expected)
