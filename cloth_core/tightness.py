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

__all__ = ["Tightness", "times_the_limit"]

Floats = NDArray[np.float64]

# A run is given up when its movements have not halved in so long [s]; and one whose seams stay open.
_PATIENCE, _PATIENCE_WHEN_OPEN = 6.0, 3.0
# The same for garments that are stretched by this many times the fabric's limit: with open seams, and with any.
_TIGHT, _PATIENCE_WHEN_TIGHT = 1.5, 0.5
_FAR_TOO_TIGHT, _PATIENCE_WHEN_FAR_TOO_TIGHT = 5.0, 0.3
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

    def patience(self, open_seams: bool) -> float:
        """How long movements may go without halving before a run to rest is given up [s]."""
        times = times_the_limit(self.strain, self.limit)
        if times >= _FAR_TOO_TIGHT:
            return _PATIENCE_WHEN_FAR_TOO_TIGHT
        if not open_seams:
            return _PATIENCE
        return _PATIENCE_WHEN_TIGHT if times >= _TIGHT else _PATIENCE_WHEN_OPEN

    def why(self, open_seams: bool) -> str:
        """One line that says where a garment is too tight to be waited for; empty where it is not."""
        if self.patience(open_seams) >= _PATIENCE_WHEN_OPEN:
            return ""
        place = ", ".join(f"{value:.2f}" for value in self.place)
        return (
            f"too tight: panel '{self.panel}' at ({place}) m is stretched by {100 * self.strain:.0f} %, "
            f"{100 * self.limit:g} % is the fabric's limit, and it does not come to rest"
        )


def times_the_limit(strain: float, limit: float) -> float:
    """A strain as a multiple of a fabric's limit; of 5 % where that is less, as little as seams of any fabric pull."""
    return strain / max(limit, _LEAST_LIMIT)
