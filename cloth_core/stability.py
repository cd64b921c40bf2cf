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
    shape = start.shape
    norm = float(np.linalg.norm(start))
    if norm == 0.0:
        return 0.0, start
    basis = [start.ravel() / norm]
    alpha: list[float] = []
    beta: list[float] = []
    value, residual, weights = 0.0, math.inf, np.ones(1)
    for k in range(iterations):
        w = operator(basis[-1].reshape(shape)).ravel()
        alpha.append(float(w @ basis[-1]))
        for _ in range(2):  # full reorthogonalisation: few vectors, no ghosts
            before = float(np.linalg.norm(w))
            for q in basis:
                w = w - (w @ q) * q
            beta_k = float(np.linalg.norm(w))
            if beta_k > 0.1 * before:  # else what is left is rounding in part, and a second pass takes that away
                break
        beta.append(beta_k)
        last = beta[-1] <= 1e-12 * max(abs(a) for a in alpha) or k == iterations - 1
        if last or k % 4 == 3:
            values, vectors = np.linalg.eigh(np.diag(alpha) + np.diag(beta[:-1], 1) + np.diag(beta[:-1], -1))
            value, weights = float(values[-1]), vectors[:, -1]
            residual = beta[-1] * abs(float(weights[-1]))
            if last or residual <= tolerance * value:
                break
        basis.append(w / beta[-1])
    ritz = sum(c * q for c, q in zip(weights, basis, strict=False))
    return max(value, 0.0) + (residual if value > 0.0 else 0.0), np.asarray(ritz).reshape(shape)


def stable_time_step(
    stiffness: Operator, damping: Operator, inverse_mass: Floats, start: Floats | None = None, tolerance: float = 1e-3
) -> StableStep:
    """Largest dt with dt^2 K + 2 dt C < 4 M.

    Args:
        stiffness, damping: u (n, 3) -> K u [N/m], C u [N s/m], symmetric and positive semi-definite.
        inverse_mass: [1/kg], shape (n,), 0 where a particle is fixed.
        start: a mode to start from, for example the last one, shape (n, 3).
        tolerance: relative residual of the eigenvalue.
    """
    scale = np.sqrt(inverse_mass)[:, None]
    stir = np.random.default_rng(0).standard_normal((len(inverse_mass), 3))
    stir /= np.linalg.norm(stir)

    def along(mode: Floats) -> tuple[float, float]:
        """k = u K u and c = u C u of the normalised mode."""
        unit = mode / np.linalg.norm(mode)
        k = float((unit * scale * stiffness(scale * unit)).sum())
        return k, float((unit * scale * damping(scale * unit)).sum())

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
            lambda u, s=step: scale * (s * s * stiffness(scale * u) + 2.0 * s * damping(scale * u)),  # type: ignore[misc]
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
    return np.asarray(mode / np.linalg.norm(mode) + stir)
