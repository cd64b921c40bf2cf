"""How the table of errors is read: on its rows, between them, beyond them; and what a run states."""

import math
from itertools import pairwise

import numpy as np
import pytest
from apparatus import pattern, rectangle

from cloth_core.calibration import Calibration, Cloth, bending_length, calibration, fabric_class
from cloth_core.fabric import Fabric, fabric_presets
from cloth_core.quality import NOT_MEASURED, QUALITIES, Settings, settings_for, with_expected_error
from cloth_core.scene import Scene

PROVENANCE = {"date": "2026-01-02T03:04:05", "scenes": ["a", "b"], "reference_spacing": 0.01, "content": 0.95}


def table(**changes):
    values = {
        "spacings": [0.01, 0.02, 0.04],
        "areas": [0.5, 2.0],
        # 0.1 h and 0.2 h for limp; firm is not monotone: its coarsest grid happened to come out well.
        "typical_error": {
            "limp": [[0.001, 0.002, 0.004], [0.002, 0.004, 0.008]],
            "firm": [[0.001, 0.003, 0.002], [0.001, 0.003, 0.002]],
        },
        "factor": 1.5,
        "spread": 0.0004,
        "provenance": PROVENANCE,
    }
    return Calibration.from_dict(values | changes)


FINEST = float(calibration().spacings[0])
"""Finest spacing of the table that comes with the package [m]."""
SMALL_LIMP, LARGE_LIMP = Cloth(0.5, "limp"), Cloth(2.0, "limp")


def test_promise_is_the_typical_error_times_the_factor():
    assert table().promise(0.02, SMALL_LIMP) == pytest.approx(1.5 * 0.002)
    assert table().promise(0.02, LARGE_LIMP) == pytest.approx(1.5 * 0.004)


def test_between_rows_a_power_law_is_met_exactly():
    # The limp table is linear in the spacing and a square root in the area: both are power laws.
    for spacing in (0.011, 0.017, 0.033):
        assert table().promise(spacing, SMALL_LIMP) == pytest.approx(1.5 * 0.1 * spacing)
    assert table().promise(0.02, Cloth(1.0, "limp")) == pytest.approx(1.5 * 0.002 * math.sqrt(2))


def test_nothing_is_promised_beyond_what_was_measured():
    assert table().promise(0.0099, SMALL_LIMP) is None
    assert table().promise(0.0401, SMALL_LIMP) is None
    # A garment smaller or larger than any measured counts as the nearest one.
    assert table().promise(0.02, Cloth(0.01, "limp")) == table().promise(0.02, SMALL_LIMP)
    assert table().promise(0.02, Cloth(9.0, "limp")) == table().promise(0.02, LARGE_LIMP)


def test_no_promise_is_below_the_spread_of_equally_right_drapes():
    assert table(spread=0.0025).promise(0.01, SMALL_LIMP) == 0.0025
    assert table(spread=0.0025).spacing(0.0024, SMALL_LIMP) is None
    assert table(spread=0.0025).spacing(0.0025, SMALL_LIMP) == pytest.approx(0.0025 / 0.15)


def test_a_coarser_grid_is_never_promised_to_be_nearer():
    firm = Cloth(1.0, "firm")
    promises = [table().promise(h, firm) for h in np.linspace(0.01, 0.04, 31)]
    assert all(b >= a * (1 - 1e-12) for a, b in pairwise(promises))
    assert promises[-1] == pytest.approx(1.5 * 0.003)


def test_without_a_cloth_the_worst_of_all_is_promised():
    assert table().promise(0.02) == pytest.approx(1.5 * 0.004)
    assert table().promise(0.01) == pytest.approx(1.5 * 0.002)


@pytest.mark.parametrize("tolerance", [0.0016, 0.002, 0.003, 0.0045, 0.0059])
@pytest.mark.parametrize("cloth", [SMALL_LIMP, LARGE_LIMP, Cloth(1.3, "limp"), None])
def test_spacing_of_a_tolerance_is_the_coarsest_whose_promise_keeps_it(tolerance, cloth):
    found = table().spacing(tolerance, cloth)
    grid = np.linspace(0.01, 0.04, 3001)
    good = [h for h in grid if table().promise(h, cloth) <= tolerance * (1 + 1e-9)]
    if not good:
        assert found is None
    else:
        assert found == pytest.approx(max(good), abs=2e-5)
        assert table().promise(found, cloth) <= tolerance * (1 + 1e-9)


def test_a_flat_stretch_of_the_table_is_taken_to_its_coarse_end():
    flat = table(typical_error={"limp": [[0.001, 0.001, 0.002]] * 2, "firm": [[0.001] * 3] * 2})
    assert flat.spacing(0.0015, SMALL_LIMP) == pytest.approx(0.02)
    assert flat.spacing(1.0, SMALL_LIMP) == 0.04


def test_classes_go_by_the_length_over_which_cloth_bends_under_its_own_weight():
    cloth = Fabric.preset("cotton_poplin")
    # Peirce: c = (B / w)^(1/3), with B = 13.9 uN m and w = 0.1238 kg/m2 times g.
    assert bending_length(cloth) == pytest.approx((13.9e-6 / (0.1238 * 9.80665)) ** (1 / 3), rel=1e-12)
    classes = {name: fabric_class(Fabric.preset(name)) for name in fabric_presets()}
    assert classes["silk"] == classes["jersey"] == "limp"
    assert classes["denim"] == classes["leather"] == classes["cotton_poplin"] == "firm"


# ---- the table of the package and what runs state


def test_package_table_is_whole_and_says_where_it_comes_from():
    found = calibration()
    assert (np.diff(found.spacings) > 0).all()
    assert (np.diff(found.areas) > 0).all()
    for rows in found.typical.values():
        assert rows.shape == (len(found.areas), len(found.spacings))
        assert (rows > 0).all()
    assert found.factor >= 1.0
    assert set(found.provenance) >= {"date", "scenes", "reference_spacing", "content", "machine", "core"}
    assert {fabric_class(Fabric.preset(name)) for name in fabric_presets()} <= set(found.typical)


@pytest.mark.parametrize("quality", QUALITIES)
def test_scene_of_each_quality_states_what_to_expect_of_its_garment_and_fabric(quality):
    scarf, silk = pattern({"p": rectangle(0.2, 0.2)}), Fabric.preset("silk")
    scene = Scene.build(scarf, fabric=silk, quality=quality)
    expected = calibration().promise(QUALITIES[quality], Cloth.of(0.04, silk))
    assert scene.settings.expected_error == expected
    source = NOT_MEASURED if expected is None else calibration().source
    assert scene.settings.expected_error_source == source


def test_tolerance_takes_the_spacing_of_the_table_and_keeps_its_promise():
    cloth = Cloth(0.6, "limp")
    tolerance = 1.1 * calibration().promise(FINEST, cloth)
    settings = settings_for(tolerance=tolerance, cloth=cloth)
    assert settings.spacing == calibration().spacing(tolerance, cloth)
    assert settings.spacing >= FINEST
    assert settings.expected_error <= tolerance * (1 + 1e-9)


def test_what_no_setting_can_promise_takes_the_finest_and_is_said():
    scene = Scene.build(pattern({"p": rectangle(0.2, 0.2)}), tolerance=1e-6)
    assert scene.settings.spacing == min(QUALITIES.values())
    assert any("without a promise" in line for line in scene.warnings)


@pytest.mark.parametrize("changed", [{"contact_offset": 0.005}, {"rest_displacement": 0.01}, {"safety": 0.5}])
def test_nothing_is_promised_for_settings_that_were_not_calibrated(changed):
    settings = with_expected_error(Settings(spacing=FINEST, **changed))
    assert settings.expected_error is None
    assert settings.expected_error_source == NOT_MEASURED


def test_spacing_by_hand_gets_the_promise_of_the_table():
    promise = calibration().promise(FINEST)
    assert promise > 0.0
    assert with_expected_error(Settings(spacing=FINEST)).expected_error == promise
    assert with_expected_error(Settings(spacing=FINEST, max_time=3.0)).expected_error == promise
    assert with_expected_error(Settings(spacing=0.5)).expected_error is None
