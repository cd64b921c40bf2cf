"""Equation 6: its order, what it conserves, its period, and how fast a particle falls in air."""

import math

import numpy as np
import pytest
from apparatus import GRAVITY, by_axis, chain, do_steps, force_terms

from cloth_core.euler import semi_implicit_euler


def test_equation_6_takes_the_new_velocity_for_the_new_position():
    # a = F(t) / m, v(t + dt) = v + dt a, x(t + dt) = x + dt v(t + dt), as three lines of arrays.
    rng = np.random.default_rng(6)
    x, v, force = rng.standard_normal((3, 7, 3))
    mass, dt = rng.uniform(0.5, 2.0, 7), 0.01
    a = force / mass[:, None]
    new_v = v + dt * a
    new_x = x + dt * new_v
    explicit_x = x + dt * v
    x, v = by_axis(x), by_axis(v)
    semi_implicit_euler(x, v, by_axis(force), 1.0 / mass, dt)
    np.testing.assert_allclose(v.T, new_v, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(x.T, new_x, rtol=1e-14, atol=1e-15)
    assert np.abs(x.T - explicit_x).max() > 1e-5  # the explicit method would have gone elsewhere


def test_equation_6_uses_the_force_at_the_old_position():
    # One spring: after one step the velocity must be -dt k x0 / m of the start, not of the end.
    dt, k, m, stretch = 0.05, 40.0, 2.0, 0.1
    x, terms = chain(1, m, k, 1.0)
    x[1, 2] -= stretch
    v = np.zeros_like(x)
    do_steps(x, v, terms, dt, 1)
    assert v[1, 2] == pytest.approx(dt * k * stretch / m, rel=1e-13)
    assert x[1, 2] == pytest.approx(-1.0 - stretch + dt * v[1, 2], rel=1e-13)


def test_a_particle_of_no_inverse_mass_stays():
    x, v, force = np.zeros((3, 1)), np.zeros((3, 1)), np.full((3, 1), 1e6)
    semi_implicit_euler(x, v, force, np.zeros(1), 0.1)
    assert not x.any()
    assert not v.any()


def oscillator(w_dt: float, steps: int) -> tuple[np.ndarray, np.ndarray, float, float, float]:
    """Elongation and velocity of a mass on an undamped spring over the steps; then m, k and dt."""
    m, k = 0.3, 120.0
    dt = w_dt / math.sqrt(k / m)
    x, terms = chain(1, m, k, 1.0)
    x[1, 2] = -1.001
    v = np.zeros_like(x)
    elongation, speed = np.empty(steps), np.empty(steps)
    for i in range(steps):
        do_steps(x, v, terms, dt, 1)
        elongation[i], speed[i] = -1.0 - x[1, 2], -v[1, 2]
    return elongation, speed, m, k, dt


@pytest.mark.parametrize("w_dt", [0.1, 1.0, 1.9])
def test_undamped_spring_conserves_its_shadow_energy(w_dt):
    x, v, m, k, dt = oscillator(w_dt, 4_000)
    shadow = m * v**2 / 2 + k * x**2 / 2 - k * dt * x * v / 2
    # The elongation of 1 mm of a spring of 1 m has 13 digits.
    np.testing.assert_allclose(shadow, shadow[0], rtol=1e-8)
    energy = m * v**2 / 2 + k * x**2 / 2
    assert np.ptp(energy) > 0.04 * energy.mean()  # the energy itself is not: the term in dt is needed


@pytest.mark.parametrize("w_dt", [0.1, 0.5, 1.0, 1.8])
def test_period_of_an_undamped_spring(w_dt):
    x, _, m, k, dt = oscillator(w_dt, 8_000)
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossing = up + x[up] / (x[up] - x[up + 1])
    measured = dt * (crossing[-1] - crossing[0]) / (len(crossing) - 1)
    exact = 2 * math.pi * math.sqrt(m / k)
    assert measured / exact == pytest.approx((w_dt / 2) / math.asin(w_dt / 2), rel=5e-4)


@pytest.mark.parametrize("dt", [0.01, 0.4])
@pytest.mark.parametrize("air_drag", [0.5, 2.0])
def test_terminal_speed_is_g_over_k_a_at_any_time_step(dt, air_drag):
    terms = force_terms([0.7, 1e-4], gravity=[0.0, 0.0, -GRAVITY], air_drag=air_drag)
    x, v = np.zeros((2, 3)), np.zeros((2, 3))
    fall = [0.0]
    for _ in range(round(40.0 / (air_drag * dt))):
        do_steps(x, v, terms, dt, 1)
        fall.append(-v[1, 2])
    assert v[:, 2] == pytest.approx([-GRAVITY / air_drag] * 2, rel=1e-14)
    assert (np.diff(fall) > -1e-12).all()  # k_a dt < 1: it is approached from one side
    assert not v[:, :2].any()


@pytest.mark.parametrize(("k_a_dt", "diverges"), [(1.98, False), (2.02, True)])
def test_drag_diverges_beyond_two_over_k_a(k_a_dt, diverges):
    dt = 0.1
    terms = force_terms([1.0], air_drag=k_a_dt / dt)
    x, v = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]])
    do_steps(x, v, terms, dt, 1000)
    # Each step multiplies the speed by 1 - k_a dt.
    assert abs(v[0, 0]) == pytest.approx(abs(1 - k_a_dt) ** 1000, rel=1e-8)
    assert (abs(v[0, 0]) > 1e8) == diverges


def test_free_fall_distance_of_symplectic_euler():
    n, dt = 250, 0.004
    terms = force_terms([0.2], gravity=[1.0, 0.0, -GRAVITY])
    x, v = np.zeros((1, 3)), np.zeros((1, 3))
    do_steps(x, v, terms, dt, n)
    assert x[0] == pytest.approx([dt * dt * n * (n + 1) / 2, 0.0, -GRAVITY * dt * dt * n * (n + 1) / 2], rel=1e-12)
