"""Whether refinement leads anywhere: the order of convergence, and what is left of the error at the finest level.

If the error at a step h (spacing or time step) is C h^p, solutions at h and H differ by C (H^p - h^p). Order p and
constant C are fitted to the measured distances; C h^p at the finest h is Richardson's estimate of what is left there
(Richardson 1911; Roache 1994 for steps of any ratio).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.errors import ClothError

__all__ = ["Convergence", "fit_convergence"]

_LOWEST_ORDER, _HIGHEST_ORDER = 0.05, 6.0
# What counts as convergence.
_LEAST_ORDER, _MOST_MISFIT = 0.5, 0.15


@dataclass(frozen=True)
class Convergence:
    """What refinement does.

    Attributes:
        order: p, None where the distances do not shrink, or follow no power up to the sixth.
        constant: C, in metres per unit of the step to the power p.
        left: C h^p at the finest step [m], None without an order.
        misfit: RMS of measured minus fitted distance, as a share of the largest distance.
        within_spread: whether the finest two levels differ by no more than drapes differ that are equally right; then
            refinement cannot be told from chance, and the order means little.
        converges: whether there is an order of at least 0.5 that the distances follow within 15 %, and the finest two
            levels differ by more than chance; only then is `left` an estimate.
    """

    order: float | None
    constant: float | None
    left: float | None
    misfit: float
    within_spread: bool
    converges: bool

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        return asdict(self)


def fit_convergence(distances: Mapping[tuple[float, float], float], spread: float = 0.0) -> Convergence:
    """Fit C |H^p - h^p| to distances between solutions at steps H and h.

    Args:
        distances: (H, h) -> measured distance [m]; at least three different steps.
        spread: distance of solutions that are equally right [m]. It adds to the others as independent chance does, so
            its square is taken off theirs.

    Raises:
        ClothError: fewer than three steps, or a step or distance that is not a positive number.
    """
    pairs = np.array(list(distances), dtype=float).reshape(-1, 2)
    measured = np.array(list(distances.values()), dtype=float)
    if len(np.unique(pairs)) < 3 or (pairs[:, 0] == pairs[:, 1]).any():
        raise ClothError("convergence: an order needs solutions at three different steps; refine once more")
    if not (np.isfinite(pairs).all() and (pairs > 0.0).all() and np.isfinite(measured).all() and (measured >= 0).all()):
        raise ClothError("convergence: a step or distance is not a positive number; leave out the run that failed")
    cleaned = np.sqrt(np.maximum(measured**2 - spread**2, 0.0))
    finest, second = (float(step) for step in np.unique(pairs)[:2])
    last = [float(m) for pair, m in zip(pairs, measured, strict=True) if set(pair) == {finest, second}]
    within = bool(last and last[0] <= 1.5 * spread)
    scale = float(pairs.max())
    orders = np.linspace(_LOWEST_ORDER, _HIGHEST_ORDER, 1191)
    fits = [_constant_and_misfit(pairs / scale, cleaned, p) for p in orders]
    best = int(np.argmin([misfit for _, misfit in fits]))
    order, (constant, misfit) = float(orders[best]), fits[best]
    top = float(measured.max())
    share = misfit / top if top > 0.0 else 0.0
    if constant <= 0.0 or best in (0, len(orders) - 1):
        return Convergence(None, None, None, share, within, False)
    left = constant * (finest / scale) ** order
    converges = share < _MOST_MISFIT and order >= _LEAST_ORDER and not within
    return Convergence(order, constant / scale**order, left, share, within, converges)


def _constant_and_misfit(
    pairs: NDArray[np.float64], measured: NDArray[np.float64], order: float
) -> tuple[float, float]:
    shape = np.abs(pairs[:, 0] ** order - pairs[:, 1] ** order)
    constant = float(shape @ measured / (shape @ shape))
    return constant, math.sqrt(float(((constant * shape - measured) ** 2).mean()))
