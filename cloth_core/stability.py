"""The stable time step of an assembled model: its largest eigenfrequency with its damping, not a guess.

Symplectic Euler with explicit damping is stable while dt^2 K + 2 dt C < 4 M (as matrices): for one mode of frequency w
and damping ratio z this is w dt < 2 (sqrt(1 + z^2) - z). The largest eigenvalue comes from the Lanczos method.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.lanes import LANES, fill, fused, load, store, take_from

__all__ = ["StableStep", "largest_eigenpair", "stable_time_step"]

Floats = NDArray[np.float64]
Operator = Callable[[Floats], Floats]
WeightedSum = Callable[[Floats, float, float], Floats]

# Lanczos' vectors that are kept, where there is room for all of them [bytes]; where there are more, none is.
_KEPT, _KEPT_BYTES = 24, 5_000_000


@dataclass(frozen=True)
class StableStep:
    """Largest stable time step and what limits it.

    Attributes:
        time_step: [s]; inf if nothing limits it.
        largest_frequency: w_max = sqrt(largest eigenvalue of M^-1 K) of the limiting mode [rad/s].
        damping_ratio: z of the limiting mode.
        mode: the limiting mode, mass-scaled, shape (n, 3); a good start for the next estimate.
    """

    time_step: float
    largest_frequency: float
    damping_ratio: float
    mode: Floats


def largest_eigenpair(
    operator: Operator, start: Floats, tolerance: float = 1e-3, iterations: int = 120
) -> tuple[float, Floats]:
    """Upper estimate of the largest eigenvalue of a symmetric operator, and its Ritz vector, by Lanczos.

    The residual of the Ritz pair is added to its value, so that a Lanczos run that has not converged errs on the safe
    side. `start` has any shape; the operator maps arrays of that shape.
    """
    shape, size = start.shape, start.size
    norm = _norm(start)
    if norm == 0.0:
        return 0.0, start
    recurrence = _Recurrence(operator, start / norm)
    value, residual, weights = 0.0, math.inf, np.ones(1)
    kept: list[Floats] = []
    most = _KEPT if 8 * size * _KEPT <= _KEPT_BYTES else 0
    for k in range(iterations):
        if k == most:
            kept.clear()
        elif k < most:
            kept.append(recurrence.vector[:size].copy())
        recurrence.advance()
        alpha, beta = recurrence.alpha, recurrence.beta
        last = beta[-1] <= 1e-12 * max(abs(a) for a in alpha) or k == iterations - 1
        if last or k % 4 == 3:
            value, weights = _largest_of_tridiagonal(np.array(alpha), np.array(beta[:-1]))
            residual = beta[-1] * abs(float(weights[-1]))
            if last or residual <= tolerance * value:
                break
    ritz = np.zeros(size)
    if len(kept) == len(weights):
        for weight, vector in zip(weights, kept, strict=True):
            ritz += weight * vector
    else:
        # Made again: all vectors of a large model would be ten times as large as the model itself.
        del recurrence, kept
        recurrence = _Recurrence(operator, start / norm)
        for k, weight in enumerate(weights):
            if k > 0:
                recurrence.advance()
            ritz += weight * recurrence.vector[:size]
    return max(value, 0.0) + (residual if value > 0.0 else 0.0), ritz.reshape(shape)


def _largest_of_tridiagonal(diagonal: Floats, beside: Floats) -> tuple[float, Floats]:
    """The largest eigenvalue of a symmetric tridiagonal matrix, (n,) and (n - 1,), and its vector (n,).

    As `scipy.linalg.eigh_tridiagonal` does it, whose checks take ten times as long as a matrix of a dozen rows: the
    pair alone, in one thread. Those of BLAS would wait for each other on a busy machine.
    """
    from scipy.linalg.lapack import dstebz, dstein

    count = len(diagonal)
    if count == 1:
        return float(diagonal[0]), np.ones(1)
    by_index, by_block = 2, "B"
    _, values, block, split, failed = dstebz(diagonal, beside, by_index, 0.0, 1.0, count, count, 0.0, by_block)
    vectors, not_converged = dstein(diagonal, beside, values[:1], block, split)
    if failed or not_converged:
        raise np.linalg.LinAlgError(f"the largest eigenvalue of {count} Lanczos steps was not found")
    return float(values[0]), vectors[:, 0]


class _Recurrence:
    """Lanczos' vectors, one after the other, by their recurrence of three terms.

    They lose their orthogonality once the largest pair has converged, which only adds copies of that pair.

    Attributes:
        vector: the present one, flat, with zeros up to whole registers.
        alpha, beta: diagonal of the tridiagonal matrix, and what lies beside it and what remains.
    """

    def __init__(self, operator: Operator, unit: Floats) -> None:
        self._operator, self._shape, self._size = operator, unit.shape, unit.size
        whole = -(-unit.size // LANES) * LANES
        self.vector, self._before, self._next = np.zeros(whole), np.zeros(whole), np.zeros(whole)
        self.vector[: unit.size] = unit.ravel()
        self.alpha: list[float] = []
        self.beta: list[float] = []

    def advance(self) -> None:
        """On to the next vector."""
        w = self._next
        w[: self._size] = self._operator(self.vector[: self._size].reshape(self._shape)).ravel()
        if self.beta:
            _take_part(w, self._before, self.beta[-1])
        self.alpha.append(_dot(w, self.vector))
        _take_part(w, self.vector, self.alpha[-1])
        self.beta.append(math.sqrt(_dot(w, w)))
        if self.beta[-1] > 0.0:
            w /= self.beta[-1]
        self._before, self.vector, self._next = self.vector, w, self._before


def _norm(a: Floats) -> float:
    """Root of the sum of squares; that of NumPy calls BLAS, whose threads wait for each other on a busy machine."""
    return math.sqrt(float(np.square(a).sum()))


@kernel
def _dot(a: Floats, b: Floats) -> float:
    """a . b for whole registers: one thread, one order of summation, where BLAS has several of both."""
    total, eight = fill(0.0), np.zeros(LANES)
    for s in range(0, a.shape[0], LANES):
        total = fused(load(a, s), load(b, s), total)
    store(eight, 0, total)
    return float(eight.sum())


@borrowing_kernel
def _take_part(w: Floats, q: Floats, part: float) -> None:
    """w - part q for whole registers, in place."""
    lanes = fill(part)
    for s in range(0, w.shape[0], LANES):
        take_from(w, s, lanes * load(q, s))


def stable_time_step(
    weighted: WeightedSum, inverse_mass: Floats, start: Floats | None = None, tolerance: float = 1e-3
) -> StableStep:
    """Largest dt with dt^2 K + 2 dt C < 4 M.

    Args:
        weighted: u (n, 3), k, c -> k K u + c C u, an array that may be the same for all products; K [N/m] and C
            [N s/m] are symmetric and positive semi-definite.
        inverse_mass: [1/kg], shape (n,), 0 where a particle is fixed.
        start: a mode to start from, for example the last one, shape (n, 3).
        tolerance: relative residual of the eigenvalue.
    """
    scale = np.sqrt(inverse_mass)[:, None]
    scaled_u = np.empty((len(inverse_mass), 3))
    stir = _every_direction(len(inverse_mass))

    def along(mode: Floats) -> tuple[float, float]:
        """k = u K u and c = u C u of the normalised mode."""
        scaled = scale * (mode / _norm(mode))
        return float((scaled * weighted(scaled, 1.0, 0.0)).sum()), float((scaled * weighted(scaled, 0.0, 1.0)).sum())

    def both(u: Floats, step: float) -> Floats:
        total = weighted(np.multiply(scale, u, out=scaled_u), step * step, 2.0 * step)
        total *= scale
        return total

    if start is None or not start.any():
        value, mode = largest_eigenpair(lambda u: scale * weighted(scale * u, 1.0, 0.0), stir, tolerance)
        dt = 2.0 / math.sqrt(value) if value > 0.0 else math.inf
    else:
        mode = start
        dt = _limit(*along(mode))
    for _ in range(8):
        # Along the mode found for this dt: dt^2 k + 2 dt c = 4. A new mode can only shorten the step; it settles fast.
        step = min(dt, 1e6)
        before = _stirred(mode, stir)
        del mode  # one vector less while memory is needed most
        value, mode = largest_eigenpair(lambda u, s=step: both(u, s), before, tolerance)  # type: ignore[misc]
        if value <= 0.0:
            return StableStep(math.inf, 0.0, 0.0, mode)
        k, c = along(mode)
        error = value / (step * step * k + 2.0 * step * c)  # what the residual adds
        k, c = k * error, c * error
        dt = _limit(k, c)
        if abs(dt - step) <= tolerance * step:
            break
    # dt comes from above, along modes that need not be the worst of a shorter step. But r times a step, r < 1, has at
    # most r times its largest eigenvalue, so that this one is stable for certain.
    certain = step * min(1.0, 4.0 / value)
    return StableStep(certain, math.sqrt(k), c / (2.0 * math.sqrt(k)) if k > 0.0 else math.inf, mode)


@lru_cache(maxsize=2)
def _every_direction(count: int) -> Floats:
    """A unit vector (count, 3) that is perpendicular to no mode; always the same one."""
    stir = np.random.default_rng(0).standard_normal((count, 3))
    stir /= _norm(stir)
    stir.setflags(write=False)
    return stir


def _limit(k: float, c: float) -> float:
    """The dt of dt^2 k + 2 dt c = 4."""
    return 4.0 / (c + math.sqrt(c * c + 4.0 * k)) if k > 0.0 or c > 0.0 else math.inf


def _stirred(mode: Floats, stir: Floats) -> Floats:
    """A mode and as much of every direction.

    From a mode in the plane of a flat sheet alone, Lanczos never leaves it; and with little of the others it ends at a
    mode that was the stiffest before the cloth moved, and is no longer.
    """
    return np.asarray(mode / _norm(mode) + stir)
