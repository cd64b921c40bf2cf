"""On which side of a plane a point lies: the exact sign, at any distance from the origin and for any sliver.

Floating point decides where its own error bound lets it; elsewhere the determinant is summed without any rounding as an
expansion, a sum of numbers that do not overlap (Shewchuk, "Adaptive precision floating-point arithmetic and fast robust
geometric predicates", 1997). Exact as long as no product of three coordinates under- or overflows: coordinates that are
0 or between 1e-80 and 1e80 m.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cloth_core.kernel import borrowing_kernel, inlined_kernel, kernel, zero

__all__ = ["exact_orientation", "orientation", "quick_orientation"]

Floats = NDArray[np.float64]

# Error bound of the determinant below, relative to the sum of the magnitudes of its terms (Shewchuk, o3derrboundA).
_ERROR_BOUND = (7.0 + 56.0 * 2.0**-53) * 2.0**-53
# 2^27 + 1: cuts the 53 bits of a number into two halves of which products are exact.
_SPLITTER = 134217729.0
# 24 products of three numbers, each exactly the sum of at most four.
_MOST_PARTS = 96


@borrowing_kernel
def orientation(a: Floats, b: Floats, c: Floats, d: Floats) -> int:
    """1 if d lies on the side of abc from which abc runs counter-clockwise, -1 on the other, 0 in its plane; all (3,).

    The sign of the volume of the tetrahedron abcd, (b - a) x (c - a) . (d - a) / 6.
    """
    sign = quick_orientation(a, b, c, d)
    return sign if sign != 0 else exact_orientation(a, b, c, d)


@borrowing_kernel
def quick_orientation(a: Floats, b: Floats, c: Floats, d: Floats) -> int:
    """As `orientation` where floating point is sure of the sign, 0 where it is not."""
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    bycz, bzcy = by * cz, bz * cy
    bzcx, bxcz = bz * cx, bx * cz
    bxcy, bycx = bx * cy, by * cx
    volume = dx * (bycz - bzcy) + dy * (bzcx - bxcz) + dz * (bxcy - bycx)
    magnitude = (
        abs(dx) * (abs(bycz) + abs(bzcy)) + abs(dy) * (abs(bzcx) + abs(bxcz)) + abs(dz) * (abs(bxcy) + abs(bycx))
    )
    if volume > _ERROR_BOUND * magnitude:
        return 1
    if volume < -_ERROR_BOUND * magnitude:
        return -1
    return 0


@inlined_kernel
def _exact_product(x: float, y: float) -> tuple[float, float]:
    """Product, and what its rounding left out (Dekker 1971)."""
    product = x * y
    big = _SPLITTER * x
    x_high = big - (big - x)
    x_low = x - x_high
    big = _SPLITTER * y
    y_high = big - (big - y)
    y_low = y - y_high
    rest = x_low * y_low - (((product - x_high * y_high) - x_low * y_high) - x_high * y_low)
    return product, rest


@borrowing_kernel
def _add(parts: Floats, count: int, value: float) -> int:
    """Add a number to an expansion without rounding (Shewchuk's Grow-Expansion, zeros left out); its new length."""
    kept = 0
    total = value
    for i in range(count):
        part = parts[i]
        new = total + part
        virtual = new - total
        rest = (total - (new - virtual)) + (part - virtual)
        total = new
        if rest != 0.0:
            parts[kept] = rest
            kept += 1
    if total != 0.0:
        parts[kept] = total
        kept += 1
    return kept


@kernel
def exact_orientation(a: Floats, b: Floats, c: Floats, d: Floats) -> int:
    """As `orientation`, always without rounding: the determinant of the rows (point, 1), expanded into 24 products."""
    parts = np.zeros(_MOST_PARTS)
    count = zero()
    points = (a, b, c, d)
    for without in range(4):
        # Minor of the three other points, det [p; q; r], with the sign of its place in the expansion along the ones.
        p, q, r = points[1 if without == 0 else 0], points[2 if without <= 1 else 1], points[3 if without <= 2 else 2]
        sign = 1.0 if without % 2 == 0 else -1.0
        for k in range(3):
            for turn in range(2):
                i, j = (k + 1) % 3, (k + 2) % 3
                s = sign
                if turn == 1:
                    i, j = j, i
                    s = -sign
                high, low = _exact_product(s * p[k], q[i])
                for factor in (high, low):
                    product, rest = _exact_product(factor, r[j])
                    count = _add(parts, count, rest)
                    count = _add(parts, count, product)
    if count == 0:
        return 0
    # The largest part comes last and outweighs all others together.
    return 1 if parts[count - 1] > 0.0 else -1
