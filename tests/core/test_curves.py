"""Lengths, areas and sampling of panel edges, against closed forms, quadrature, shapely and svgpathtools."""

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
import svgpathtools
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from cloth_core.curves import CircularArc, CubicBezier, Curve, Line, QuadraticBezier

CURVES = {
    "line": Line((0.1, -0.2), (0.7, 0.4)),
    "parabola": QuadraticBezier((0.0, 0.0), (0.3, 0.5), (1.0, 0.1)),
    "almost straight parabola": QuadraticBezier((0.0, 0.0), (0.5001, 0.0002), (1.0, 0.0)),
    "parabola that turns back": QuadraticBezier((0.0, 0.0), (1.0, 0.01), (0.2, 0.0)),
    "parabola with its control at the start": QuadraticBezier((0.0, 0.0), (0.0, 0.0), (1.0, 0.3)),
    "cubic": CubicBezier((0.0, 0.0), (0.2, 0.6), (0.9, -0.4), (1.0, 0.3)),
    "straight cubic": CubicBezier((0.0, 0.0), (0.2, 0.1), (0.7, 0.35), (1.0, 0.5)),
    "cubic with a cusp": CubicBezier((0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)),
    "cubic with a loop": CubicBezier((0.0, 0.0), (1.4, 1.0), (-0.4, 1.0), (1.0, 0.0)),
    "short arc to the right": CircularArc((0.0, 0.0), (1.0, 0.2), 0.8, large_arc=False, right=True),
    "short arc to the left": CircularArc((0.0, 0.0), (1.0, 0.2), 0.8, large_arc=False, right=False),
    "long arc to the right": CircularArc((0.0, 0.0), (1.0, 0.2), 0.8, large_arc=True, right=True),
    "long arc to the left": CircularArc((0.0, 0.0), (1.0, 0.2), 0.8, large_arc=True, right=False),
    "half circle": CircularArc((0.0, 0.0), (1.0, 0.0), 0.5, large_arc=False, right=True),
}

each_curve = pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES.keys())

coordinate = st.floats(-2.0, 2.0)
point = st.tuples(coordinate, coordinate)


def as_svg(curve: Curve):
    """The same curve as svgpathtools knows it; its sweep flag is our `right`, as both take y upwards here."""
    z = lambda p: complex(*p)  # noqa: E731
    match curve:
        case Line(start, end):
            return svgpathtools.Line(z(start), z(end))
        case QuadraticBezier(start, control, end):
            return svgpathtools.QuadraticBezier(z(start), z(control), z(end))
        case CubicBezier(start, first, second, end):
            return svgpathtools.CubicBezier(z(start), z(first), z(second), z(end))
        case CircularArc(start, end, radius, large_arc, right):
            return svgpathtools.Arc(z(start), complex(radius, radius), 0, large_arc, right, z(end))


def length_by_quadrature(curve: Curve, low: float = 0.0, high: float = 1.0) -> float:
    """Integral of the speed, which svgpathtools' derivative gives; split at the middle, where the cusp is."""
    svg = as_svg(curve)
    pieces = sorted({low, high, *(t for t in (0.5,) if low < t < high)})
    return sum(
        quad(lambda t: abs(svg.derivative(t)), a, b, epsabs=1e-13, epsrel=1e-13, limit=400)[0]
        for a, b in pairwise(pieces)
    )


@each_curve
def test_points_are_those_of_svgpathtools(curve):
    t = np.linspace(0.0, 1.0, 23)
    expected = np.array([as_svg(curve).point(value) for value in t])
    assert np.allclose(curve.point(t), np.column_stack([expected.real, expected.imag]), rtol=0.0, atol=1e-12)


@each_curve
def test_length_is_the_integral_of_the_speed(curve):
    assert curve.length == pytest.approx(length_by_quadrature(curve), rel=1e-12)


@each_curve
def test_area_term_is_that_of_a_fine_polygon(curve):
    origin = (0.3, -5.0)  # far from the curve, so that the outline origin -> curve -> origin is simple but for loops
    outline = Line(origin, curve.start).area_term + curve.area_term + Line(curve.end, origin).area_term
    x, y = np.vstack([origin, curve.point(np.linspace(0.0, 1.0, 200_001))]).T
    assert outline == pytest.approx(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)), abs=1e-9)


@each_curve
def test_samples_are_equally_spaced_and_end_exactly(curve):
    points = curve.sample(12)
    assert points.shape == (12, 2)
    assert tuple(points[0]) == curve.start
    assert tuple(points[-1]) == curve.end
    fine = curve.point(np.linspace(0.0, 1.0, 400_001))
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    expected = np.column_stack([np.interp(np.linspace(0.0, distance[-1], 12), distance, axis) for axis in fine.T])
    assert np.allclose(points, expected, rtol=0.0, atol=1e-9)


@each_curve
def test_reversed_curve_has_the_same_points_and_the_opposite_area(curve):
    backward = curve.reversed()
    assert backward.length == pytest.approx(curve.length, rel=1e-14)
    assert backward.area_term == pytest.approx(-curve.area_term, abs=1e-15)
    assert np.allclose(backward.sample(9)[::-1], curve.sample(9), rtol=0.0, atol=1e-12)
    assert backward.reversed() == curve


@each_curve
def test_mirror_image_and_translation(curve):
    t = np.linspace(0.0, 1.0, 7)
    assert np.allclose(curve.mirrored().point(t), curve.point(t) * (-1.0, 1.0), rtol=0.0, atol=1e-15)
    assert np.allclose(
        curve.translated(0.5, -2.0).point(t), curve.point(t) + np.array([0.5, -2.0]), rtol=0.0, atol=1e-14
    )


@each_curve
def test_a_single_parameter_gives_a_single_point(curve):
    assert curve.point(0.25).shape == (2,)
    assert np.array_equal(curve.point(0.25), curve.point([0.25])[0])


@each_curve
def test_fewer_than_two_samples_are_refused(curve):
    with pytest.raises(ValueError, match="at least its 2 ends"):
        curve.sample(1)


@pytest.mark.parametrize("right", [True, False])
@pytest.mark.parametrize(("degrees", "large_arc"), [(60, False), (90, False), (180, False), (270, True), (330, True)])
def test_arc_of_a_known_angle(degrees, large_arc, right):
    radius, angle = 0.3, math.radians(degrees)
    turn = angle if right else -angle
    centre = np.array([0.2, 0.1])
    start = centre + radius * np.array([math.cos(0.4), math.sin(0.4)])
    end = centre + radius * np.array([math.cos(0.4 + turn), math.sin(0.4 + turn)])
    arc = CircularArc(tuple(start), tuple(end), radius, large_arc, right)
    assert arc.length == pytest.approx(radius * angle, rel=1e-7 if degrees == 180 else 1e-14)
    middle = centre + radius * np.array([math.cos(0.4 + turn / 2), math.sin(0.4 + turn / 2)])
    assert np.allclose(arc.point(0.5), middle, rtol=0.0, atol=1e-8 if degrees == 180 else 1e-14)
    chord = end - start
    bulge = arc.point(0.5) - 0.5 * (start + end)
    assert (chord[0] * bulge[1] - chord[1] * bulge[0] < 0.0) == right


def test_two_half_circles_enclose_a_disc():
    outline = [
        CircularArc((-0.4, 0.0), (0.4, 0.0), 0.4, large_arc=False, right=True),
        CircularArc((0.4, 0.0), (-0.4, 0.0), 0.4, large_arc=False, right=True),
    ]
    assert sum(arc.area_term for arc in outline) == pytest.approx(math.pi * 0.4**2, rel=1e-15)
    assert sum(arc.length for arc in outline) == pytest.approx(2.0 * math.pi * 0.4, rel=1e-15)


def test_radius_below_half_the_chord_is_a_half_circle():
    arc = CircularArc((0.0, 0.0), (1.0, 0.0), 0.4999999, large_arc=False, right=False)
    assert arc.length == pytest.approx(0.5 * math.pi, rel=1e-15)
    assert np.allclose(arc.point(0.5), (0.5, 0.5), rtol=0.0, atol=1e-15)


def test_arc_of_a_huge_circle_is_a_parabola():
    arc = CircularArc((0.0, 0.0), (1.0, 0.0), 1e6, large_arc=False, right=False)
    assert arc.length == pytest.approx(1.0, rel=1e-12)
    assert arc.point(0.5)[1] == pytest.approx(1.0 / (8.0 * 1e6), rel=1e-9)  # sagitta, c^2 / 8 r
    assert np.allclose(np.diff(arc.sample(11)[:, 0]), 0.1, rtol=0.0, atol=1e-13)


def test_parabola_of_a_known_length_and_area():
    parabola = QuadraticBezier((-1.0, 1.0), (0.0, -1.0), (1.0, 1.0))  # y = x^2
    assert parabola.length == pytest.approx(math.sqrt(5.0) + math.asinh(2.0) / 2.0, rel=1e-15)
    assert parabola.area_term + Line((1.0, 1.0), (-1.0, 1.0)).area_term == pytest.approx(4.0 / 3.0, rel=1e-15)


def test_parabola_that_retraces_its_line():
    # x = 2 t - 7/4 t^2: out to x = 4/7 at t = 4/7, then back to 1/4
    there_and_back = QuadraticBezier((0.0, 0.0), (1.0, 0.0), (0.25, 0.0))
    assert there_and_back.length == pytest.approx(2.0 * 4.0 / 7.0 - 0.25, rel=1e-15)


def test_cubic_raised_from_a_parabola_is_that_parabola():
    p, q, r = np.array([[0.0, 0.0], [0.3, 0.5], [1.0, 0.1]])
    parabola = QuadraticBezier(tuple(p), tuple(q), tuple(r))
    cubic = CubicBezier(tuple(p), tuple((p + 2 * q) / 3), tuple((2 * q + r) / 3), tuple(r))
    assert cubic.length == pytest.approx(parabola.length, rel=1e-13)
    assert cubic.area_term == pytest.approx(parabola.area_term, rel=1e-13)
    assert np.allclose(cubic.sample(8), parabola.sample(8), rtol=0.0, atol=1e-13)


def test_curved_outline_has_the_area_that_shapely_measures():
    corners = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.7), (0.0, 0.7)]
    outline = [
        Line(corners[0], corners[1]),
        CubicBezier(corners[1], (0.6, 0.2), (0.4, 0.5), corners[2]),
        QuadraticBezier(corners[2], (0.25, 0.5), corners[3]),
        CircularArc(corners[3], corners[0], 0.5, large_arc=False, right=False),
    ]
    polygon = shapely.Polygon(np.concatenate([curve.sample(20_000)[:-1] for curve in outline]))
    assert sum(curve.area_term for curve in outline) == pytest.approx(polygon.area, rel=1e-8)
    assert sum(curve.length for curve in outline) == pytest.approx(polygon.length, rel=1e-8)


@settings(max_examples=60, deadline=None)
@given(start=point, first=point, second=point, end=point, count=st.integers(2, 40))
def test_any_cubic_is_sampled_along_itself_without_gaps(start, first, second, end, count):
    curve = CubicBezier(start, first, second, end)
    points = curve.sample(count)
    steps = np.hypot(*np.diff(points, axis=0).T)
    assert np.isfinite(points).all()
    assert steps.max() <= curve.length / (count - 1) * (1.0 + 1e-6) + 1e-9
    polygon = sum(math.dist(a, b) for a, b in zip([start, first, second], [first, second, end], strict=True))
    assert math.dist(start, end) - 1e-12 <= curve.length <= polygon + 1e-12


@settings(max_examples=60, deadline=None)
@given(start=point, control=point, end=point)
def test_length_of_any_parabola_agrees_with_quadrature(start, control, end):
    curve = QuadraticBezier(start, control, end)
    raised = [tuple((a + 2 * c) / 3 for a, c in zip(tip, control, strict=True)) for tip in (start, end)]
    assert curve.length == pytest.approx(CubicBezier(start, *raised, end).length, rel=1e-11, abs=1e-12)
