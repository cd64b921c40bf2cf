"""Where to look closely at a dressed body: armpit, neck, waist and hem, found from the body's horizontal sections."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Region", "close_ups"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_LEVEL_SPACING = 0.005  # m
# Parts of a section that are nearer than this in x are one [m].
_JOINED = 0.002
# No look at the ankles or the top of the head: shares of the body's height.
_LOWEST, _SHOULDERS, _HIGHEST = 0.35, 0.85, 0.95


class Region(NamedTuple):
    """What a picture shows.

    Attributes:
        name: armpit, neck, waist or hem.
        centre: [m], (3,); radius: [m].
        views: names out of `camera.VIEWS`.
    """

    name: str
    centre: tuple[float, float, float]
    radius: float
    views: tuple[str, ...]


def close_ups(body: tuple[Floats, Ints], garment: tuple[Floats, Ints]) -> list[Region]:
    """Regions of a standing body in which there is some of the garment.

    Both are vertices [m], z up, shape (n, 3), and triangles (m, 3).

    The armpit is where a section falls apart into trunk and arms, the waist is where the trunk is narrowest below it,
    the neck where the body is narrowest above it. Without arms apart from the trunk there is a hem only.
    """
    x, triangles = body
    low, high = float(x[:, 2].min()), float(x[:, 2].max())
    height = high - low
    levels = np.arange(low + _LOWEST * height, low + _HIGHEST * height, _LEVEL_SPACING)
    sections = [_section(x, triangles, float(z)) for z in levels]
    regions: list[Region] = []
    # Ears are beside the head as arms are beside the trunk.
    with_arms = [k for k, parts in enumerate(sections) if len(parts) >= 3 and levels[k] < low + _SHOULDERS * height]
    if with_arms:
        top = max(with_arms)
        trunk = _middle(sections[top])
        regions.append(_at("armpit", trunk[1], x, float(levels[top]), 0.075 * height, ("front", "back")))
        below = [k for k in with_arms if levels[k] > low + 0.5 * height]
        if below:
            narrow = min(below, key=lambda k: _width(_middle(sections[k])))
            middle = sum(_middle(sections[narrow])) / 2.0
            regions.append(_at("waist", middle, x, float(levels[narrow]), 0.12 * height, ("front", "left")))
        above = [k for k in range(top + 1, len(levels)) if sections[k] and levels[k] < low + 0.9 * height]
        if above:
            narrow = min(above, key=lambda k: sections[k][-1][1] - sections[k][0][0])
            middle = (sections[narrow][0][0] + sections[narrow][-1][1]) / 2.0
            regions.append(
                _at("neck", middle, x, float(levels[narrow]) - 0.02 * height, 0.08 * height, ("front", "back"))
            )
    cloth = garment[0]
    lowest = cloth[cloth[:, 2] < cloth[:, 2].min() + 0.05]
    middle_of_hem = (lowest.min(axis=0) + lowest.max(axis=0)) / 2.0
    radius = max(0.6 * float(np.ptp(lowest[:, :2], axis=0).max()), 0.08 * height)
    regions.append(Region("hem", (*middle_of_hem.tolist(),), radius, ("front", "three_quarter")))
    return [r for r in regions if (np.linalg.norm(cloth - r.centre, axis=1) < r.radius).any()]


def _section(x: Floats, triangles: Ints, z: float) -> list[tuple[float, float]]:
    """Extents in x [m] of the parts of a horizontal section, from left to right."""
    corners = x[triangles]
    side = corners[:, :, 2] > z
    cut = corners[side.any(axis=1) & ~side.all(axis=1)]
    if len(cut) == 0:
        return []
    ends = []
    for k in range(3):
        a, b = cut[:, k], cut[:, (k + 1) % 3]
        crosses = (a[:, 2] > z) != (b[:, 2] > z)
        share = (z - a[:, 2]) / np.where(crosses, b[:, 2] - a[:, 2], 1.0)
        ends.append(np.where(crosses, a[:, 0] + share * (b[:, 0] - a[:, 0]), np.nan))
    left, right = np.nanmin(ends, axis=0), np.nanmax(ends, axis=0)
    order = np.argsort(left, kind="stable")
    parts: list[list[float]] = []
    for start, end in zip(left[order].tolist(), right[order].tolist(), strict=True):
        if parts and start <= parts[-1][1] + _JOINED:
            parts[-1][1] = max(parts[-1][1], end)
        else:
            parts.append([start, end])
    return [(start, end) for start, end in parts]


def _middle(parts: list[tuple[float, float]]) -> tuple[float, float]:
    """The trunk: the widest part."""
    return max(parts, key=_width)


def _width(part: tuple[float, float]) -> float:
    return part[1] - part[0]


def _at(name: str, across: float, x: Floats, z: float, radius: float, views: tuple[str, ...]) -> Region:
    near = x[(np.abs(x[:, 2] - z) < 0.02) & (np.abs(x[:, 0] - across) < 0.1)]
    depth = float(near[:, 1].mean()) if len(near) else 0.0
    return Region(name, (float(across), depth, z), radius, views)
