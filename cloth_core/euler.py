"""Equation 6 of the paper: one step of semi-implicit (symplectic) Euler."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel

__all__ = ["semi_implicit_euler"]

Floats = NDArray[np.float64]


@borrowing_kernel
def semi_implicit_euler(x: Floats, v: Floats, force: Floats, inverse_mass: Floats, dt: float) -> None:
    """a = F(t) / m; v(t + dt) = v(t) + dt a; x(t + dt) = x(t) + dt v(t + dt), in place.

    Shapes: x, v [m, m/s] and force [N] (3, at least n); inverse_mass (n,) [1/kg], 0 for what does not move; dt [s].
    """
    for axis in range(3):
        px, pv, f = x[axis], v[axis], force[axis]
        for i in range(inverse_mass.shape[0]):
            pv[i] += dt * inverse_mass[i] * f[i]
            px[i] += dt * pv[i]
