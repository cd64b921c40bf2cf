"""Eight numbers at a time against the same on single numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from apparatus import bending_force, spring_force
from numpy.typing import NDArray

from cloth_core.bending import Bending
from cloth_core.kernel import kernel
from cloth_core.lanes import (
    add_to,
    fill,
    fused,
    inverse_root,
    larger,
    last_lane,
    last_lanes,
    load,
    smaller,
    store,
    take_from,
    together,
    where_positive,
)
from cloth_core.springs import spring_forces

Floats = NDArray[np.float64]


@kernel
def _roots(squared: Floats, least: float, out: Floats) -> None:
    for block in range(0, squared.shape[0], 8):
        store(out, block, inverse_root(load(squared, block), least))


@kernel
def _combined(a: Floats, b: Floats, c: Floats, out: Floats) -> None:
    x, y, z = load(a, 0), load(b, 0), load(c, 0)
    store(out, 0, (x + y) * fill(3.0) - z)
    store(out, 8, fused(x, y, z))
    store(out, 16, last_lanes(x, 3))
    add_to(out, 24, x)
    take_from(out, 25, y)


@kernel
def _shifted(a: Floats, b: Floats, out: Floats) -> None:
    x, y = load(a, 0), load(b, 0)
    store(out, 0, together(x, y, 1))
    store(out, 8, together(x, y, 2))
    for back in range(8):
        out[16 + back] = last_lane(x, back)


@kernel
def _chosen(a: Floats, b: Floats, out: Floats) -> None:
    x, y = load(a, 0), load(b, 0)
    store(out, 0, smaller(x, y))
    store(out, 8, larger(x, y))
    store(out, 16, where_positive(x, x, y))
    store(out, 24, x / y)


def test_inverse_root_is_right_to_two_units_in_the_last_place_at_every_size() -> None:
    chance = np.random.default_rng(3)
    squared = 10.0 ** chance.uniform(-23.0, 6.0, 80_000)
    out = np.zeros_like(squared)
    _roots(squared, 1e-24, out)
    exact = 1.0 / np.sqrt(squared.astype(np.longdouble))
    assert np.abs((out - exact) / exact).max() < 2 * np.finfo(float).eps


def test_inverse_root_of_less_than_the_least_is_that_of_the_least() -> None:
    out = np.zeros(8)
    _roots(np.array([0.0, 1e-30, 1e-25, 1e-24, 0.0, 0.0, 0.0, 4e-24]), 1e-24, out)
    assert out == pytest.approx([1e12] * 7 + [0.5e12], rel=1e-15)


def test_operations_are_those_of_single_numbers() -> None:
    chance = np.random.default_rng(4)
    a, b, c = chance.normal(size=(3, 8))
    out = np.zeros(40)
    _combined(a, b, c, out)
    assert (out[:8] == (a + b) * 3.0 - c).all()
    exact = a.astype(np.longdouble) * b + c  # 64 bits of mantissa: not exact, but nearer than two roundings
    assert out[8:16] == pytest.approx(exact.astype(float), rel=1e-14)
    assert (out[16:21] == 0.0).all()
    assert (out[21:24] == a[5:]).all()
    assert (out[24:32] == a - np.concatenate([[0.0], b[:7]])).all()
    assert out[32] == -b[7]


def test_choices_and_quotients_are_those_of_single_numbers() -> None:
    a = np.array([1.0, -2.0, 0.0, -0.0, 3.0, 1e-300, np.nan, 5.0])
    b = np.array([2.0, -3.0, 4.0, 1.0, 3.0, -1.0, 7.0, np.nan])
    out = np.zeros(32)
    _chosen(a, b, out)
    np.testing.assert_array_equal(out[:8], np.where(a < b, a, b))
    np.testing.assert_array_equal(out[8:16], np.where(a > b, a, b))
    np.testing.assert_array_equal(out[16:24], np.where(a > 0.0, a, b))
    np.testing.assert_array_equal(out[24:], a / b)


def test_lanes_of_two_values_one_after_the_other() -> None:
    both = np.random.default_rng(6).normal(size=16)
    out = np.zeros(24)
    _shifted(both[:8].copy(), both[8:].copy(), out)
    np.testing.assert_array_equal(out[:8], both[7:15])
    np.testing.assert_array_equal(out[8:16], both[6:14])
    np.testing.assert_array_equal(out[16:], both[7::-1])


@pytest.mark.parametrize("apart", [1, 2, 3, 7, 15, 16, 60])
@pytest.mark.parametrize("count", [7, 8, 9, 15, 16, 17, 40])
def test_runs_of_every_length_and_distance_give_each_spring_its_force_once(count: int, apart: int) -> None:
    chance = np.random.default_rng(count + 100 * apart)
    particles = count + apart
    x, v = chance.normal(size=(2, particles, 3))
    pairs = np.stack([np.arange(count), np.arange(count) + apart], axis=1)
    force = spring_force(x, v, pairs, np.full(count, 0.7), np.full(count, 30.0), 0.01)
    assert force == pytest.approx(_plain(x, v, pairs, 0.7, 30.0, 0.01), rel=1e-12, abs=1e-12 * 30.0)


def _plain(x: Floats, v: Floats, pairs: Any, rest_length: float, stiffness: float, tau: float) -> Floats:
    force = np.zeros_like(x)
    for i, j in pairs:
        d, u = x[j] - x[i], v[j] - v[i]
        length = np.sqrt(d @ d)
        pull = stiffness * (length - rest_length + tau * (d @ u) / length) * d / length
        force[i] += pull
        force[j] -= pull
    return force


@pytest.mark.parametrize("apart", [1, 2, 7, 60])
@pytest.mark.parametrize("count", [1, 7, 8, 9, 15, 16, 17, 40])
def test_runs_of_triples_of_every_length_and_distance_bend_once(count: int, apart: int) -> None:
    chance = np.random.default_rng(count + 100 * apart)
    x = chance.normal(size=(count + 2 * apart, 3))
    lines = (np.arange(count)[:, None] + apart * np.arange(3)).astype(np.int32)
    bend = 30.0 * (x[lines[:, 0]] - 2.0 * x[lines[:, 1]] + x[lines[:, 2]])
    expected = np.zeros_like(x)
    for corner, weight in enumerate((-1.0, 2.0, -1.0)):
        np.add.at(expected, lines[:, corner], weight * bend)
    nothing = np.zeros((0, 4))
    bending = Bending(lines, np.full(count, 30.0), nothing.astype(np.int32), nothing, np.zeros(0))
    assert bending_force(bending, x) == pytest.approx(expected, rel=1e-12, abs=1e-12 * 30.0)


def test_no_run_writes_beyond_its_particles() -> None:
    from apparatus import by_axis

    from cloth_core.runs import find_runs

    chance = np.random.default_rng(5)
    x = chance.normal(size=(30, 3))
    pairs = np.stack([np.arange(5, 16), np.arange(5, 16) + 1], axis=1).astype(np.int32)
    runs = find_runs(pairs, np.ones((11, 2)))
    assert list(runs.length) == [11]
    force = np.zeros((3, 30))
    spring_forces(by_axis(x), by_axis(0.0 * x), runs, 0.0, force)
    assert (force[:, :5] == 0.0).all()
    assert (force[:, 17:] == 0.0).all()
