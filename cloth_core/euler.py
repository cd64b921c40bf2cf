"""Equation 6 of the paper: one step of semi-implicit (symplectic) Euler."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel

__all__ = ["euler_by_axis", "semi_implicit_euler"]

Floats = NDArray[np.float64]


@kernel
def semi_implicit_euler(x: Floats, v: Floats, force: Floats, inverse_mass: Floats, dt: float) -> None:
    """a = F(t) / m; v(t + dt) = v(t) + dt a; x(t + dt) = x(t) + dt v(t + dt), in place.

    Shapes: x, v (n, 3) [m, m/s]; force (3, n) [N]; inverse_mass (n,) [1/kg], 0 for what does not move; dt [s].
    """
    fx, fy, fz = force[0], force[1], force[2]
    for i in range(x.shape[0]):
        share = dt * inverse_mass[i]
        v[i, 0] += share * fx[i]
        v[i, 1] += share * fy[i]
        v[i, 2] += share * fz[i]
        x[i, 0] += dt * v[i, 0]
        x[i, 1] += dt * v[i, 1]
        x[i, 2] += dt * v[i, 2]


@kernel
def euler_by_axis(x: Floats, v: Floats, force: Floats, inverse_mass: Floats, dt: float) -> None:
    """The same to the bit for x, v, force with a row for each axis, (3, at least n)."""
    for axis in range(3):
        px, pv, f = x[axis], v[axis], force[axis]
        for i in range(inverse_mass.shape[0]):
            pv[i] += dt * inverse_mass[i] * f[i]
            px[i] += dt * pv[i]
