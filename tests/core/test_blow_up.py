"""The predicted stable time step against the one from which scenes really blow up, at the extremes."""

import math

import numpy as np
import pytest
from apparatus import plain_fabric, sheet

from cloth_core.blow_up import measure_blow_up
from cloth_core.errors import SimulationError
from cloth_core.scene import Scene
from cloth_core.stability_cases import stability_cases

CASES = {f"{case.group}, {case.name}": case for case in stability_cases(quick=True)}


@pytest.mark.parametrize("name", CASES)
def test_prediction_holds_at_the_extremes(name):
    found = CASES[name].run()
    assert 0.8 <= found.ratio <= 1.0


def test_the_full_map_covers_what_it_should():
    groups: dict[str, list[float]] = {}
    for case in stability_cases():
        groups.setdefault(case.group, []).append(case.value)
    assert (min(groups["stiffness [N/m]"]), max(groups["stiffness [N/m]"])) == (1e-3, 1e8)
    assert (min(groups["mass ratio of neighbours"]), max(groups["mass ratio of neighbours"])) == (1.0, 1e6)
    assert groups["damping ratio of the stiffest mode"][0] == 0.0
    assert groups["damping ratio of the stiffest mode"][-1] > 1.0
    assert (groups["particles along a side"][0], groups["particles along a side"][-1]) == (2.0, 500.0)
    assert max(groups["aspect of the triangles"]) == 1e4


def test_measurement_finds_the_closed_form():
    # Two particles wide, one spring long: the blow-up of a square of four masses with sides and diagonals.
    k, density, side = 250.0, 0.4, 0.1
    fabric = plain_fabric(structural_warp=k, structural_weft=k, shear=0.0, bending=0.0, area_density=density)
    garment = sheet(side, side, side)
    found = measure_blow_up(Scene(garment=garment, fabric=fabric, gravity=(0.0, 0.0, 0.0), air_drag=0.0))
    # Each side of stiffness k / 2 between two masses of a quarter of the cell: the matrix by hand.
    mass = np.full(4, density * side**2 / 4.0)
    matrix = np.zeros((8, 8))
    for i in range(4):
        for j in range(i):
            along = garment.rest[i] - garment.rest[j]
            if np.linalg.norm(along) > 1.1 * side:
                continue
            block = k / 2.0 * np.outer(along, along) / side**2
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                matrix[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] += sign * block
    scale = np.repeat(1.0 / np.sqrt(mass), 2)
    highest = math.sqrt(np.linalg.eigvalsh(scale[:, None] * matrix * scale)[-1])
    assert found.measured == pytest.approx(2.0 / highest, rel=3e-3)
    assert found.predicted == pytest.approx(2.0 / highest, rel=3e-3)


def test_scene_that_cannot_blow_up_is_refused():
    # Held everywhere.
    garment = sheet(0.1, 0.1, 0.1)
    scene = Scene(garment=garment, fabric=plain_fabric(), pins=np.arange(4, dtype=np.int32), air_drag=0.0)
    with pytest.raises(SimulationError, match="take a scene with a limit"):
        measure_blow_up(scene)
