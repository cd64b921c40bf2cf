"""True bending against the cantilever master curve, with 25 cells and with half of them."""

import pytest
from cantilever import MASTER_CURVE, drop_over_reach, hang


@pytest.mark.parametrize(("gamma", "expected"), MASTER_CURVE.items())
def test_strip_hangs_as_the_master_curve_says(gamma, expected):
    line, _ = hang(gamma)
    assert drop_over_reach(line) == pytest.approx(expected, rel=0.02)


def test_error_falls_with_the_square_of_the_spacing():
    # The limpest strip, where it is largest.
    expected = MASTER_CURVE[100.0]
    coarse, fine = (abs(drop_over_reach(hang(100.0, spacing)[0]) / expected - 1.0) for spacing in (0.016, 0.008))
    assert coarse / fine > 3.5


def test_peirces_overhang_at_41_5_degrees_is_twice_the_bending_length():
    # c = (B / w)^(1/3): the strip of length 2 c, Gamma = 8, hangs with its tip 41.5 degrees below the clamp.
    assert drop_over_reach(hang(8.0)[0]) == pytest.approx(0.8847, rel=0.02)  # tan 41.5
