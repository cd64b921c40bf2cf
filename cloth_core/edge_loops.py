"""Normalisation of edge loops: every outline counter-clockwise and from its lower-left vertex."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from cloth_core.pattern import Panel, Stitch, StitchSide
from cloth_core.pattern_checks import start_distances

__all__ = ["normalize_loops"]

_TURN_OVER = np.diag([-1.0, 1.0, -1.0])  # half a turn about y: undoes the mirroring of x for points of the panel


def normalize_loops(
    panels: dict[str, Panel], stitches: tuple[Stitch, ...]
) -> tuple[dict[str, Panel], tuple[Stitch, ...]]:
    """All loops counter-clockwise and starting at the lower-left vertex; stitches follow their edges to the new places.

    A clockwise loop can be meant in two ways. Either the direction is arbitrary: then the loop is reversed, and
    stitches speak of the start and end that edges have afterwards. Or the panel is drawn as seen from its other side
    (so the reference reader takes it): then it is turned over, x is mirrored, and start and end stay. The file does not
    tell, so the reading whose seams start closer together is taken, the first in doubt.
    """
    clockwise = {name for name, panel in panels.items() if panel.area < 0.0}

    def turned(turn: Callable[[Panel], Panel]) -> tuple[dict[str, Panel], tuple[Stitch, ...]]:
        read = {name: _from_lower_left(turn(panel) if name in clockwise else panel) for name, panel in panels.items()}
        return read, _renumbered(stitches, read)

    def seam_distance(read: dict[str, Panel], sewn: tuple[Stitch, ...]) -> float:
        return sum(start_distances(read, stitch)[0] for stitch in sewn)

    by_reversal, by_turning_over = turned(_reversed), turned(_turned_over)
    closer = seam_distance(*by_turning_over) < seam_distance(*by_reversal) - 1e-6
    return by_turning_over if closer else by_reversal


def _reversed(panel: Panel) -> Panel:
    edges = (
        replace(edge, start=edge.end, end=edge.start, curve=edge.curve.reversed()) for edge in reversed(panel.edges)
    )
    return replace(panel, edges=tuple(edges))


def _turned_over(panel: Panel) -> Panel:
    edges = tuple(replace(edge, curve=edge.curve.mirrored()) for edge in panel.edges)
    return replace(panel, vertices=panel.vertices * (-1.0, 1.0), edges=edges, rotation=panel.rotation @ _TURN_OVER)


def _from_lower_left(panel: Panel) -> Panel:
    """Start at the vertex nearest to the lower left corner of the bounding box of the vertices."""
    corner = int(np.argmin(np.linalg.norm(panel.vertices - panel.vertices.min(axis=0), axis=1)))
    first = next(i for i, edge in enumerate(panel.edges) if edge.start == corner)
    return replace(panel, edges=panel.edges[first:] + panel.edges[:first])


def _renumbered(stitches: tuple[Stitch, ...], panels: Mapping[str, Panel]) -> tuple[Stitch, ...]:
    place = {
        StitchSide(name, edge.file_index): StitchSide(name, i)
        for name, panel in panels.items()
        for i, edge in enumerate(panel.edges)
    }
    return tuple(replace(stitch, first=place[stitch.first], second=place[stitch.second]) for stitch in stitches)
