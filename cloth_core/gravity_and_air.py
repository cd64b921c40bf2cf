"""Gravity G = m g and air resistance F_a = -m k_a (v - wind) (paper, section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel

__all__ = ["air_drag_forces", "gravity_forces"]

Floats = NDArray[np.float64]


@borrowing_kernel
def gravity_forces(mass: Floats, gravity: Floats, force: Floats) -> None:
    """Set the force to m g; mass (n,) [kg], gravity (3,) [m/s^2], force (3, n) [N]."""
    for axis in range(3):
        f, g = force[axis], gravity[axis]
        for i in range(mass.shape[0]):
            f[i] = mass[i] * g


@borrowing_kernel
def air_drag_forces(v: Floats, mass: Floats, air_drag: float, force: Floats) -> None:
    """Add -m k_a v; v (3, n) [m/s], mass (n,) [kg], air_drag k_a [1/s], force (3, n) [N].

    The terminal speed of free fall is g / k_a at any time step; steps beyond 2 / k_a diverge.
    """
    for axis in range(3):
        f, u = force[axis], v[axis]
        for i in range(mass.shape[0]):
            f[i] -= mass[i] * air_drag * u[i]
