"""Start positions: a flat panel that touches the body is moved straight out until it is clear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cloth_core.aabb_tree import DEPTH, AabbTree, build_tree, next_leaf
from cloth_core.body import Body
from cloth_core.body_crossings import BodyCrossings
from cloth_core.errors import SceneError
from cloth_core.garment import Garment
from cloth_core.intersections import crossing_edges, self_crossing_edges
from cloth_core.kernel import kernel
from cloth_core.mesh_distance import distances_to_mesh

__all__ = ["below_body_warnings", "clear_of_body", "crosses_more"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_STEP = 0.01  # m
_FARTHEST = 1.0  # m
_BELOW_SHARE = 0.1  # of a garment's area below the body from which on it is warned about


def clear_of_body(garment: Garment, body: Body, gap: float) -> Garment:
    """Move each panel along its normal until it is clear of the body: no nearer than gap [m] and not inside.

    A panel that is sewn to anything goes outwards, however much nearer the other side is: a sleeve has one panel in
    front of the arm and one behind it, and must not end up with both on one side. Inwards is tried only where outwards
    is not clear within 1 m. A single sheet goes where it is nearer.

    Raises:
        SceneError: a panel is not clear within 1 m either way.
    """
    start = garment.start.copy()
    warnings = list(garment.warnings)
    sewn = {int(garment.panel_of_particle[side[0]]) for seam in garment.seams for side in (seam.first, seam.second)}
    for k, name in enumerate(garment.panel_names):
        own = np.flatnonzero(garment.panel_of_particle == k)
        local = np.full(len(start), -1, dtype=np.int32)
        local[own] = np.arange(len(own))
        triangles = local[garment.triangles[garment.panel_of_triangle == k]]
        normal = garment.panel_normals[k]
        nearby = _Surroundings(body, garment.start[own], normal)
        shift = next(
            (s for s in _shifts(k in sewn) if nearby.is_clear(garment.start[own] + s * normal, triangles, gap)), None
        )
        if shift is None:
            raise SceneError(
                f"panel '{name}': lies inside the body and is not clear of it within {_FARTHEST:g} m; "
                "place it in front of or behind the body"
            )
        if shift != 0.0:
            start[own] += shift * normal
            side = "outwards" if shift > 0 else "inwards"
            warnings.append(f"panel '{name}': starts inside the body; moved {abs(1000 * shift):.0f} mm {side}")
    return replace(garment, start=start, warnings=tuple(warnings))


def below_body_warnings(garment: Garment, body: Body) -> tuple[str, ...]:
    """One line if a good part of a garment starts below the body's lowest point, where nothing can hold it.

    A pattern says nothing of the body that it was drawn for. One whose origin is at the waist, for example, puts a
    garment for a body that stands on height 0 around its feet.
    """
    lowest = body.lowest
    height = garment.start[:, 2]
    share = float(garment.particle_areas[height < lowest].sum() / garment.particle_areas.sum())
    if share < _BELOW_SHARE:
        return ()
    return (
        f"{100.0 * share:.0f} % of the garment starts below body '{body.name}', up to {lowest - height.min():.2f} m "
        "below its lowest point; if the pattern has its origin elsewhere, raise the panels' translations",
    )


def crosses_more(garment: Garment, start: Floats, body: Body) -> bool:
    """Whether anything crosses at start (n, 3) [m] that did not before: sides may be nearer than any corner."""
    triangles, number = garment.triangles, garment.merged_indices
    before, after = (len(self_crossing_edges(x, triangles, number)) for x in (garment.start, start))
    return after > before or BodyCrossings.of(start, triangles, body).number > 0


def _shifts(sewn: bool) -> Iterator[float]:
    """Distances along the normal [m] in the order in which they are tried."""
    distances = [float(d) for d in np.arange(0.0, _FARTHEST, _STEP)]
    if sewn:
        yield from distances
        yield from (-d for d in distances[1:])
    else:
        yield 0.0
        for distance in distances[1:]:
            yield distance
            yield -distance


class _Surroundings:
    """The part of a body that a panel (n, 3) [m] can meet on its way along a normal."""

    def __init__(self, body: Body, panel: Floats, normal: Floats) -> None:
        self._body = body
        way = _FARTHEST * np.abs(normal) + 2.0 * _STEP
        low, high = panel.min(axis=0) - way, panel.max(axis=0) + way
        near = np.sort(_triangles_in_box(body.tree, low, high))
        used, index = np.unique(body.triangles[near], return_inverse=True)
        self._vertices = np.ascontiguousarray(body.vertices[used])
        self._triangles = index.reshape(-1, 3).astype(np.int32)
        self._tree = build_tree(self._vertices, self._triangles)

    def is_clear(self, panel: Floats, triangles: Ints, gap: float) -> bool:
        """Whether nothing of the panel is inside the body, crosses it or has a corner of it nearer than gap [m]."""
        # One point tells inside from outside for all of a panel that nothing crosses.
        if self._body.winding_number(panel[:1])[0] > 0.5:
            return False
        if len(self._triangles) == 0:
            return True
        # The distance is measured where the body's corners are near: it usually has more of them than the panel.
        if (distances_to_mesh(np.ascontiguousarray(panel), self._vertices, self._triangles, self._tree) < gap).any():
            return False
        tree = build_tree(panel, triangles)
        low, high = panel.min(axis=0) - gap, panel.max(axis=0) + gap
        close = ((self._vertices >= low) & (self._vertices <= high)).all(axis=1)
        if (distances_to_mesh(self._vertices[close], panel, triangles, tree) < gap).any():
            return False
        return not (
            len(crossing_edges(panel, triangles, self._vertices, self._triangles, self._tree))
            or len(crossing_edges(self._vertices, self._triangles, panel, triangles, tree))
        )


@kernel
def _triangles_in_box(tree: AabbTree, low: Floats, high: Floats) -> Ints:
    """Triangles whose boxes in the tree have a point in common with that from low to high, both (3,) [m]."""
    found, count = np.empty(tree.triangle.shape[0], dtype=np.int32), 0
    if found.shape[0] == 0:
        return found
    waiting = np.zeros(DEPTH, dtype=np.int32)
    triangle, left = next_leaf(tree, low, high, waiting, 1)
    while triangle >= 0:
        found[count] = triangle
        count += 1
        triangle, left = next_leaf(tree, low, high, waiting, left)
    return found[:count].copy()
