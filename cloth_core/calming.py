"""Brakes cloth on its way to rest, where only the end of that way matters.

As in the FIRE method (Bitzek et al. 2006), but softly and for each particle by itself: a fold that still creeps to its
place is not held back because something else swings.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel

__all__ = ["Calming", "limit_speed"]

Floats = NDArray[np.float64]

# Rate at which particles that slow down are braked [1/s].
_BRAKING = 30.0
# Braking ends when movements are this share of what counts as rest,
_CALM = 0.5
# and for a drape that is only a start for a finer one when they are this many times it.
_NEARLY = 3.0
# Fastest that anything moves on the way to rest [m/s]: about as fast as a hem falls. What is faster is cloth that snaps
# back where it was held, by a seam that merges for example.
_RUSH = 3.0


class Calming:
    """Brakes until little moves, and again when what stayed free of it moves too much.

    Attributes:
        active: whether it brakes.
        rough: whether the drape is only a start for a finer one.
    """

    def __init__(self) -> None:
        self.active = True
        self.rough = False
        self._before = np.zeros((0, 3))

    def start(self, v: Floats) -> None:
        """Compare with these velocities [m/s], (n, 3), next."""
        self._before = v.copy()

    def brake(self, v: Floats, elapsed: float) -> None:
        """Slow down, in place, what has become slower within `elapsed` [s]: it has passed the place it is drawn to.

        What turns round, or trembles because layers push it to and fro, stops.
        """
        _brake(v, self._before, math.exp(-_BRAKING * elapsed))

    def ended(self, movement: float, allowed: float) -> bool:
        """Stop braking if the movement in a window is small enough [m], to see whether all stays when nothing does."""
        self.active = movement > (_NEARLY if self.rough else _CALM) * allowed
        return not self.active

    def resume(self, movement: float, allowed: float) -> None:
        """Brake again if the movement in a window [m] without it is more than allowed at rest."""
        self.active = movement > allowed


@borrowing_kernel
def limit_speed(v: Floats) -> None:
    """Slow down, in place, what is faster than 3 m/s; v (n, 3) [m/s]."""
    for i in range(v.shape[0]):
        speed = np.sqrt(v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1] + v[i, 2] * v[i, 2])
        if speed > _RUSH:
            for axis in range(3):
                v[i, axis] *= _RUSH / speed


@borrowing_kernel
def _brake(v: Floats, before: Floats, share: float) -> None:
    """Multiply what is slower than before by share, stop what has turned round, and note v (n, 3) as before."""
    for i in range(v.shape[0]):
        now = v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1] + v[i, 2] * v[i, 2]
        both = before[i, 0] * v[i, 0] + before[i, 1] * v[i, 1] + before[i, 2] * v[i, 2]
        factor = 0.0 if both < 0.0 else (share if now < both else 1.0)
        for axis in range(3):
            v[i, axis] *= factor
            before[i, axis] = v[i, axis]
