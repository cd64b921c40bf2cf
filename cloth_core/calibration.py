"""The measured relation of particle spacing and error, as package data, and how it is read for a garment and a fabric.

The table (`data/calibration.json`, made by `benchmarks/calibrate.py`) has the typical error of a drape at several
spacings, for classes of fabric and sizes of garments, and the factor by which errors scatter about it. What is promised
is an upper quantile: typical error times factor, and never less than the spread of drapes that are equally right.

Between its rows the table is read as a power law, that is linearly in the logarithms of spacing and area. It is not
read beyond them: a spacing coarser than any calibrated is promised nothing, and neither is a finer one, for refining
was not found to converge; a garment outside the range of areas counts as the nearest one.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.fabric import Fabric

__all__ = ["Calibration", "Cloth", "bending_length", "calibration", "fabric_class"]

Floats = NDArray[np.float64]

_STANDARD_GRAVITY = 9.80665
# Bending length [m] that parts the classes: below it cloth falls into many narrow folds, above it into few wide ones.
_LIMP_BELOW = 0.018
LIMP, FIRM = "limp", "firm"


@dataclass(frozen=True)
class Cloth:
    """What the error at a spacing depends on, as far as it is calibrated.

    Attributes:
        area: of all panels [m^2].
        fabric_class: limp or firm.
    """

    area: float
    fabric_class: str

    @classmethod
    def of(cls, area: float, fabric: Fabric) -> Cloth:
        """Of a garment of an area [m^2] and its fabric."""
        return cls(area, fabric_class(fabric))


def bending_length(fabric: Fabric) -> float:
    """Peirce's bending length c = (B / w)^(1/3) [m], w the weight per area: the width of folds scales with it."""
    return float((fabric.bending / (fabric.area_density * _STANDARD_GRAVITY)) ** (1.0 / 3.0))


def fabric_class(fabric: Fabric) -> str:
    """Limp or firm, by the bending length."""
    return LIMP if bending_length(fabric) < _LIMP_BELOW else FIRM


@dataclass(frozen=True)
class Calibration:
    """The table.

    Attributes:
        spacings: [m], ascending, shape (s,).
        areas: of garments [m^2], ascending, shape (a,).
        typical: class -> typical error [m], shape (a, s), ascending along s.
        factor: promise over typical error.
        spread: no smaller error is promised [m].
        provenance: where the figures come from.
    """

    spacings: Floats
    areas: Floats
    typical: dict[str, Floats]
    factor: float
    spread: float
    provenance: dict[str, Any]

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Calibration:
        """From the JSON form."""
        return cls(
            spacings=np.array(data["spacings"], dtype=float),
            areas=np.array(data["areas"], dtype=float),
            typical={name: np.array(rows, dtype=float) for name, rows in data["typical_error"].items()},
            factor=float(data["factor"]),
            spread=float(data["spread"]),
            provenance=data["provenance"],
        )

    def promise(self, spacing: float, cloth: Cloth | None = None) -> float | None:
        """Error that a drape at this spacing [m] is promised to keep within [m]; None where nothing is measured.

        Without a cloth: the largest promise over all classes and sizes.
        """
        if not self.spacings[0] * (1.0 - 1e-9) <= spacing <= self.spacings[-1] * (1.0 + 1e-9):
            return None
        curve = np.exp(np.interp(math.log(spacing), np.log(self.spacings), np.log(self._curve(cloth))))
        return max(float(curve) * self.factor, self.spread)

    def spacing(self, tolerance: float, cloth: Cloth | None = None) -> float | None:
        """The coarsest spacing [m] whose promise is within a tolerance [m]; None if none is."""
        most = tolerance * (1.0 + 1e-9)
        typical = self._curve(cloth) * self.factor
        beyond = np.flatnonzero(np.maximum(typical, self.spread) > most)
        if len(beyond) == 0:
            return float(self.spacings[-1])
        if beyond[0] == 0:
            return None
        low, high = beyond[0] - 1, beyond[0]
        share = math.log(tolerance / typical[low]) / math.log(typical[high] / typical[low])
        return float(self.spacings[low] * (self.spacings[high] / self.spacings[low]) ** max(share, 0.0))

    @property
    def source(self) -> str:
        """One line for reports."""
        p = self.provenance
        return (
            f"calibrated {p['date'][:10]} on {len(p['scenes'])} scenes against {1000 * p['reference_spacing']:g} mm "
            f"spacing, RMS distance of the drapes that {100 * p['content']:g} % of cases keep within"
        )

    def _curve(self, cloth: Cloth | None) -> Floats:
        """Typical error at each spacing, made ascending: a coarser grid is never taken for a better one."""
        if cloth is None:
            worst = np.max([rows.max(axis=0) for rows in self.typical.values()], axis=0)
            return np.asarray(np.maximum.accumulate(worst))
        rows = self.typical[cloth.fabric_class]
        at = np.log(np.clip(cloth.area, self.areas[0], self.areas[-1]))
        logs = [np.interp(at, np.log(self.areas), np.log(rows[:, k])) for k in range(len(self.spacings))]
        return np.asarray(np.maximum.accumulate(np.exp(logs)))


@cache
def calibration() -> Calibration:
    """The table that comes with the package."""
    text = resources.files("cloth_core").joinpath("data/calibration.json").read_text(encoding="utf-8")
    return Calibration.from_dict(json.loads(text))
