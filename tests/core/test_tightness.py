"""How tight a garment is, and which tight ones are waited for less."""

from dataclasses import replace

import numpy as np
import pytest
from apparatus import plain_fabric, sheet

from cloth_core.model import Model
from cloth_core.scene import Scene
from cloth_core.tightness import Tightness, TightnessWatch, times_the_limit


def tightness(times: float, limit: float = 0.05) -> Tightness:
    return Tightness(times * limit, limit, "front", np.zeros(3))


def watched(times: list[float]) -> TightnessWatch:
    """After windows in which the strain was so many times the limit."""
    watch = TightnessWatch()
    for strain in times:
        watch.look(tightness(strain))
    return watch


def test_largest_strain_is_found_with_its_place():
    garment = sheet(0.4, 0.3, 0.05)
    x = garment.start.copy()
    # Drawn out along its length, by 30 % in the middle: u + a sin u has the slope 1 + a cos u.
    phase = 2.0 * np.pi * (garment.rest[:, 0] - 0.0) / 0.4
    x[:, 0] += 0.3 * 0.4 / (2.0 * np.pi) * np.sin(phase)
    scene = Scene(garment=garment, fabric=replace(plain_fabric(), strain_limit=0.1))
    found = Tightness.of(Model(scene), x)
    assert found.panel == "sheet"
    assert found.limit == 0.1
    assert found.strain == pytest.approx(0.3, rel=0.15)  # at 50 mm a side sees the mean of the slope around its middle
    slope = 1.0 + 0.3 * np.cos(phase)
    nearest = np.argmin(np.linalg.norm(x - found.place, axis=1))
    assert slope[nearest] > 1.2


def test_tight_garments_are_waited_for_less_only_if_seams_will_stay_open():
    loose, tight = watched([1.0] * 5), watched([2.0] * 5)
    assert tight.patience(True, False) < loose.patience(True, False) < loose.patience(False, False)
    assert tight.patience(True, True) == loose.patience(True, True)
    assert tight.patience(False, False) == loose.patience(False, False)
    assert watched([2.0, 2.0, 2.0, 2.0, 1.0]).patience(True, False) == loose.patience(True, False)


def test_stiff_fabrics_count_as_five_percent():
    # Seams pull as for a stretch of 5 % at least: leather is no tighter than poplin for it.
    assert times_the_limit(0.1, 0.02) == times_the_limit(0.1, 0.05) == pytest.approx(2.0)
    assert times_the_limit(0.1, 0.08) == pytest.approx(1.25)
