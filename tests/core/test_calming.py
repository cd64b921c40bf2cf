"""Braking on the way to rest, against the same in plain NumPy."""

import math

import numpy as np

from cloth_core.calming import Calming, limit_speed


def test_what_slows_down_is_braked_and_what_turns_round_stops():
    rng = np.random.default_rng(3)
    before, v = rng.standard_normal((2, 500, 3))
    v[:100] = 1.1 * before[:100]  # faster: left alone
    v[100:200] = 0.9 * before[100:200]  # slower
    v[200:300] = -before[200:300]  # turned round
    expected = v.copy()
    expected[((v - before) * v).sum(axis=1) < 0.0] *= math.exp(-30.0 * 0.004)
    expected[(before * v).sum(axis=1) < 0.0] = 0.0
    calming = Calming()
    calming.start(before)
    calming.brake(v, 0.004)
    np.testing.assert_allclose(v, expected, rtol=1e-15)
    np.testing.assert_array_equal(v[:100], 1.1 * before[:100])
    assert not v[200:300].any()
    # The next brake compares with these.
    again = v.copy()
    calming.brake(again, 0.004)
    np.testing.assert_array_equal(again, v)


def test_braking_ends_when_little_moves_and_comes_back():
    calming = Calming()
    assert not calming.ended(0.6e-3, allowed=1e-3)
    assert calming.ended(0.4e-3, allowed=1e-3)
    assert not calming.active
    calming.resume(1.1e-3, allowed=1e-3)
    assert calming.active
    calming.rough = True  # a drape that is only a start for a finer one need not lie still
    assert calming.ended(2.9e-3, allowed=1e-3)


def test_nothing_is_faster_than_three_metres_a_second_and_what_is_slower_stays_as_it_is():
    v = np.random.default_rng(5).standard_normal((500, 3)) * 2.0
    speed = np.linalg.norm(v, axis=1)
    limited = v.copy()
    limit_speed(limited)
    assert min(np.bincount(speed > 3.0)) > 100
    np.testing.assert_array_equal(limited[speed <= 3.0], v[speed <= 3.0])
    np.testing.assert_allclose(limited, v * np.minimum(3.0 / speed, 1.0)[:, None], rtol=1e-15)
