"""Malformed bodies: what is wrong with each, its vertices and triangles, and what the message must say about it."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["MALFORMED", "TETRAHEDRON"]

_X = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
_FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
TETRAHEDRON = (_X, _FACES)


def _with(vertex: int, value: float) -> list[list[float]]:
    changed = [list(v) for v in _X]
    changed[vertex][1] = value
    return changed


MALFORMED: dict[str, tuple[Any, Any, str]] = {
    "not a number": (_with(2, float("nan")), _FACES, "vertex 2: [0.0, nan, 0.0] is not finite"),
    "infinite": (_with(3, float("inf")), _FACES, "vertex 3: [0.0, inf, 1.0] is not finite"),
    "minus infinity": (_with(0, float("-inf")), _FACES, "vertex 0: [0.0, -inf, 0.0] is not finite"),
    "not a number in an unused vertex": ([*_X, [0.0, 0.0, float("nan")]], _FACES, "vertex 4"),
    "index beyond the vertices": (_X, [[0, 1, 2], [1, 2, 4]], "triangle 1: vertex 4 does not exist, there are 4"),
    "negative index": (_X, [[0, 1, 2], [1, 2, 3], [0, -1, 2]], "triangle 2: vertex -1 does not exist"),
    "huge index": (_X, [[0, 1, 2**31]], "triangle 0: vertex 2147483648 does not exist"),
    "index beyond 64 bits": (_X, [[0, 1, 2**70]], "triangle"),
    "no vertices": (np.zeros((0, 3)), _FACES, "vertices have shape (0, 3)"),
    "no triangles": (_X, np.zeros((0, 3), dtype=int), "triangles have shape (0, 3)"),
    "nothing at all": ([], [], "vertices have shape (0,)"),
    "vertices in the plane": ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "vertices have shape (3, 2); give (n, 3)"),
    "one flat list of coordinates": (list(range(12)), _FACES, "vertices have shape (12,)"),
    "quads": (_X, [[0, 1, 2, 3]], "triangles have shape (1, 4); give (m, 3)"),
    "one flat list of indices": (_X, [0, 1, 2], "triangles have shape (3,)"),
    "ragged triangles": (_X, [[0, 1, 2], [0, 1]], "triangles"),
    "ragged vertices": ([[0, 0, 0], [1, 0], [0, 1, 0]], [[0, 1, 2]], "vertices"),
    "fractional indices": (_X, [[0.0, 1.0, 2.5]], "triangle indices are float64; give whole numbers"),
    "truth values for indices": (_X, [[True, False, True]], "triangle indices are bool"),
    "text for coordinates": ([["a", "b", "c"]] * 3, [[0, 1, 2]], "vertices"),
    "text for indices": (_X, [["0", "1", "2"]], "triangle indices"),
    "nothing for coordinates": ([[None, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "vert"),
    "all triangles a line": ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "no triangle with an area is left"),
    "all triangles a point": ([[1, 1, 1]] * 3, [[0, 1, 2]], "no triangle with an area is left"),
    "all corners the same": (_X, [[1, 1, 1], [2, 2, 2]], "no triangle with an area is left"),
    "two corners the same": (_X, [[0, 1, 1], [2, 3, 2]], "no triangle with an area is left"),
}
