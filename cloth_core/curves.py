"""Plane curves that panel edges are made of: line, quadratic and cubic Bezier curve, circular arc.

Points are in metres. Each curve knows its length, its contribution to the area of a closed outline (Green's theorem)
and how to place points at equal distances along itself. Curves do not change; they compare equal when their points do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import asinh, atan2, copysign, cos, hypot, sin, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["CircularArc", "CubicBezier", "Curve", "Line", "Point", "QuadraticBezier"]

Point = tuple[float, float]
FloatArray = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # for the interval [0, 1]
_MAX_HALVINGS = 40  # a cusp, where the speed is zero, is approached to 1e-12 of the parameter range
_LENGTH_TOLERANCE = 1e-14  # of the length of the control polygon


class Curve(Protocol):
    """A plane curve with a parameter t from 0 at `start` to 1 at `end`."""

    @property
    def start(self) -> Point:
        """First point [m]."""

    @property
    def end(self) -> Point:
        """Last point [m]."""

    @property
    def length(self) -> float:
        """Arc length [m]."""

    @property
    def area_term(self) -> float:
        """1/2 * integral of (x dy - y dx) along the curve [m^2].

        Summed over a closed outline it is the enclosed area, positive if the outline runs counter-clockwise.
        """

    def point(self, t: ArrayLike) -> FloatArray:
        """Points at the parameters `t` (k,), shape (k, 2) [m]; a single parameter gives shape (2,)."""

    def sample(self, count: int) -> FloatArray:
        """`count` points at equal distances along the curve, both ends included exactly, shape (count, 2) [m].

        ValueError if count < 2.
        """

    def reversed(self) -> Curve:
        """The same points, run through from `end` to `start`."""

    def mirrored(self) -> Curve:
        """The mirror image (-x, y)."""

    def translated(self, x: float, y: float) -> Curve:
        """The curve moved by (x, y) [m]."""


@dataclass(frozen=True)
class Line:
    """Straight line from `start` to `end` [m]."""

    start: Point
    end: Point

    @property
    def length(self) -> float:
        """Distance between the ends [m]."""
        return hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])

    @property
    def area_term(self) -> float:
        """Area of the triangle origin, start, end [m^2]."""
        return 0.5 * _cross(self.start, self.end)

    def point(self, t: ArrayLike) -> FloatArray:
        """Points at the parameters `t` (k,), shape (k, 2) [m]."""
        s: FloatArray = np.asarray(t, dtype=float)[..., None]
        points: FloatArray = (1.0 - s) * np.array(self.start) + s * np.array(self.end)
        return points

    def sample(self, count: int) -> FloatArray:
        """`count` equally spaced points, shape (count, 2) [m]."""
        return _with_exact_ends(self.point(_fractions(count)), self.start, self.end)

    def reversed(self) -> Line:
        """The line from `end` to `start`."""
        return Line(self.end, self.start)

    def mirrored(self) -> Line:
        """The mirror image (-x, y)."""
        return Line(_mirror(self.start), _mirror(self.end))

    def translated(self, x: float, y: float) -> Line:
        """The curve moved by (x, y) [m]."""
        return Line(_moved(self.start, x, y), _moved(self.end, x, y))


@dataclass(frozen=True)
class QuadraticBezier:
    """Parabola from `start` to `end` that leaves and arrives in the direction of `control` [m]."""

    start: Point
    control: Point
    end: Point

    @cached_property
    def length(self) -> float:
        """Arc length [m], in closed form.

        The velocity is v + t w. With u its component along w and q the one across, the speed is sqrt(u^2 + q^2), and
        du = |w| dt.
        """
        v, w = self._velocity
        scale, turn = hypot(*v), hypot(*w)
        if (
            turn <= 1e-2 * scale
        ):  # the closed form cancels where the speed hardly changes, quadrature is exact to rounding there
            return float(_integrate_speed(np.array([v, w]), np.array([0.0]), np.array([1.0]))[0])
        along = (v[0] * w[0] + v[1] * w[1]) / turn
        across = abs(_cross(w, v)) / turn
        return (_parabola_integral(along + turn, across) - _parabola_integral(along, across)) / turn

    @property
    def area_term(self) -> float:
        """1/2 * integral of (x dy - y dx) [m^2], exact."""
        p, q, r = self.start, self.control, self.end
        return (2.0 * _cross(p, q) + 2.0 * _cross(q, r) + _cross(p, r)) / 6.0

    def point(self, t: ArrayLike) -> FloatArray:
        """Points at the parameters `t` (k,), shape (k, 2) [m]."""
        s: FloatArray = np.asarray(t, dtype=float)[..., None]
        p, q, r = np.array([self.start, self.control, self.end])
        points: FloatArray = (1.0 - s) ** 2 * p + 2.0 * s * (1.0 - s) * q + s**2 * r
        return points

    def sample(self, count: int) -> FloatArray:
        """`count` points at equal distances along the curve, shape (count, 2) [m]."""
        t = _parameters_at_equal_distances(np.array(self._velocity), count)
        return _with_exact_ends(self.point(t), self.start, self.end)

    def reversed(self) -> QuadraticBezier:
        """The same points from `end` to `start`."""
        return QuadraticBezier(self.end, self.control, self.start)

    def mirrored(self) -> QuadraticBezier:
        """The mirror image (-x, y)."""
        return QuadraticBezier(_mirror(self.start), _mirror(self.control), _mirror(self.end))

    def translated(self, x: float, y: float) -> QuadraticBezier:
        """The curve moved by (x, y) [m]."""
        return QuadraticBezier(_moved(self.start, x, y), _moved(self.control, x, y), _moved(self.end, x, y))

    @property
    def _velocity(self) -> tuple[Point, Point]:
        """Coefficients of 1 and t of the derivative."""
        (px, py), (qx, qy), (rx, ry) = self.start, self.control, self.end
        return (2.0 * (qx - px), 2.0 * (qy - py)), (2.0 * (px - 2.0 * qx + rx), 2.0 * (py - 2.0 * qy + ry))


@dataclass(frozen=True)
class CubicBezier:
    """Cubic Bezier curve from `start` to `end` with two control points [m]."""

    start: Point
    first_control: Point
    second_control: Point
    end: Point

    @cached_property
    def length(self) -> float:
        """Arc length [m] by adaptive Gauss-Legendre quadrature, to about 1e-13 of itself."""
        return float(_length_table(self._velocity)[1][-1])

    @property
    def area_term(self) -> float:
        """1/2 * integral of (x dy - y dx) [m^2], exact."""
        p, q, r, s = self.start, self.first_control, self.second_control, self.end
        ends = 6.0 * _cross(p, q) + 6.0 * _cross(r, s) + _cross(p, s)
        return (ends + 3.0 * (_cross(p, r) + _cross(q, r) + _cross(q, s))) / 20.0

    def point(self, t: ArrayLike) -> FloatArray:
        """Points at the parameters `t` (k,), shape (k, 2) [m]."""
        v: FloatArray = np.asarray(t, dtype=float)[..., None]
        u = 1.0 - v
        p, q, r, s = np.array([self.start, self.first_control, self.second_control, self.end])
        points: FloatArray = u**3 * p + 3.0 * v * u**2 * q + 3.0 * v**2 * u * r + v**3 * s
        return points

    def sample(self, count: int) -> FloatArray:
        """`count` points at equal distances along the curve, shape (count, 2) [m]."""
        return _with_exact_ends(self.point(_parameters_at_equal_distances(self._velocity, count)), self.start, self.end)

    def reversed(self) -> CubicBezier:
        """The same points from `end` to `start`."""
        return CubicBezier(self.end, self.second_control, self.first_control, self.start)

    def mirrored(self) -> CubicBezier:
        """The mirror image (-x, y)."""
        p, q, r, s = (_mirror(point) for point in (self.start, self.first_control, self.second_control, self.end))
        return CubicBezier(p, q, r, s)

    def translated(self, x: float, y: float) -> CubicBezier:
        """The curve moved by (x, y) [m]."""
        p, q, r, s = (_moved(point, x, y) for point in (self.start, self.first_control, self.second_control, self.end))
        return CubicBezier(p, q, r, s)

    @property
    def _velocity(self) -> FloatArray:
        """Coefficients of 1, t and t^2 of the derivative, shape (3, 2)."""
        p, q, r, s = np.array([self.start, self.first_control, self.second_control, self.end])
        return np.array([3.0 * (q - p), 6.0 * (p - 2.0 * q + r), 3.0 * (s - p + 3.0 * (q - r))])


@dataclass(frozen=True)
class CircularArc:
    """Arc of a circle from `start` to `end` [m].

    `right`: it bulges to the right of start -> end, which is a counter-clockwise turn. `large_arc`: it is the longer of
    the two such arcs. A radius below half the distance of the ends is taken as just that: a half circle.
    """

    start: Point
    end: Point
    radius: float
    large_arc: bool
    right: bool

    @cached_property
    def half_angle(self) -> float:
        """Half the angle that the arc subtends at the centre [rad], between 0 and pi."""
        half_chord = 0.5 * hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])
        radius = max(self.radius, half_chord)
        height = sqrt((radius - half_chord) * (radius + half_chord))  # of the centre over the chord
        return atan2(half_chord, -height if self.large_arc else height)

    @property
    def length(self) -> float:
        """Radius times angle [m]."""
        return 2.0 * self._radius * self.half_angle

    @property
    def area_term(self) -> float:
        """Triangle of origin and chord, and the circular segment between chord and arc [m^2]."""
        segment = self._radius**2 * (self.half_angle - sin(self.half_angle) * cos(self.half_angle))
        return 0.5 * _cross(self.start, self.end) + (segment if self.right else -segment)

    def point(self, t: ArrayLike) -> FloatArray:
        """Points at the parameters `t` (k,), shape (k, 2) [m]."""
        angle = (2.0 * np.asarray(t, dtype=float) - 1.0) * self.half_angle
        start, end = np.array(self.start), np.array(self.end)
        along = (end - start) / np.linalg.norm(end - start)
        across = np.array([along[1], -along[0]]) if self.right else np.array([-along[1], along[0]])
        x = self._radius * np.sin(angle)
        # cos(angle) - cos(half_angle) as a product: no cancellation for a nearly straight arc of a huge circle
        y = 2.0 * self._radius * np.sin(0.5 * (self.half_angle + angle)) * np.sin(0.5 * (self.half_angle - angle))
        points: FloatArray = 0.5 * (start + end) + x[..., None] * along + y[..., None] * across
        return points

    def sample(self, count: int) -> FloatArray:
        """`count` points at equal distances along the arc, shape (count, 2) [m]."""
        return _with_exact_ends(self.point(_fractions(count)), self.start, self.end)

    def reversed(self) -> CircularArc:
        """The same points from `end` to `start`."""
        return CircularArc(self.end, self.start, self.radius, self.large_arc, not self.right)

    def mirrored(self) -> CircularArc:
        """The mirror image (-x, y)."""
        return CircularArc(_mirror(self.start), _mirror(self.end), self.radius, self.large_arc, not self.right)

    def translated(self, x: float, y: float) -> CircularArc:
        """The curve moved by (x, y) [m]."""
        return replace(self, start=_moved(self.start, x, y), end=_moved(self.end, x, y))

    @property
    def _radius(self) -> float:
        return max(self.radius, 0.5 * hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))


def _cross(a: Point, b: Point) -> float:
    return a[0] * b[1] - a[1] * b[0]


def _mirror(point: Point) -> Point:
    return (-point[0], point[1])


def _moved(point: Point, x: float, y: float) -> Point:
    return (point[0] + x, point[1] + y)


def _fractions(count: int) -> FloatArray:
    if count < 2:
        raise ValueError(f"a curve is sampled by at least its 2 ends, not by {count} points")
    return np.linspace(0.0, 1.0, count)


def _with_exact_ends(points: FloatArray, start: Point, end: Point) -> FloatArray:
    points[0], points[-1] = start, end
    return points


def _parabola_integral(u: float, q: float) -> float:
    """Integral of sqrt(u^2 + q^2) du; odd in u."""
    if q == 0.0:
        return copysign(0.5 * u * u, u)
    return 0.5 * (u * hypot(u, q) + q * q * asinh(u / q))


def _speed(velocity: FloatArray, t: FloatArray) -> FloatArray:
    """|sum velocity[k] t^k| at each t; velocity (degree + 1, 2)."""
    vector = np.zeros((*t.shape, 2))
    for coefficient in velocity[::-1]:
        vector = vector * t[..., None] + coefficient
    return np.hypot(vector[..., 0], vector[..., 1])


def _integrate_speed(velocity: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Gauss-Legendre integral of the speed over each interval [low[i], high[i]], 16 nodes."""
    width = high - low
    return width * (_speed(velocity, low[:, None] + width[:, None] * _NODES) @ _WEIGHTS)


def _length_table(velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parameters (k,) and the length [m] up to each (k,).

    Intervals are halved until the quadrature agrees with that of the halves.
    """
    low, high = np.array([0.0]), np.array([1.0])
    tolerance = _LENGTH_TOLERANCE * float(np.hypot(velocity[:, 0], velocity[:, 1]).sum())
    knots: list[FloatArray] = []
    pieces: list[FloatArray] = []
    whole = _integrate_speed(velocity, low, high)
    for halving in range(_MAX_HALVINGS + 1):
        middle = 0.5 * (low + high)
        left, right = _integrate_speed(velocity, low, middle), _integrate_speed(velocity, middle, high)
        done = (np.abs(left + right - whole) <= tolerance) | (halving == _MAX_HALVINGS)
        knots += [middle[done], high[done]]  # the halves, as they are more exact than the tolerance says
        pieces += [left[done], right[done]]
        low, high = np.concatenate([low[~done], middle[~done]]), np.concatenate([middle[~done], high[~done]])
        whole = np.concatenate([left[~done], right[~done]])
        if done.all():
            break
    ends, lengths = np.concatenate(knots), np.concatenate(pieces)
    order = np.argsort(ends)
    return np.concatenate([[0.0], ends[order]]), np.concatenate([[0.0], np.cumsum(lengths[order])])


def _parameters_at_equal_distances(velocity: FloatArray, count: int) -> FloatArray:
    """Parameters (count,) of points at equal distances: Newton's iteration, kept inside a shrinking bracket."""
    knots, lengths = _length_table(velocity)
    target = _fractions(count) * lengths[-1]
    piece = np.clip(np.searchsorted(lengths, target, side="right") - 1, 0, len(knots) - 2)
    low, high = knots[piece], knots[piece + 1]
    origin, before = low.copy(), lengths[piece]
    share = (target - before) / np.maximum(lengths[piece + 1] - before, np.finfo(float).tiny)
    t: FloatArray = low + np.clip(share, 0.0, 1.0) * (high - low)
    for _ in range(60):  # bisection alone ends in 52
        excess = before + _integrate_speed(velocity, origin, t) - target
        high, low = np.where(excess > 0.0, t, high), np.where(excess > 0.0, low, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t - excess / _speed(velocity, t)
        inside = (newton >= low) & (newton <= high)  # false where the speed is zero
        step = np.where(inside, newton, 0.5 * (low + high))
        moved = float(np.abs(step - t).max())
        t = step
        if moved <= 1e-15:
            break
    return t
