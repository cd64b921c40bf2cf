"""When seams that stay open are given up before their time is over: what holds them apart will not go away.

A limb does not leave a seam, and cloth that is stretched far beyond what its fabric allows does not reach around a body
if it is pulled for longer. Cloth that closes does so within a few looks, by far less pull and with hardly any stretch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Garment, Seam

__all__ = ["SeamHope", "far_points", "stretch_beside"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Seams get nearer when all that is still open, added up, has become less by this share.
_NEARER = 0.02
# At the full pull they may get no nearer for so long [s],
_PATIENCE = 0.3
# and before that only as long as the pull is less than so many times what it was when they last got nearer.
_IN_VAIN = 1.9
# Cloth beside them that is stretched by this many times the fabric's limit at so many looks running is too tight,
# unless what is open became less by this share meanwhile,
_TOO_TIGHT, _LOOKS, _YIELDS = 2.0, 4, 0.2
# or is no longer than this, all in all [m]: a few points may still slip past what holds them apart.
_LONG = 0.2
# A side is along warp or weft if it leaves it by less than this slope.
_ALONG = 0.2


class SeamHope:
    """Watches what is still open of a garment's seams, from one look at them to the next."""

    def __init__(self) -> None:
        self._least = self._then = math.inf
        self._pull_then = 1.0
        self._hopeful_until = 0.0
        self._tight: list[float] = []

    def lost(self, still_open: float, length: float, stretch: float, pull: float, full_pull: bool, time: float) -> bool:
        """Whether the seams will not close any more; to be asked at each look.

        Args:
            still_open: gaps of all points that are too far apart to merge, added up [m].
            length: of the seams that have such points, only as far as these go [m].
            stretch: of the cloth beside those points, as a multiple of the fabric's strain limit.
            pull: how hard the seams are pulled, as a multiple of what they were pulled with at first.
            full_pull: whether they are not pulled any harder.
            time: simulated [s].
        """
        if still_open < (1.0 - _NEARER) * self._then:
            self._then, self._pull_then = still_open, pull
        if still_open < (1.0 - _NEARER) * self._least or not full_pull:
            self._hopeful_until = time + _PATIENCE
        self._least = min(self._least, still_open)
        is_tight = stretch >= _TOO_TIGHT and length > _LONG
        self._tight = [*self._tight, still_open][-_LOOKS:] if is_tight else []
        if still_open <= 0.0:
            return False
        too_tight = len(self._tight) == _LOOKS and still_open > (1.0 - _YIELDS) * self._tight[0]
        return too_tight or pull >= _IN_VAIN * self._pull_then or time >= self._hopeful_until


def far_points(seams: Sequence[Seam], x: Floats, limit: float) -> tuple[Ints, float]:
    """Points of seams that are farther from each other than limit [m] at x (n, 3) [m]; their gaps, added up [m]."""
    points, total = [np.zeros(0, dtype=np.int32)], 0.0
    for seam in seams:
        gap = np.linalg.norm(x[seam.first] - x[seam.second], axis=1)
        far = gap > limit
        points += [seam.first[far], seam.second[far]]
        total += float(gap[far].sum())
    return np.concatenate(points), total


def stretch_beside(garment: Garment, points: Ints, x: Floats) -> float:
    """Largest stretch along warp and weft of the cloth around some points at x (n, 3) [m]; 0 if there are none."""
    triangles = garment.triangles[np.isin(garment.triangles, points).any(axis=1)]
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    way = np.abs(garment.rest[sides[:, 0]] - garment.rest[sides[:, 1]])
    sides, way = (each[way.min(axis=1) < _ALONG * way.max(axis=1)] for each in (sides, way))
    rest = np.linalg.norm(way, axis=1)
    length = np.linalg.norm(x[sides[:, 0]] - x[sides[:, 1]], axis=1)
    return float((length / rest - 1.0).max(initial=0.0))
