"""The stable time step of an assembled model: its largest eigenfrequency with its damping, not a guess.

Symplectic Euler with explicit damping is stable while dt^2 K + 2 dt C < 4 M (as matrices): for one mode of frequency w
and damping ratio z this is w dt < 2 (sqrt(1 + z^2) - z). The largest eigenvalue comes from the Lanczos method.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel
from cloth_core.lanes import LANES, fill, fused, load, store, take_from

__all__ = ["StableStep", "largest_eigenpair", "stable_time_step"]

Floats = NDArray[np.float64]
Operator = Callable[[Floats], Floats]


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
    from scipy.linalg import eigh_tridiagonal

    shape = start.shape
    norm = _norm(start)
    if norm == 0.0:
        return 0.0, start
    size = start.size
    basis = np.zeros((8, -(-size // LANES) * LANES))  # rows of whole registers
    basis[0, :size] = start.ravel() / norm
    alpha: list[float] = []
    beta: list[float] = []
    value, residual, weights = 0.0, math.inf, np.ones(1)
    w = np.zeros(basis.shape[1])
    for k in range(iterations):
        w[:size] = operator(basis[k, :size].reshape(shape)).ravel()
        alpha.append(_dot(w, basis[k]))
        for _ in range(2):  # full reorthogonalisation: few vectors, no ghosts
            before = math.sqrt(_dot(w, w))
            _orthogonalise(w, basis, k + 1)
            beta_k = math.sqrt(_dot(w, w))
            if beta_k > 0.1 * before:  # else what is left is rounding in part, and a second pass takes that away
                break
        beta.append(beta_k)
        last = beta[-1] <= 1e-12 * max(abs(a) for a in alpha) or k == iterations - 1
        if last or k % 4 == 3:
            # The largest pair alone, in one thread: those of BLAS would wait for each other on a busy machine.
            values, vectors = eigh_tridiagonal(np.array(alpha), np.array(beta[:-1]), select="i", select_range=(k, k))
            value, weights = float(values[0]), vectors[:, 0]
            residual = beta[-1] * abs(float(weights[-1]))
            if last or residual <= tolerance * value:
                break
        if k + 1 == len(basis):
            basis = np.concatenate([basis, np.zeros_like(basis)])
        np.divide(w, beta[-1], out=basis[k + 1])
    ritz = np.zeros(size)
    for c, q in zip(weights, basis, strict=False):
        ritz += c * q[:size]
    return max(value, 0.0) + (residual if value > 0.0 else 0.0), ritz.reshape(shape)


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


@kernel
def _orthogonalise(w: Floats, basis: Floats, count: int) -> None:
    """Take from w its parts along the first rows of a basis, one after the other (modified Gram-Schmidt), in place."""
    for k in range(count):
        q = basis[k]
        part = fill(_dot(w, q))
        for s in range(0, w.shape[0], LANES):
            take_from(w, s, part * load(q, s))


def stable_time_step(
    stiffness: Operator, damping: Operator, inverse_mass: Floats, start: Floats | None = None, tolerance: float = 1e-3
) -> StableStep:
    """Largest dt with dt^2 K + 2 dt C < 4 M.

    Args:
        stiffness, damping: u (n, 3) -> K u [N/m], C u [N s/m], symmetric and positive semi-definite; called one after
            the other with the same array, so that they can share what they have in common.
        inverse_mass: [1/kg], shape (n,), 0 where a particle is fixed.
        start: a mode to start from, for example the last one, shape (n, 3).
        tolerance: relative residual of the eigenvalue.
    """
    scale = np.sqrt(inverse_mass)[:, None]
    stir = np.random.default_rng(0).standard_normal((len(inverse_mass), 3))
    stir /= _norm(stir)

    def along(mode: Floats) -> tuple[float, float]:
        """k = u K u and c = u C u of the normalised mode."""
        unit = mode / _norm(mode)
        scaled = scale * unit
        return float((scaled * stiffness(scaled)).sum()), float((scaled * damping(scaled)).sum())

    def both(u: Floats, step: float) -> Floats:
        scaled = scale * u
        return np.asarray(scale * (step * step * stiffness(scaled) + 2.0 * step * damping(scaled)))

    if start is None or not start.any():
        value, mode = largest_eigenpair(lambda u: scale * stiffness(scale * u), stir, tolerance)
        dt = 2.0 / math.sqrt(value) if value > 0.0 else math.inf
    else:
        mode = start
        dt = _limit(*along(mode))
    for _ in range(8):
        # Along the mode found for this dt: dt^2 k + 2 dt c = 4. A new mode can only shorten the step; it settles fast.
        step = min(dt, 1e6)
        value, mode = largest_eigenpair(
            lambda u, s=step: both(u, s),  # type: ignore[misc]
            _stirred(mode, stir),
            tolerance,
        )
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


def _limit(k: float, c: float) -> float:
    """The dt of dt^2 k + 2 dt c = 4."""
    return 4.0 / (c + math.sqrt(c * c + 4.0 * k)) if k > 0.0 or c > 0.0 else math.inf


def _stirred(mode: Floats, stir: Floats) -> Floats:
    """A mode and as much of every direction.

    From a mode in the plane of a flat sheet alone, Lanczos never leaves it; and with little of the others it ends at a
    mode that was the stiffest before the cloth moved, and is no longer.
    """
    return np.asarray(mode / _norm(mode) + stir)
