"""How tight a garment is once it is sewn, and how long it may go on moving then.

Cloth that a body stretches far beyond the fabric's limit, as a garment does that is sizes too small, trembles under a
pull that contact and strain limit cannot both satisfy. It will not come to rest, and its steps are dear.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.model import Model
from cloth_core.springs import SpringFamily, spring_strains

__all__ = ["Tightness", "TightnessWatch", "times_the_limit"]

Floats = NDArray[np.float64]

# Cloth that is stretched by this many times the fabric's limit is too tight, if seams stay open for it.
_TIGHT = 1.5
# It counts when it was so in so many windows running.
_WINDOWS = 5
# A run is given up when its movements have not halved in so long [s]; one whose seams stay open; one that is tight too.
_PATIENCE, _PATIENCE_WHEN_OPEN, _PATIENCE_WHEN_TIGHT = 6.0, 3.0, 0.5
# Seams pull at least as hard as this stretch would, whatever the fabric's limit.
_LEAST_LIMIT = 0.05


class Tightness(NamedTuple):
    """The most stretched structural spring.

    Attributes:
        strain: of it; limit: of the fabric, infinite if it is switched off.
        panel: that it belongs to; place: of it [m], (3,).
    """

    strain: float
    limit: float
    panel: str
    place: Floats

    @classmethod
    def of(cls, model: Model, x: Floats) -> Tightness:
        """Of a model at x (k, 3) [m], its own numbering."""
        garment, springs = model.scene.garment, model.springs
        own = np.flatnonzero(springs.family == SpringFamily.STRUCTURAL)
        strains = spring_strains(x, springs)
        worst = int(own[np.argmax(strains[own])])
        ends = springs.pairs[worst]
        particle = int(np.flatnonzero(model.number == ends[0])[0])
        return cls(
            strain=float(strains[worst]),
            limit=np.inf if "strain limit" in model.scene.without else model.scene.fabric.strain_limit,
            panel=garment.panel_names[garment.panel_of_particle[particle]],
            place=x[ends].mean(axis=0),
        )

    @property
    def line(self) -> str:
        """Where a garment is too tight to come to rest, in one line."""
        place = ", ".join(f"{value:.2f}" for value in self.place)
        return (
            f"too tight: panel '{self.panel}' at ({place}) m is stretched by {100 * self.strain:.0f} %, "
            f"{100 * self.limit:g} % is the fabric's limit, and it does not come to rest"
        )


class TightnessWatch:
    """Watches how tight a garment is, window after window of a run to rest."""

    def __init__(self) -> None:
        self._tight = 0

    def look(self, tightness: Tightness) -> None:
        """At the end of a window."""
        tight = times_the_limit(tightness.strain, tightness.limit) >= _TIGHT
        self._tight = self._tight + 1 if tight else 0

    def is_tight(self, open_seams: bool) -> bool:
        """Whether it is too tight to be waited for as long as others; open_seams: some will stay open.

        With all seams closed it may still find its way: points that are stretched by a third have come to rest.
        """
        return open_seams and self._tight >= _WINDOWS

    def patience(self, open_seams: bool, may_close: bool) -> float:
        """How long movements may go without halving before a run is given up [s].

        open_seams: whether some are open; may_close: whether any of those may still close.
        """
        if not open_seams:
            return _PATIENCE
        return _PATIENCE_WHEN_TIGHT if self.is_tight(not may_close) else _PATIENCE_WHEN_OPEN


def times_the_limit(strain: float, limit: float) -> float:
    """A strain as a multiple of a fabric's limit; of 5 % where that is less, as little as seams of any fabric pull."""
    return strain / max(limit, _LEAST_LIMIT)
