"""Start positions nearer to the body, for panels that a pattern puts far away from it.

Seams pull at the edges of a panel only. On a short way the body behind the panel holds its middle, so that the edges go
round the body; on a long one the panel folds over before it gets there, and the points of a shoulder come down in front
of and behind the body instead of on it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import AabbTree, build_tree
from cloth_core.body import Body
from cloth_core.garment import Garment
from cloth_core.mesh_distance import distances_to_mesh
from cloth_core.placement import crosses_more

__all__ = ["brought_near"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# A panel that starts farther from the body than the first is brought as near as the second [m].
_FAR, _NEAR = 0.09, 0.04
# Panels that are nearer to each other than this and face the same way move as one; others keep this distance [m].
_TOGETHER = 0.003
_FACING = 0.99
# A shorter step than this ends the way [m]; as many steps are tried.
_LEAST_STEP = 0.0005
_STEPS = 200


def brought_near(garment: Garment, body: Body) -> Garment:
    """Move sewn panels that start more than 9 cm away from the body straight inwards to 4 cm.

    Each goes against its normal, the nearest to the body first, only as far as it meets nothing, and with the panels
    that it touches at the start. No step is longer than what is free around the panel: nothing is passed through, and
    what was outside of another panel stays outside. A panel does not get behind one that it is sewn to and that faces
    the same way either, and where they cover each other it stays as far in front of it: a collar before a bodice.
    """
    sewn_to: dict[int, set[int]] = {}
    for seam in garment.seams:
        one, other = (int(garment.panel_of_particle[side[0]]) for side in (seam.first, seam.second))
        sewn_to.setdefault(one, set()).add(other)
        sewn_to.setdefault(other, set()).add(one)
    if not sewn_to:
        return garment
    parts = [_Part.of(garment, k) for k in range(len(garment.panel_names))]
    groups = [g for g in _groups(garment, parts) if all(k in sewn_to for k in g)]
    distance = [min(parts[k].distance_to_body(body) for k in g) for g in groups]
    for g in np.argsort(distance, kind="stable"):
        if distance[g] <= _FAR:
            continue
        own = groups[g]
        inwards = -np.mean([garment.panel_normals[k] for k in own], axis=0)
        inwards /= np.linalg.norm(inwards)
        others = [part for k, part in enumerate(parts) if k not in own]
        behind = _behind(garment, own, sewn_to, inwards)
        nearest = distance[g]
        for _ in range(_STEPS):
            room = min([nearest - _NEAR, *(parts[k].distance_to(p, nearest) - _TOGETHER for k in own for p in others)])
            room = min([room, *(parts[k].height_above(parts[m], -inwards) - least for k, m, least in behind)])
            if room < _LEAST_STEP:
                break
            moved = [parts[k].moved(room * inwards) for k in own]
            before, nearest = nearest, min(part.distance_to_body(body) for part in moved)
            if nearest >= before:  # it would go past
                break
            for k, part in zip(own, moved, strict=True):
                parts[k] = part
    start = garment.start.copy()
    for k, part in enumerate(parts):
        start[garment.panel_of_particle == k] = part.x
    if (start == garment.start).all() or crosses_more(garment, start, body):
        return garment
    return replace(garment, start=start)


def _behind(garment: Garment, own: list[int], sewn_to: dict[int, set[int]], inwards: Floats) -> list[_Limit]:
    """How far panels must stay in front of those behind them to which they are sewn and that face the same way.

    As far as at the start where they cover each other, else not at all.
    """
    limits = []
    parts = [_Part.of(garment, k) for k in range(len(garment.panel_names))]
    for k in own:
        for m in sorted(sewn_to[k].difference(own)):
            height = parts[k].height_above(parts[m], -inwards)
            if height < 0.0 or garment.panel_normals[k] @ garment.panel_normals[m] < _FACING:
                continue
            flat = [x - np.outer(x @ inwards, inwards) for x in (parts[k].x, parts[m].x)]
            low, high = np.maximum(*(f.min(axis=0) for f in flat)), np.minimum(*(f.max(axis=0) for f in flat))
            limits.append(_Limit(k, m, height if (low <= high + _TOGETHER).all() else 0.0))
    return limits


class _Limit(NamedTuple):
    """Least height [m] of a panel above one behind it."""

    panel: int
    other: int
    height: float


class _Part(NamedTuple):
    """A panel by itself: positions (n, 3) [m], triangles (m, 3), its tree of boxes."""

    x: Floats
    triangles: Ints
    tree: AabbTree

    @classmethod
    def of(cls, garment: Garment, k: int) -> _Part:
        own = np.flatnonzero(garment.panel_of_particle == k)
        local = np.zeros(garment.particle_count, dtype=np.int32)
        local[own] = np.arange(len(own))
        x = np.ascontiguousarray(garment.start[own])
        triangles = local[garment.triangles[garment.panel_of_triangle == k]]
        return cls(x, triangles, build_tree(x, triangles))

    def moved(self, way: Floats) -> _Part:
        x = self.x + way
        return _Part(x, self.triangles, build_tree(x, self.triangles))

    def height_above(self, other: _Part, outwards: Floats) -> float:
        """How far this panel's middle is in front of another's [m]."""
        return float((self.x.mean(axis=0) - other.x.mean(axis=0)) @ outwards)

    def distance_to_body(self, body: Body) -> float:
        """Distance [m] of corners of the one from the surface of the other, whichever is less."""
        ours = float(distances_to_mesh(self.x, body.vertices, body.triangles, body.tree).min())
        near = self._near(body.vertices, ours)
        return min(ours, float(distances_to_mesh(near, self.x, self.triangles, self.tree).min(initial=np.inf)))

    def distance_to(self, other: _Part, reach: float) -> float:
        """The same for another panel; anything above reach [m] may stand for what is farther away."""
        theirs = distances_to_mesh(self._near(other.x, reach + _TOGETHER), self.x, self.triangles, self.tree)
        ours = distances_to_mesh(other._near(self.x, reach + _TOGETHER), other.x, other.triangles, other.tree)
        return float(min(theirs.min(initial=np.inf), ours.min(initial=np.inf)))

    def _near(self, points: Floats, reach: float) -> Floats:
        """Those of points (k, 3) [m] that lie in the box around the panel, widened by reach [m]."""
        low, high = self.x.min(axis=0) - reach, self.x.max(axis=0) + reach
        return np.ascontiguousarray(points[((points >= low) & (points <= high)).all(axis=1)])


def _groups(garment: Garment, parts: list[_Part]) -> list[list[int]]:
    """Panels that touch at the start and face the same way, each in one list."""
    of = list(range(len(parts)))
    for a in range(len(parts)):
        for b in range(a):
            if of[a] == of[b] or float(garment.panel_normals[a] @ garment.panel_normals[b]) < _FACING:
                continue
            if parts[a].distance_to(parts[b], _TOGETHER) < _TOGETHER:
                of = [of[b] if k == of[a] else k for k in of]
    return [[k for k, group in enumerate(of) if group == g] for g in sorted(set(of))]
