"""Equation 6 of the paper: one step of semi-implicit (symplectic) Euler."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import kernel

__all__ = ["semi_implicit_euler"]

Floats = NDArray[np.float64]


@kernel
def semi_implicit_euler(x: Floats, v: Floats, force: Floats, inverse_mass: Floats, dt: float) -> None:
    """a = F(t) / m; v(t + dt) = v(t) + dt a; x(t + dt) = x(t) + dt v(t + dt), in place.

    Shapes: x, v (n, 3) [m, m/s]; force (3, n) [N]; inverse_mass (n,) [1/kg], 0 for what does not move; dt [s].
    """
    for i in range(x.shape[0]):
        for axis in range(3):
            v[i, axis] += dt * inverse_mass[i] * force[axis, i]
            x[i, axis] += dt * v[i, axis]
