"""A sewing pattern as particles, triangles and seams: rest shape in the panels' planes, start position in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.errors import GarmentError
from cloth_core.panel_mesh import PanelMesh, mesh_panel, smallest_angles
from cloth_core.pattern import Panel, Pattern
from cloth_core.smooth_windows import Windows, windows_of

__all__ = ["Garment", "Seam", "merged_numbers", "renumbered"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_MOST_PARTICLES = 2_000_000
_SLIVER_ANGLE = math.radians(15.0)


@dataclass(frozen=True)
class Seam:
    """Two matched rows of particles that a stitch joins, end to end.

    Attributes:
        name: for messages, `panel 'front', edge 3 - panel 'back', edge 1`.
        first, second: particle indices, shape (k,); first[i] is sewn to second[i].
    """

    name: str
    first: Ints
    second: Ints


@dataclass(frozen=True)
class Garment:
    """Particles, triangles and seams of one garment, before it is sewn.

    Attributes:
        name: the pattern's name.
        rest: rest positions in the panel's own plane [m], shape (n, 2): weft along x, warp along y.
        start: start positions in space [m], z up, shape (n, 3).
        triangles: corner indices, shape (m, 3); the normal is the panel's outward normal.
        quads: whole lattice cells, shape (q, 4); their halves are the first triangles of each panel.
        in_quad: which triangles are halves of quads, shape (m,).
        rows, columns: triples of particles in line along weft and along warp, shape (k, 3).
        panel_of_particle: index into panel_names, shape (n,).
        panel_of_triangle: index into panel_names, shape (m,).
        panel_names: names in the pattern's order.
        panel_normals: outward normals of the panels at the start, shape (p, 3).
        outline: for each panel the particle indices of its outline, in loop order.
        seams: the matched stitches.
        merged_indices: for each particle the number of the one that it becomes once everything is sewn, (n,).
        spacing: lattice spacing asked for [m].
        warnings: one line each.
        layer_of_panel: which garment each panel belongs to where several are worn, the innermost first; else empty.
    """

    name: str
    rest: Floats
    start: Floats
    triangles: Ints
    quads: Ints
    in_quad: NDArray[np.bool_]
    rows: Ints
    columns: Ints
    panel_of_particle: Ints
    panel_of_triangle: Ints
    panel_names: tuple[str, ...]
    panel_normals: Floats
    outline: tuple[Ints, ...]
    seams: tuple[Seam, ...]
    merged_indices: Ints
    spacing: float
    warnings: tuple[str, ...] = field(default=())
    layer_of_panel: tuple[int, ...] = ()

    @property
    def layer_count(self) -> int:
        """How many garments are worn one over the other."""
        return 1 + max(self.layer_of_panel, default=0)

    @property
    def layer_of_particle(self) -> Ints:
        """The layer that each particle belongs to, 0 for the innermost, shape (n,)."""
        layers = np.asarray(self.layer_of_panel or [0] * len(self.panel_names), dtype=np.int32)
        return np.asarray(layers[self.panel_of_particle])

    @property
    def areas(self) -> Floats:
        """Rest area of each triangle [m^2], shape (m,)."""
        a, b, c = (self.rest[self.triangles[:, k]] for k in range(3))
        u, w = b - a, c - a
        return np.asarray(np.abs(u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / 2.0, dtype=np.float64)

    @property
    def particle_areas(self) -> Floats:
        """Area that each particle stands for [m^2], shape (n,).

        A quarter of each cell of the lattice around it, whichever way that is cut into triangles: with a third of each
        triangle, every other particle of the lattice would be twice as heavy as its neighbours. A third of any other
        triangle.
        """
        band = ~self.in_quad
        corners = np.concatenate([self.triangles[band].ravel(), self.quads.ravel()])
        a, b, _, d = self.rest[self.quads].transpose(1, 0, 2)
        cells = (b - a)[:, 0] * (d - a)[:, 1]
        share = np.concatenate([np.repeat(self.areas[band] / 3.0, 3), np.repeat(cells / 4.0, 4)])
        return np.bincount(corners, weights=share, minlength=len(self.rest)).astype(np.float64)

    @cached_property
    def windows(self) -> Windows:
        """Convex windows of the panels, for `cloth_core.smooth_windows`."""
        return windows_of(self)

    @property
    def particle_count(self) -> int:
        """Number of particles before sewing."""
        return len(self.rest)

    @classmethod
    def from_pattern(cls, pattern: Pattern, spacing: float) -> Garment:
        """Discretise a pattern (steps 1 and 2 of the paper).

        Each edge is cut into ceil(length / spacing) equal parts; both edges of a stitch take the longer one's count.

        Args:
            pattern: the checked pattern.
            spacing: distance of neighbouring particles [m].

        Raises:
            GarmentError: a panel cannot be meshed, or the garment would get too many particles.
        """
        if not (math.isfinite(spacing) and spacing > 0.0):
            raise GarmentError(f"pattern '{pattern.name}': particle spacing {spacing!r} m; give a positive length")
        expected = sum(abs(panel.area) for panel in pattern.panels.values()) / spacing**2
        if expected > _MOST_PARTICLES:
            raise GarmentError(
                f"pattern '{pattern.name}': about {expected:.0f} particles at {1000 * spacing:g} mm spacing, "
                f"at most {_MOST_PARTICLES} are possible; use a larger spacing"
            )
        counts = _edge_counts(pattern, spacing)
        meshes = {
            name: mesh_panel(name, [edge.curve.sample(counts[name, i]) for i, edge in enumerate(panel.edges)], spacing)
            for name, panel in pattern.panels.items()
        }
        return cls._assemble(pattern, meshes, spacing)

    @classmethod
    def joined(cls, garments: Sequence[Garment]) -> Garment:
        """Several garments as one, in the given order; panel names are preceded by the garment's name."""
        if len(garments) == 1:
            return garments[0]
        starts = np.concatenate([[0], np.cumsum([g.particle_count for g in garments])]).astype(np.int32)
        panels = np.concatenate([[0], np.cumsum([len(g.panel_names) for g in garments])]).astype(np.int32)
        sewn = np.concatenate([[0], np.cumsum([int(g.merged_indices.max()) + 1 for g in garments])]).astype(np.int32)
        shifted: dict[str, Any] = {
            key: np.concatenate([getattr(g, key) + by[k] for k, g in enumerate(garments)]).astype(np.int32)
            for key, by in (
                ("triangles", starts),
                ("quads", starts),
                ("rows", starts),
                ("columns", starts),
                ("panel_of_particle", panels),
                ("panel_of_triangle", panels),
                ("merged_indices", sewn),
            )
        }
        plain: dict[str, Any] = {
            key: np.concatenate([getattr(g, key) for g in garments])
            for key in ("rest", "start", "in_quad", "panel_normals")
        }
        return cls(
            name=" + ".join(g.name for g in garments),
            panel_names=tuple(f"{g.name}/{name}" for g in garments for name in g.panel_names),
            outline=tuple(o + starts[k] for k, g in enumerate(garments) for o in g.outline),
            seams=tuple(
                Seam(f"{g.name}: {s.name}", s.first + starts[k], s.second + starts[k])
                for k, g in enumerate(garments)
                for s in g.seams
            ),
            spacing=garments[0].spacing,
            warnings=tuple(w for g in garments for w in g.warnings),
            layer_of_panel=tuple(k for k, g in enumerate(garments) for _ in g.panel_names),
            **shifted,
            **plain,
        )

    @classmethod
    def _assemble(cls, pattern: Pattern, meshes: dict[str, PanelMesh], spacing: float) -> Garment:
        names = tuple(meshes)
        sizes = [len(meshes[name].points) for name in names]
        first = dict(zip(names, np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int), strict=True))
        stack: dict[str, Any] = {
            key: np.concatenate([getattr(meshes[name], key) + first[name] for name in names]).astype(np.int32)
            for key in ("triangles", "quads", "rows", "columns")
        }
        in_quad = np.concatenate(
            [np.arange(len(meshes[name].triangles)) < 2 * len(meshes[name].quads) for name in names]
        )
        seams = tuple(_match(pattern, meshes, first, stitch) for stitch in pattern.stitches)
        panels: list[Panel] = [pattern.panels[name] for name in names]
        rest = np.concatenate([meshes[name].points for name in names])
        merged = merged_numbers(len(rest), seams)
        triangles = stack["triangles"]
        corners = merged[triangles]
        closed = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2]) | (corners[:, 2] == corners[:, 0])
        triangle_counts = [len(meshes[name].triangles) for name in names]
        panel_of_triangle = np.repeat(np.arange(len(names)), triangle_counts).astype(np.int32)
        if closed.any():
            where = names[panel_of_triangle[np.flatnonzero(closed)[0]]]
            raise GarmentError(
                f"panel '{where}': the stitches would join two corners of one triangle at {1000 * spacing:g} mm "
                "spacing; use a smaller spacing or remove a stitch"
            )
        angles = smallest_angles(rest, triangles)
        warnings = list(pattern.warnings)
        for k, name in enumerate(names):
            worst = float(angles[panel_of_triangle == k].min())
            if worst < _SLIVER_ANGLE:
                warnings.append(
                    f"panel '{name}': its narrowest triangle has an angle of {math.degrees(worst):.1f} degrees; "
                    "it shortens the stable time step"
                )
        return cls(
            name=pattern.name,
            rest=rest,
            start=np.concatenate([p.to_world(meshes[p.name].points) for p in panels]),
            in_quad=in_quad,
            panel_of_particle=np.repeat(np.arange(len(names)), sizes).astype(np.int32),
            panel_of_triangle=panel_of_triangle,
            panel_names=names,
            panel_normals=np.array([p.normal for p in panels]),
            outline=tuple(
                np.concatenate([e[:-1] for e in meshes[name].edge_points]).astype(np.int32) + np.int32(first[name])
                for name in names
            ),
            seams=seams,
            merged_indices=merged,
            spacing=spacing,
            warnings=tuple(warnings),
            **stack,
        )


def _edge_counts(pattern: Pattern, spacing: float) -> dict[tuple[str, int], int]:
    counts = {
        (name, i): max(math.ceil(edge.curve.length / spacing - 1e-6), 1) + 1
        for name, panel in pattern.panels.items()
        for i, edge in enumerate(panel.edges)
    }
    for stitch in pattern.stitches:
        pair = [(side.panel, side.edge) for side in (stitch.first, stitch.second)]
        longer = max(counts[p] for p in pair)
        counts.update({p: longer for p in pair})
    return counts


def _match(pattern: Pattern, meshes: dict[str, PanelMesh], first: dict[str, int], stitch: object) -> Seam:
    sides = (stitch.first, stitch.second)  # type: ignore[attr-defined]
    a, b = (meshes[s.panel].edge_points[s.edge] + np.int32(first[s.panel]) for s in sides)
    if not stitch.right_wrong:  # type: ignore[attr-defined]
        b = b[::-1]
    name = " - ".join(f"panel '{s.panel}', edge {s.edge}" for s in sides)
    return Seam(name, a.astype(np.int32), np.ascontiguousarray(b, dtype=np.int32))


def renumbered(index: Ints, number: Ints) -> Ints:
    """`number[index]` for an index of any shape into sewn numbers (n,); the index itself where nothing is sewn."""
    nothing_sewn = int(number.max()) + 1 == len(number)
    return np.asarray(index if nothing_sewn else number[index], dtype=np.int32)


def merged_numbers(count: int, seams: tuple[Seam, ...]) -> Ints:
    """Number the sewn particles: sets joined by any seam become one, in the order of their lowest member."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not seams:
        return np.arange(count, dtype=np.int32)
    a = np.concatenate([s.first for s in seams])
    b = np.concatenate([s.second for s in seams])
    _, label = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False)
    _, lowest, number = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(lowest))
    return np.asarray(order[number.ravel()], dtype=np.int32)
