"""The table made from measured errors: exact laws come back exactly, and promises cover what they say they cover."""

import json
import math

import numpy as np
import pytest
from scipy.stats import norm

from cloth_core.calibration import Calibration, Cloth
from cloth_core.calibration_fit import Case, fit_calibration, tolerance_factor
from cloth_core.errors import ClothError

SPACINGS = (0.01, 0.02, 0.04)
SOURCE = {"date": "2026-01-02T03:04:05", "reference_spacing": 0.008}
SCENES = [("a", 0.5, "limp"), ("b", 2.0, "limp"), ("c", 0.5, "firm"), ("d", 1.0, "firm"), ("e", 2.0, "firm")]


def law(spacing, area, fabric_class):
    return 0.3 * spacing**0.8 * area**0.25 * (1.5 if fabric_class == "limp" else 1.0)


def test_errors_that_follow_the_law_come_back_exactly():
    cases = [Case(name, area, kind, h, law(h, area, kind)) for name, area, kind in SCENES for h in SPACINGS]
    table = Calibration.from_dict(json.loads(json.dumps(fit_calibration(cases, 1e-5, SOURCE))))
    assert table.factor == pytest.approx(1.0, abs=1e-3)
    for area in (0.5, 0.9, 2.0):
        for kind in ("limp", "firm"):
            for h in (0.01, 0.013, 0.04):
                assert table.promise(h, Cloth(area, kind)) == pytest.approx(law(h, area, kind), rel=2e-3)


def test_factor_is_that_of_the_published_tables():
    # One-sided tolerance limits of the normal distribution, content 95 %, confidence 75 % (Owen 1962; ISO 16269-6).
    assert tolerance_factor(5, 0.95, 0.75) == pytest.approx(2.463, abs=0.002)
    assert tolerance_factor(10, 0.95, 0.75) == pytest.approx(2.104, abs=0.002)


def test_promises_cover_the_share_of_new_scenes_that_they_claim():
    rng = np.random.default_rng(5)
    between, within = 0.25, 0.15
    covered = []
    for _ in range(150):
        cases = []
        for name, area, kind in [*SCENES, ("f", 1.5, "limp"), ("g", 0.8, "firm")]:
            own = rng.normal(0.0, between)
            cases += [
                Case(name, area, kind, h, law(h, area, kind) * math.exp(own + rng.normal(0.0, within)))
                for h in SPACINGS
            ]
        table = Calibration.from_dict(fit_calibration(cases, 1e-6, SOURCE))
        room = math.log(table.promise(0.02, Cloth(1.0, "firm")) / law(0.02, 1.0, "firm"))
        covered.append(norm.cdf(room / math.hypot(between, within)))
    assert np.mean(covered) >= 0.95
    # The stated confidence: in three of four calibrations at least 95 % of new scenes are covered.
    assert np.mean(np.array(covered) >= 0.95) >= 0.7


def test_table_says_what_it_was_made_from():
    cases = [Case(name, area, kind, h, law(h, area, kind)) for name, area, kind in SCENES for h in SPACINGS]
    table = fit_calibration(cases, 0.002, {**SOURCE, "machine": "m"})
    assert table["provenance"]["scenes"] == ["a", "b", "c", "d", "e"]
    assert table["provenance"]["cases"] == 15
    assert table["provenance"]["machine"] == "m"
    assert table["spread"] == 0.002


def test_garments_of_one_size_give_a_table_of_that_size():
    cases = [Case(name, 0.5, "firm", h, 0.1 * h) for name in "abc" for h in SPACINGS]
    table = Calibration.from_dict(fit_calibration(cases, 1e-6, SOURCE))
    assert table.promise(0.02, Cloth(3.0, "firm")) == pytest.approx(0.002, rel=1e-3)


@pytest.mark.parametrize(
    ("cases", "why"),
    [
        ([Case("a", 1.0, "firm", h, 0.001) for h in SPACINGS], "at least three scenes"),
        ([Case(name, 1.0, "firm", 0.01, 0.001) for name in "abc"], "two spacings"),
        ([Case(name, 1.0, "firm", h, 0.0) for name in "abc" for h in SPACINGS], "not a positive number"),
    ],
)
def test_too_little_to_go_by_is_refused(cases, why):
    with pytest.raises(ClothError, match=why):
        fit_calibration(cases, 0.001, SOURCE)
