"""When cloth is at rest: nothing moves, and nothing is merely about to turn round."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Garment

__all__ = ["RestWatch", "StallWatch", "slowest_swing", "why_restless"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

# Nothing that hangs swings more slowly than this [rad/s]; without gravity it stands for all motion.
_LEAST_FREQUENCY = 2.0
# Movements that do not shrink by this share within the patience do not end.
_SHRINKS = 0.5


def slowest_swing(gravity: Sequence[float], height: float) -> float:
    """Frequency [rad/s] of a pendulum as long as a garment of that height [m]: sqrt(g / l)."""
    g = math.sqrt(sum(a * a for a in gravity))
    return max(math.sqrt(g / height) if height > 0.0 else 0.0, _LEAST_FREQUENCY)


class RestWatch:
    """Watches positions, window after window.

    Cloth that swings stands still for a moment where it turns round. What tells it from cloth at rest is its
    acceleration: in a harmonic motion of frequency w the highest speed is sqrt(v^2 + (a / w)^2) at any moment. Speed v
    and acceleration a are taken from the positions at the ends of two windows, so that what trembles without going
    anywhere does not count, and for w stands the slowest swing that is possible.

    Args:
        displacement: at rest when no particle moves, or in its swing will move, farther than this [m] in a window.
        window: length of a window [s].
        slowest: frequency of the slowest swing [rad/s].
        drag: air drag [1/s] that holds the motion back meanwhile: what pulls at a particle is m (a + drag v).

    Attributes:
        movement: farthest way of any particle in the last window [m]; None before the first one has ended.
        farthest: the particle that went so far.
        displacement, window: as given.
        ratio: of the last two such ways; None before.
    """

    def __init__(self, displacement: float, window: float, slowest: float, drag: float = 0.0) -> None:
        self.displacement, self.window, self._slowest, self._drag = displacement, window, slowest, drag
        self._times: list[float] = []
        self._positions: list[Floats] = []
        self.movement: float | None = None
        self.farthest = 0
        self.ratio: float | None = None

    def open(self, time: float, x: Floats) -> None:
        """Start anew at a time [s] and positions (n, 3) [m]."""
        self._times, self._positions = [time], [x.copy()]
        self.movement = self.ratio = None

    def due(self, time: float) -> bool:
        """Whether a window has ended."""
        return time >= self._times[-1] + self.window

    def at_rest(self, time: float, x: Floats) -> bool:
        """End a window; whether all particles are at rest. It takes two windows at least."""
        return bool(self.still(time, x).all())

    def still(self, time: float, x: Floats) -> Bools:
        """End a window; which particles are at rest, (n,). It takes two windows at least."""
        self._times = [*self._times[-2:], time]
        self._positions = [*self._positions[-2:], x.copy()]
        way = np.sqrt(((self._positions[-1] - self._positions[-2]) ** 2).sum(axis=1))
        self.farthest = int(way.argmax())
        last = float(way[self.farthest])
        self.ratio = last / self.movement if self.movement else None
        self.movement = last
        if len(self._times) < 3:
            return np.zeros(len(x), dtype=bool)
        (x0, x1, x2), (t0, t1, t2) = self._positions, self._times
        before, now = (x1 - x0) / (t1 - t0), (x2 - x1) / (t2 - t1)
        acceleration = (now - before) / ((t2 - t0) / 2.0) + self._drag * now
        highest_speed = np.sqrt((now**2).sum(axis=1) + (acceleration**2).sum(axis=1) / self._slowest**2)
        return np.asarray(highest_speed * self.window <= self.displacement)


class StallWatch:
    """Whether movements still shrink, or cloth trembles for ever: stretched over a body or squeezed in it, for example.

    Attributes:
        since: when they had halved for the last time [s].
    """

    def __init__(self) -> None:
        self.since = 0.0
        self._least = math.inf

    def stalls(self, time: float, movement: float, patience: float) -> bool:
        """Whether they have not halved within a time [s]; movement: the largest in the window that ended at time."""
        if movement < (1.0 - _SHRINKS) * self._least:
            self._least, self.since = movement, time
        return time - self.since > patience


def why_restless(garment: Garment, number: Ints, x: Floats, watch: RestWatch, stalled_for: float) -> str:
    """What moves most at x (k, 3) [m], after movements have not halved for some time [s]; number (n,): see `Model`."""
    place = ", ".join(f"{value:.2f}" for value in x[watch.farthest])
    panel = garment.panel_names[garment.panel_of_particle[int(np.flatnonzero(number == watch.farthest)[0])]]
    return (
        f"does not come to rest: panel '{panel}' at ({place}) m still moves by {1000 * (watch.movement or 0.0):.1f} mm "
        f"in {watch.window:g} s, hardly less than {stalled_for:.0f} s before; see whether it is too tight there"
    )
