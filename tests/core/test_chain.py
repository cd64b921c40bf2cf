"""A chain of masses: hanging from one end, where its extension has a closed form, and from two, the catenary."""

import math

import numpy as np
import pytest
from apparatus import GRAVITY, chain, do_steps
from scipy.optimize import brentq


def settled(x, terms, dt, seconds):
    """Positions after a run in air that calms it."""
    v = np.zeros_like(x)
    do_steps(x, v, terms, dt, math.ceil(seconds / dt))
    assert np.abs(v).max() < 1e-9, "the chain still moves"
    return x


@pytest.mark.parametrize("count", [1, 5, 20])
def test_hanging_chain(count):
    m, k, length = 0.01, 50.0, 0.05
    x, terms = chain(count, m, k, length, gravity=[0.0, 0.0, -GRAVITY], air_drag=8.0)
    x = settled(x, terms, 0.9 * math.sqrt(m / k), 0.6 * count + 8.0)
    extension = np.linalg.norm(np.diff(x, axis=0), axis=1) - length
    i = np.arange(1, count + 1)
    np.testing.assert_allclose(extension, (count - i + 1) * m * GRAVITY / k, rtol=1e-7)
    total = -x[-1, 2] - count * length
    assert total == pytest.approx(count * (count + 1) * m * GRAVITY / (2 * k), rel=1e-7)
    assert not x[:, :2].any()


def test_hanging_chain_of_the_papers_own_numbers():
    # m = 1, k = 10, g = 10: the top spring of N rows is N units longer than at rest, far beyond any 5 %.
    count = 4
    x, terms = chain(count, 1.0, 10.0, 1.0, gravity=[0.0, 0.0, -10.0], air_drag=2.0)
    x = settled(x, terms, 0.1, 60.0)
    extension = np.linalg.norm(np.diff(x, axis=0), axis=1) - 1.0
    np.testing.assert_allclose(extension, [4.0, 3.0, 2.0, 1.0], rtol=1e-7)


# Length over span: sag over span, end tension over weight (four digits; the closed form is solved below as well).
CATENARY = {1.1: (0.2003, 0.7775), 1.2: (0.2923, 0.6349), 1.5: (0.5026, 0.5406), 2.0: (0.7964, 0.5130)}


@pytest.mark.parametrize(("slack", "table"), CATENARY.items())
def test_catenary(slack, table):
    # y = c cosh(x / c): length 2 c sinh(d / 2c), sag c (cosh(d / 2c) - 1), end tension w c cosh(d / 2c).
    span = 1.0
    half = brentq(lambda u: math.sinh(u) / u - slack, 1e-6, 10.0)
    sag = (math.cosh(half) - 1.0) / (2.0 * half)
    tension = math.cosh(half) / (2.0 * half) / slack
    assert (sag, tension) == pytest.approx(table, abs=6e-5)

    links, weight = 40, 2.0
    length = slack * span / links
    mass = weight / GRAVITY / links
    stiffness = 1e6
    x, terms = chain(
        links,
        mass,
        stiffness,
        length,
        held=[0, links],
        gravity=[0.0, 0.0, -GRAVITY],
        air_drag=6.0,
        spring_damping_time=1e-6,
    )
    # Drawn up as a V between the two ends, from which it falls.
    u = np.linspace(-1.0, 1.0, links + 1)
    x = np.stack([span / 2 * u, np.zeros_like(u), (abs(u) - 1) * math.sqrt((slack * span) ** 2 - span**2) / 2], axis=1)
    x = settled(x, terms, 6e-5, 8.0)

    assert -x[:, 2].min() / span == pytest.approx(sag, rel=1e-3)
    first = x[1] - x[0]
    stretch = np.linalg.norm(first) - length
    assert stretch / length < 1e-4  # nearly inextensible
    pull = stiffness * stretch * first / np.linalg.norm(first)
    pull[2] -= weight / (2 * links)  # the support also carries the half link next to it
    assert np.linalg.norm(pull) / weight == pytest.approx(tension, rel=2e-3)
