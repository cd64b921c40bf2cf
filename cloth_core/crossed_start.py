"""Cloth that passes through itself or through the body where it starts: contact cannot part it any more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.body_crossings import BodyCrossings
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_pairs

__all__ = ["body_start_warnings", "crossed_start_warnings", "crossing_at_start"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# What crosses nearer to each other than this is one place [m]; so many are named.
_PLACE, _NAMED = 0.1, 3


def crossing_at_start(garment: Garment) -> Ints:
    """Sides of the cloth that pass through it at its start, as particle pairs (k, 2).

    Sides and triangles that meet in a point of a seam do not count: there they are sewn together.
    """
    edges, pairs = self_crossing_pairs(garment.start, garment.triangles, garment.merged_indices)
    return np.asarray(edges[np.unique(pairs[:, 0])])


def crossed_start_warnings(garment: Garment) -> tuple[str, ...]:
    """One line if the cloth passes through itself at its start, none else."""
    sides = crossing_at_start(garment)
    if len(sides) == 0:
        return ()
    return (
        f"garment '{garment.name}': {len(sides)} sides of panel {_panels_of(garment, sides)} pass through the cloth "
        f"where it starts; what crosses, {_places_of(garment, sides)}, stays where it is, and no more will cross; "
        "place the panels apart",
    )


def body_start_warnings(garment: Garment, body: Body) -> tuple[str, ...]:
    """Lines if cloth and body pass through each other at its start or panels are inside of the body, none else.

    Patterns that are placed around a body start clear of it; a start given by hand may not.
    """
    found = BodyCrossings.of(garment.start, garment.triangles, body)
    sides = found.cloth_sides[np.unique(found.through_body[:, 0])]
    # What a tip of the body comes through, without a side of the cloth meeting it.
    pierced = garment.triangles[np.unique(found.through_cloth[:, 1])]
    pierced = pierced[~np.isin(pierced, sides).any(axis=1)]
    # A panel that nothing crosses is as a whole where one of its points is.
    crossed = np.unique(garment.panel_of_particle[np.concatenate([sides[:, 0], pierced[:, 0]])])
    whole = [k for k in range(len(garment.panel_names)) if k not in crossed]
    first = [int(np.flatnonzero(garment.panel_of_particle == k)[0]) for k in whole]
    inside = [k for k, w in zip(whole, body.winding_number(garment.start[first]), strict=True) if w > 0.5]
    lines = []
    if len(sides):
        lines.append(
            f"garment '{garment.name}': {len(sides)} sides of panel {_panels_of(garment, sides)} pass through body "
            f"'{body.name}' where it starts, {_places_of(garment, sides)}; they stay there, and no more will; place "
            "the garment clear of the body"
        )
    if len(pierced):
        lines.append(
            f"garment '{garment.name}': body '{body.name}' comes through panel {_panels_of(garment, pierced)} between "
            f"its particles where it starts, {_places_of(garment, pierced)}; it stays there; place the garment clear "
            "of the body"
        )
    if inside:
        lines.append(
            f"garment '{garment.name}': panel {_named(garment, inside)} starts inside body '{body.name}' and stays "
            "there; place the garment clear of the body"
        )
    return tuple(lines)


def _panels_of(garment: Garment, sides: Ints) -> str:
    return _named(garment, np.unique(garment.panel_of_particle[sides[:, 0]]).tolist())


def _named(garment: Garment, panels: list[int]) -> str:
    shown = ", ".join(f"'{garment.panel_names[k]}'" for k in panels[:_NAMED])
    return shown + (f" and {len(panels) - _NAMED} more" if len(panels) > _NAMED else "")


def _places_of(garment: Garment, sides: Ints) -> str:
    """Where some sides or triangles are at the start: a few of their middles, no two of which are near each other."""
    left = garment.start[sides].mean(axis=1)
    places = []
    while len(left):
        places.append(left[np.argmin(np.linalg.norm(left - left.mean(axis=0), axis=1))])
        left = left[np.linalg.norm(left - places[-1], axis=1) > _PLACE]
    shown = ", ".join(f"({', '.join(f'{value:.2f}' for value in place)}) m" for place in places[:_NAMED])
    return f"at {shown}" + (f" and {len(places) - _NAMED} more places" if len(places) > _NAMED else "")
