"""From measured errors of many scenes to the table of `calibration`: typical errors, and how far above them to promise.

Errors are positive and scatter by factors, so that everything is fitted to their logarithms:

    log(error) = level of the spacing + level of the fabric class + slope * log(area) + chance

The typical error is the fit without chance. The promise is an upper tolerance limit of the normal distribution (Howe
1969): with the stated confidence at least `content` of all scenes like these lie below it. The number that counts for
that is the one of scenes, not of runs: the runs of one scene have much in common.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_core.errors import ClothError

__all__ = ["Case", "fit_calibration", "tolerance_factor"]

CONTENT, CONFIDENCE = 0.95, 0.75


@dataclass(frozen=True)
class Case:
    """A measured error.

    Attributes:
        scene: its name; cases of one scene belong together.
        area: of the garment [m^2].
        fabric_class: limp or firm.
        spacing: [m].
        error: RMS distance to the reference [m], above 0.
    """

    scene: str
    area: float
    fabric_class: str
    spacing: float
    error: float


def tolerance_factor(count: int, content: float = CONTENT, confidence: float = CONFIDENCE) -> float:
    """How many standard deviations above the mean of `count` normal values the one-sided tolerance limit lies."""
    from scipy.stats import nct, norm

    root = math.sqrt(count)
    return float(nct.ppf(confidence, count - 1, norm.ppf(content) * root) / root)


def fit_calibration(cases: Sequence[Case], spread: float, provenance: dict[str, Any]) -> dict[str, Any]:
    """The table in its JSON form.

    Args:
        cases: of at least three scenes.
        spread: distance of equally right drapes [m]; no smaller error is promised.
        provenance: what is said about where the figures come from; scenes and statistics are added.

    Raises:
        ClothError: too few scenes, or an error that is not positive.
    """
    scenes = sorted({case.scene for case in cases})
    spacings = sorted({case.spacing for case in cases})
    classes = sorted({case.fabric_class for case in cases})
    areas = sorted({case.area for case in cases})
    if len(scenes) < 3 or len(spacings) < 2:
        raise ClothError("calibration: needs at least three scenes and two spacings; measure more")
    if any(not (math.isfinite(case.error) and case.error > 0.0) for case in cases):
        raise ClothError("calibration: an error is not a positive number; leave out the run that failed")
    with_area = len(areas) >= 3
    middle = math.log(math.sqrt(areas[0] * areas[-1]))
    columns = len(spacings) + len(classes) - 1 + int(with_area)
    matrix = np.zeros((len(cases), columns))
    for row, case in enumerate(cases):
        matrix[row, spacings.index(case.spacing)] = 1.0
        other = classes.index(case.fabric_class) - 1
        if other >= 0:
            matrix[row, len(spacings) + other] = 1.0
        if with_area:
            matrix[row, -1] = math.log(case.area) - middle
    logs = np.log([case.error for case in cases])
    solution, *_ = np.linalg.lstsq(matrix, logs, rcond=None)
    # The scenes are the independent draws: what the class and size levels took from them is taken off their number.
    left = logs - matrix @ solution
    freedom = max(len(cases) * (len(scenes) - len(classes) + 1 - int(with_area)) / len(scenes) - 1.0, 1.0)
    deviation = math.sqrt(float(left @ left) / freedom)
    factor = math.exp(tolerance_factor(len(scenes)) * deviation)
    ends = [areas[0], areas[-1]] if areas[-1] > areas[0] else [areas[0], 1.01 * areas[0]]
    slope = float(solution[-1]) if with_area else 0.0

    def row_of(name: str, area: float) -> list[float]:
        other = classes.index(name) - 1
        level = float(solution[len(spacings) + other]) if other >= 0 else 0.0
        shift = level + slope * (math.log(area) - middle)
        return [round(math.exp(float(solution[k]) + shift), 6) for k in range(len(spacings))]

    return {
        "spacings": spacings,
        "areas": ends,
        "typical_error": {name: [row_of(name, area) for area in ends] for name in classes},
        "factor": round(factor, 4),
        "spread": round(spread, 6),
        "provenance": {
            **provenance,
            "scenes": scenes,
            "cases": len(cases),
            "content": CONTENT,
            "confidence": CONFIDENCE,
            "standard_deviation_of_log_error": round(deviation, 4),
        },
    }
