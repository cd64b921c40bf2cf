"""Several patterns that are worn over each other, as one: what one message or file of a scene holds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from cloth_core.pattern import Pattern, Stitch, StitchSide

__all__ = ["layered", "layers_of"]


def layered(name: str, layers: Sequence[Pattern], source: str) -> Pattern:
    """One pattern with the panels and stitches of all, the innermost garment first.

    Garments get names that differ, and panels are called `garment/panel`.
    """
    garments = _distinct(layers)
    return Pattern(
        name=name,
        panels={
            f"{garment.name}/{key}": replace(panel, name=f"{garment.name}/{panel.name}")
            for garment in garments
            for key, panel in garment.panels.items()
        },
        stitches=tuple(
            Stitch(_renamed(stitch.first, garment), _renamed(stitch.second, garment), stitch.right_wrong)
            for garment in garments
            for stitch in garment.stitches
        ),
        warnings=tuple(f"{garment.name}: {line}" for garment in garments for line in garment.warnings),
        source=source,
        layers=tuple(garments),
    )


def layers_of(patterns: Iterable[Pattern]) -> list[Pattern]:
    """Each garment of patterns that may have layers, in their order, with names that differ."""
    return _distinct([layer for pattern in patterns for layer in (pattern.layers or (pattern,))])


def _renamed(side: StitchSide, garment: Pattern) -> StitchSide:
    return replace(side, panel=f"{garment.name}/{side.panel}")


def _distinct(patterns: Iterable[Pattern]) -> list[Pattern]:
    """The patterns with names that differ: a second T-shirt is called so."""
    taken: set[str] = set()
    result = []
    for pattern in patterns:
        name, times = pattern.name, 1
        while name in taken:
            times += 1
            name = f"{pattern.name} {times}"
        taken.add(name)
        result.append(pattern if name == pattern.name else replace(pattern, name=name))
    return result
