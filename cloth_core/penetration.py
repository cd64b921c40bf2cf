"""How deep cloth is inside a body, between its particles too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.body_crossings import BodyCrossings

__all__ = ["max_penetration"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Parts into which each side of a cloth triangle that a body passes through is cut.
_PARTS = 8


def max_penetration(x: Floats, triangles: Ints, body: Body, crossings: BodyCrossings | None = None) -> float:
    """Depth of the deepest point of the cloth inside the body [m]; 0 if none is.

    Looked at are all particles, and of the triangles that the surface of the body passes through (exact tests both
    ways) a grid of points and the middle of where the body comes through: a tip between the particles is seen as well.

    Args:
        x: positions of the particles [m], (n, 3).
        triangles: corner indices, (m, 3).
        body: what they should be outside of.
        crossings: of both, if somebody has looked for them already.
    """
    if len(x) == 0:
        return 0.0
    depth = -float(body.signed_distance(x).min())
    crossings = BodyCrossings.of(x, triangles, body) if crossings is None else crossings
    side = np.zeros(len(x), dtype=bool)
    side[crossings.cloth_sides[crossings.through_body[:, 0]]] = True
    pierced = side[triangles].sum(axis=1) >= 2
    pierced[crossings.through_cloth[:, 1]] = True
    if pierced.any():
        steps = np.arange(_PARTS + 1)
        grid = np.array([(i, j, _PARTS - i - j) for i in steps for j in steps if i + j <= _PARTS]) / _PARTS
        points = np.einsum("gk,tkd->tgd", grid, x[triangles[pierced]]).reshape(-1, 3)
        middles = _middles(x[triangles], body.vertices[crossings.body_sides], crossings.through_cloth)
        depth = max(depth, -float(body.signed_distance(np.concatenate([points, middles])).min()))
    return max(depth, 0.0)


def _middles(corners: Floats, edges: Floats, pairs: Ints) -> Floats:
    """For each triangle (m, 3, 3) that edges (e, 2, 3) pass through the mean of the points where they do, (k, 3)."""
    edge, triangle = pairs[:, 0], pairs[:, 1]
    a, b, c = (corners[triangle, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    start, end = (((edges[edge, k] - a) * normal).sum(axis=1) for k in range(2))
    apart = np.where(start == end, 1.0, start - end)
    share = np.clip(start / apart, 0.0, 1.0)[:, None]
    places = edges[edge, 0] + share * (edges[edge, 1] - edges[edge, 0])
    found, group = np.unique(triangle, return_inverse=True)
    count = np.bincount(group.ravel(), minlength=len(found))
    sums = [np.bincount(group.ravel(), weights=places[:, k], minlength=len(found)) for k in range(3)]
    return np.asarray(np.stack(sums, axis=1) / np.maximum(count, 1)[:, None])
