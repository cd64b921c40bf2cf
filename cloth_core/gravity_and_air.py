"""Gravity G = m g and air resistance F_a = -m k_a (v - wind) (paper, section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel

__all__ = ["air_drag_forces", "gravity_forces"]

Floats = NDArray[np.float64]


@kernel
def gravity_forces(mass: Floats, gravity: Floats, force: Floats) -> None:
    """Set the force to m g; mass (n,) [kg], gravity (3,) [m/s^2], force (n, 3) [N]."""
    for i in range(mass.shape[0]):
        for axis in range(3):
            force[i, axis] = mass[i] * gravity[axis]


@kernel
def air_drag_forces(v: Floats, mass: Floats, air_drag: float, force: Floats) -> None:
    """Add -m k_a v; v (n, 3) [m/s], mass (n,) [kg], air_drag k_a [1/s], force (n, 3) [N].

    The terminal speed of free fall is g / k_a at any time step; steps beyond 2 / k_a diverge.
    """
    for i in range(mass.shape[0]):
        for axis in range(3):
            force[i, axis] -= mass[i] * air_drag * v[i, axis]
