"""Pairs of panels that are sewn to each other along several seams: the front and the back of something."""

from __future__ import annotations

from typing import NamedTuple

from cloth_core.garment import Garment, Seam

__all__ = ["SewnPair", "sewn_pairs"]


class SewnPair(NamedTuple):
    """Two panels, by their numbers, and the seams between them."""

    first: int
    second: int
    seams: list[Seam]


def sewn_pairs(garment: Garment) -> list[SewnPair]:
    """Those with two seams or more between them, in the order of their first seams."""
    found: dict[tuple[int, int], list[Seam]] = {}
    for seam in garment.seams:
        one, other = sorted(int(garment.panel_of_particle[side[0]]) for side in (seam.first, seam.second))
        if one != other:
            found.setdefault((one, other), []).append(seam)
    return [SewnPair(*pair, seams) for pair, seams in found.items() if len(seams) > 1]
