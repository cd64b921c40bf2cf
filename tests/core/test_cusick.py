"""Cloth over a round table: the order of published fabrics."""

import math

import numpy as np
import pytest
from cusick import BANDS, DISC_RADIUS, PUBLISHED, SUPPORT_RADIUS, drape, drape_coefficient, published_fabric

from cloth_core.fabric import Fabric

SPACING = 0.015


@pytest.fixture(scope="module")
def drapes():
    return {name: drape(published_fabric(name), SPACING) for name in PUBLISHED}


def test_order_is_the_published_one(drapes):
    assert all(d.settled for d in drapes.values())
    found = sorted(PUBLISHED, key=lambda name: -drapes[name].coefficient)
    assert found == sorted(PUBLISHED, key=lambda name: -PUBLISHED[name][3])


def test_nothing_stretches_and_all_hangs_below_the_table(drapes):
    for d in drapes.values():
        radius = np.hypot(d.rim[:, 0], d.rim[:, 1])
        assert SUPPORT_RADIUS < radius.min() < radius.max() < 1.001 * DISC_RADIUS
        assert d.rim[:, 2].max() < 0.0


@pytest.mark.parametrize("name", BANDS)
def test_preset_drapes_as_its_class_does(name):
    low, high = BANDS[name]
    assert low < drape(Fabric.preset(name), 0.01).coefficient < high


def test_coefficient_of_a_flat_disc_and_of_a_bare_table():
    angle = np.linspace(0.0, 2.0 * math.pi, 721)[:-1]
    for radius, expected in ((DISC_RADIUS, 100.0), (SUPPORT_RADIUS, 0.0)):
        rim = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(720)])
        fan = np.column_stack([np.full(720, 720), np.arange(720), np.roll(np.arange(720), -1)])
        assert drape_coefficient(np.vstack([rim, np.zeros(3)]), fan) == pytest.approx(expected, abs=0.02)
