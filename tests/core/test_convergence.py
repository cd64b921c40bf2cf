"""Order and Richardson's estimate, on sequences whose limit is known."""

import math
from itertools import combinations

import numpy as np
import pytest

from cloth_core.convergence import fit_convergence
from cloth_core.errors import ClothError


def distances(solution, steps):
    return {(a, b): float(np.linalg.norm(solution(a) - solution(b))) for a, b in combinations(steps, 2)}


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 3.0])
def test_order_and_what_is_left_of_a_power_law(order):
    direction = np.array([3.0, -1.0, 2.0])
    found = fit_convergence(distances(lambda h: np.ones(3) + 0.4 * h**order * direction, [0.04, 0.025, 0.02, 0.01]))
    assert found.order == pytest.approx(order, abs=0.01)
    assert found.left == pytest.approx(0.4 * 0.01**order * np.linalg.norm(direction), rel=0.03)
    assert found.converges
    assert found.misfit < 0.01


def test_polygons_approach_the_circle_with_order_two_and_the_estimate_is_what_is_really_left():
    def perimeter(h):
        count = round(1 / h)
        return np.array([2 * count * math.sin(math.pi / count)])

    steps = [1 / 6, 1 / 9, 1 / 12, 1 / 24]
    found = fit_convergence(distances(perimeter, steps))
    assert found.order == pytest.approx(2.0, abs=0.05)
    assert found.left == pytest.approx(2 * math.pi - float(perimeter(1 / 24)[0]), rel=0.05)


def test_explicit_euler_is_of_order_one_at_a_given_time():
    def end(dt):
        x = 1.0
        for _ in range(round(1 / dt)):
            x -= dt * x
        return np.array([x])

    found = fit_convergence(distances(end, [0.1, 0.05, 0.025]))
    assert found.order == pytest.approx(1.0, abs=0.05)
    assert found.left == pytest.approx(abs(float(end(0.025)[0]) - math.exp(-1)), rel=0.05)


def test_what_does_not_approach_anything_has_no_order():
    """The paper's bending springs are like that: their effect goes on changing with the spacing."""
    found = fit_convergence(distances(lambda h: np.array([math.log(h)]), [0.04, 0.02, 0.01, 0.005]))
    assert found.order is None
    assert found.left is None
    assert not found.converges


def test_a_coarsest_level_that_is_far_from_all_others_makes_no_order():
    # Any high power fits that equally well: it is the end of those that are tried.
    measured = {(40, 30): 8.0, (40, 20): 8.0, (40, 10): 8.0, (30, 20): 0.1, (30, 10): 0.1, (20, 10): 0.1}
    found = fit_convergence(measured)
    assert found.order is found.left is None
    assert not found.converges


def test_distances_that_grow_towards_the_finest_are_no_convergence():
    """Of a T-shirt at 40 to 10 mm: each level differs from the next by as much as the one before, or more."""
    measured = {(40, 30): 7.5, (40, 20): 8.9, (40, 15): 11.0, (40, 10): 13.2, (30, 20): 4.5}
    measured |= {(30, 15): 6.2, (30, 10): 9.7, (20, 15): 4.3, (20, 10): 7.9, (15, 10): 6.9}
    assert not fit_convergence(measured).converges


def test_chance_alone_is_not_taken_for_convergence():
    rng = np.random.default_rng(3)
    points = {h: rng.standard_normal(1000) * 0.002 / math.sqrt(2000) for h in (0.04, 0.02, 0.01)}
    found = fit_convergence(distances(points.__getitem__, list(points)), spread=0.002)
    assert found.within_spread
    assert not found.converges


def test_spread_adds_to_the_distances_and_is_taken_off_again():
    clean = distances(lambda h: np.array([0.3 * h]), [0.04, 0.02, 0.01])
    spread = 0.001
    noisy = {pair: math.hypot(d, spread) for pair, d in clean.items()}
    found = fit_convergence(noisy, spread)
    assert found.order == pytest.approx(1.0, abs=0.01)
    assert found.left == pytest.approx(0.003, rel=0.02)
    assert found.converges


@pytest.mark.parametrize(
    ("measured", "why"),
    [
        ({(0.2, 0.1): 1.0}, "three different steps"),
        ({}, "three different steps"),
        ({(0.2, 0.1): 1.0, (0.1, 0.05): math.nan}, "not a positive number"),
        ({(0.2, 0.1): 1.0, (0.1, -0.05): 0.5}, "not a positive number"),
    ],
)
def test_what_tells_no_order_is_refused(measured, why):
    with pytest.raises(ClothError, match=why):
        fit_convergence(measured)
