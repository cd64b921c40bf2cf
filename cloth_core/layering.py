"""Start positions of panels that are in each other's way, and of garments that are worn over others.

Panels are flat at the start, so how far one has to go is known at once: the height of the other one above its plane,
where the two lie over each other. The inner panel stays, the outer one moves straight out.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy
from shapely import get_coordinates as coordinates_of

from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_pairs
from cloth_core.pair_contacts import CLOTH_VERTEX
from cloth_core.self_contact import SelfContact

__all__ = ["separate_panels"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Panels face the same way up to this cosine (60 degrees).
_FACING = 0.5
_PARALLEL = 0.999
_LEAST_MOVE = 1e-6  # m
_FARTHEST = 1.0  # m
# Panels nearer than this lie on each other [m], and points nearer than this touch: contact could not keep them apart.
_ON_EACH_OTHER = 1e-4
_TOUCHING = 1e-6
_ROUNDS = 8


def separate_panels(garment: Garment, gap: float) -> Garment:
    """Move panels outwards along their normals until none crosses another and outer garments are outside inner ones.

    A panel of a later garment ends at least `gap` [m] outside every panel of an earlier garment that faces the same way
    and that it covers. Panels that cross, touch or lie on each other are moved apart by the shorter way; of two
    garments it is the outer one that moves. Seams that join two panels do not count as crossing.

    Args:
        garment: at its start; garments that were joined, innermost first.
        gap: between panels that were moved [m].

    Returns:
        The garment, with a warning for each panel that was moved and for each that could not be, naming the panels.
    """
    layers = np.asarray(garment.layer_of_panel or [0] * len(garment.panel_names))
    count = len(garment.panel_names)
    shift = np.zeros(count)
    reasons: dict[int, set[int]] = defaultdict(set)
    start = garment.start
    stuck: set[tuple[int, int]] = set()
    crossing: list[tuple[int, int]] = []
    for _ in range(_ROUNDS):
        panels = [_FlatPanel.of(garment, start, k) for k in range(count)]
        # A later panel meets the earlier ones where they have gone to in this round.
        wanted = np.zeros(count)
        for outer in range(count):
            for inner in range(outer):
                if layers[outer] == layers[inner]:
                    continue
                needed = panels[outer].height_of_covered(panels[inner]) + wanted[inner] + gap
                if panels[inner].normal @ panels[outer].normal > _FACING and needed > _LEAST_MOVE:
                    wanted[outer] = max(wanted[outer], needed)
                    reasons[outer].add(inner)
        if not wanted.any():
            crossing = _in_the_way(garment, start, panels)
            for one, other in crossing:
                ways = {
                    k: panels[k].height_of_near(panels[m], garment.spacing) + gap
                    for k, m in ((one, other), (other, one))
                    if layers[k] >= layers[m]
                }
                mover = min(sorted(ways, reverse=True), key=lambda k: ways[k])
                if shift[mover] + ways[mover] > _FARTHEST:
                    stuck.add((one, other))
                    continue
                wanted[mover] = max(wanted[mover], ways[mover])
                reasons[mover].add(other if mover == one else one)
        if not wanted.any():
            break
        shift += wanted
        start = (
            garment.start + shift[garment.panel_of_particle, None] * (garment.panel_normals[garment.panel_of_particle])
        )
    else:
        crossing = _in_the_way(garment, start, [_FlatPanel.of(garment, start, k) for k in range(count)])
    stuck |= set(crossing)
    if not shift.any() and not stuck:
        return garment
    names = garment.panel_names
    lines = [
        f"panel '{names[k]}': starts across or behind {_listed([names[m] for m in sorted(reasons[k])])}; "
        f"moved {1000 * shift[k]:.0f} mm outwards"
        for k in np.flatnonzero(shift).tolist()
    ]
    lines += [
        f"panel '{names[one]}': starts across panel '{names[other]}' and cannot be moved clear of it within "
        f"{_FARTHEST:g} m; place the panels apart"
        for one, other in sorted(stuck)
    ]
    return replace(garment, start=start, warnings=(*garment.warnings, *lines))


class _FlatPanel(NamedTuple):
    """A panel in the plane of its start.

    Attributes:
        origin: a point of it [m], (3,); axes: two directions in the plane and the normal as rows, (3, 3).
        particles: [m], (n, 3); outline: of them, in loop order [m], (k, 3); shape: the outline in the plane's axes.
    """

    origin: Floats
    axes: Floats
    particles: Floats
    outline: Floats
    shape: Polygon

    @classmethod
    def of(cls, garment: Garment, start: Floats, k: int) -> _FlatPanel:
        normal = garment.panel_normals[k] / np.linalg.norm(garment.panel_normals[k])
        helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
        across = np.cross(normal, helper)
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(normal, across), normal])
        particles = start[garment.panel_of_particle == k]
        outline = start[garment.outline[k]]
        origin = particles.mean(axis=0)
        return cls(origin, axes, particles, outline, _polygon((outline - origin) @ axes.T))

    @property
    def normal(self) -> Floats:
        return np.asarray(self.axes[2])

    def height_of_covered(self, other: _FlatPanel) -> float:
        """How far another flat panel stands out of this one's plane where the two overlap [m]; -inf if nowhere."""
        upright = float(self.axes[2] @ other.axes[2])
        if abs(upright) < 1e-6:
            return -np.inf
        overlap = self.shape.intersection(_polygon((other.outline - self.origin) @ self.axes.T))
        if overlap.area < 1e-8:
            return -np.inf
        # The other plane's height over a point of this one; largest at a corner of the overlap.
        point = coordinates_of(overlap)
        slope = self.axes[:2] @ other.axes[2]
        above = float((other.origin - self.origin) @ other.axes[2])
        return float(((above - point @ slope) / upright).max())

    def height_of_near(self, other: _FlatPanel, reach: float) -> float:
        """How far particles of another panel over this one, or within reach [m] of it, stand out of its plane [m]."""
        local = (other.particles - self.origin) @ self.axes.T
        near = contains_xy(self.shape.buffer(2.0 * reach), local[:, 0], local[:, 1])
        return max(float(local[near, 2].max(initial=0.0)), 0.0)

    def lies_on(self, other: _FlatPanel, distance: float) -> bool:
        """Whether both are in one plane, up to a distance [m], and cover each other somewhere."""
        if abs(float(self.axes[2] @ other.axes[2])) < _PARALLEL:
            return False
        if abs(float((other.origin - self.origin) @ self.axes[2])) > distance:
            return False
        overlap = self.shape.intersection(_polygon((other.outline - self.origin) @ self.axes.T))
        return bool(overlap.area > 1e-6)


def _polygon(outline: Floats) -> Polygon:
    return Polygon(outline[:, :2]).buffer(0.0)


def _in_the_way(garment: Garment, start: Floats, panels: list[_FlatPanel]) -> list[tuple[int, int]]:
    """Pairs of panels, lower index first, that cross, touch or lie on each other."""
    edges, crossings = self_crossing_pairs(start, garment.triangles, garment.merged_indices)
    one = garment.panel_of_particle[edges[crossings[:, 0], 0]]
    other = garment.panel_of_triangle[crossings[:, 1]]
    pairs = {(min(a, b), max(a, b)) for a, b in zip(one.tolist(), other.tolist(), strict=True) if a != b}
    no_room = np.full(garment.particle_count, np.inf)
    touching = SelfContact(garment.triangles, garment.merged_indices, no_room, _TOUCHING).candidates(start, 0.0)[0]
    one = garment.panel_of_particle[touching[:, 1]]
    other = garment.panel_of_particle[np.where(touching[:, 0] == CLOTH_VERTEX, touching[:, 2], touching[:, 3])]
    pairs |= {(min(a, b), max(a, b)) for a, b in zip(one.tolist(), other.tolist(), strict=True) if a != b}
    for a in range(len(panels)):
        for b in range(a + 1, len(panels)):
            if (a, b) not in pairs and panels[a].lies_on(panels[b], _ON_EACH_OTHER):
                pairs.add((a, b))
    return sorted(pairs)


def _listed(names: list[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:4])
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return f"panel {shown}{more}" if len(names) == 1 else f"panels {shown}{more}"
