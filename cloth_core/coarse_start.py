"""A drape of a coarser mesh as the start of a finer one.

The way to rest costs as much as spacing^-3: twice as fine is four times as many particles in steps half as long. Most
of that way, sewing and falling into place, a mesh of twice the spacing goes as well; the fine one then only has to find
its own folds. Each fine particle starts where the coarse cloth lies; seam points by their place along the seam, so that
the two edges of a seam still meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.body_crossings import BodyCrossings
from cloth_core.garment import Garment

__all__ = ["Interpolation", "interpolation_between", "pushed_out_of_body"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Triangles with the nearest centres, among which the one that holds a point is looked for.
_NEAREST = 12
# Times that cloth which cuts through the body may be moved outwards before the start is given up.
_ROUNDS = 6


@dataclass(frozen=True)
class Interpolation:
    """Places of fine particles on a coarse mesh.

    Attributes:
        corners: coarse particles, unsewn numbering, shape (n, 3).
        weights: of each of them, shape (n, 3); rows add up to 1.
    """

    corners: Ints
    weights: Floats

    def __call__(self, x: Floats) -> Floats:
        """Fine values (n, 3) from coarse ones (m, 3)."""
        return np.asarray(np.einsum("nk,nka->na", self.weights, x[self.corners]))


def interpolation_between(coarse: Garment, fine: Garment) -> Interpolation:
    """Places of a fine garment's particles on the coarse mesh of the same patterns, by their rest shapes."""
    from scipy.spatial import KDTree

    corners = np.zeros((fine.particle_count, 3), dtype=np.int32)
    weights = np.zeros((fine.particle_count, 3))
    for panel in range(len(fine.panel_names)):
        mine = np.flatnonzero(fine.panel_of_particle == panel)
        triangles = coarse.triangles[coarse.panel_of_triangle == panel]
        corner = coarse.rest[triangles]
        count = min(_NEAREST, len(triangles))
        _, near = KDTree(corner.mean(axis=1)).query(fine.rest[mine], k=count)
        near = near.reshape(len(mine), count)
        shares = _barycentric(fine.rest[mine][:, None], corner[near])
        best = np.argmax(shares.min(axis=2), axis=1)
        rows = np.arange(len(mine))
        # What lies outside, beside an edge that the coarse mesh cuts short, starts on that edge.
        inside = np.maximum(shares[rows, best], 0.0)
        corners[mine] = triangles[near[rows, best]]
        weights[mine] = inside / inside.sum(axis=1, keepdims=True)
    for seam, coarse_seam in zip(fine.seams, coarse.seams, strict=True):
        place = np.linspace(0.0, len(coarse_seam.first) - 1.0, len(seam.first))
        before = np.minimum(place.astype(np.int64), len(coarse_seam.first) - 2)
        share = place - before
        for points, of in ((seam.first, coarse_seam.first), (seam.second, coarse_seam.second)):
            corners[points] = np.stack([of[before], of[before + 1], of[before]], axis=1)
            weights[points] = np.stack([1.0 - share, share, np.zeros(len(share))], axis=1)
    return Interpolation(corners, weights)


def pushed_out_of_body(x: Floats, triangles: Ints, body: Body, step: float) -> Floats:
    """Positions [m], (n, 3), where sides and triangles that meet the body are moved out of it, by a step [m] at a time.

    A fine mesh cuts across the creases of the coarse one on which it starts, sometimes by more than the distance at
    which that lay from the body. What is still inside after some rounds is left there.
    """
    corner = body.vertices[body.triangles]
    areas = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = _unit(areas)
    for _ in range(_ROUNDS):
        edges, pairs, body_edges, body_pairs = BodyCrossings.of(x, triangles, body)
        if len(pairs) + len(body_pairs) == 0:
            break
        way = np.zeros_like(x)
        for end in range(2):
            np.add.at(way, edges[pairs[:, 0], end], normals[pairs[:, 1]])
        if len(pairs) == 0:
            # Tips of the body in the middle of triangles, of which the sides have taken most out: they lift all of it.
            at_vertices = np.zeros_like(body.vertices)
            for k in range(3):
                np.add.at(at_vertices, body.triangles[:, k], areas)
            out = _unit(at_vertices[body_edges[body_pairs[:, 0]]].sum(axis=1))
            for k in range(3):
                np.add.at(way, triangles[body_pairs[:, 1], k], out)
        length = np.linalg.norm(way, axis=1, keepdims=True)
        x = x + step * way / np.maximum(length, 1e-12)
    return x


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def _barycentric(p: Floats, corner: Floats) -> Floats:
    """Barycentric coordinates (n, k, 3) of points (n, 1, 2) in triangles (n, k, 3, 2)."""
    a, u, w = corner[..., 0, :], corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :]
    d = p - a
    whole = u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]
    second = (d[..., 0] * w[..., 1] - d[..., 1] * w[..., 0]) / whole
    third = (u[..., 0] * d[..., 1] - u[..., 1] * d[..., 0]) / whole
    return np.stack([1.0 - second - third, second, third], axis=-1)
