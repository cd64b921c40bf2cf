"""How tight a garment is, and that far too tight ones are not waited for."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, plain_fabric, rectangle, sheet

from cloth_core.fabric import Fabric
from cloth_core.model import Model
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.tightness import Tightness, TightnessWatch, times_the_limit

SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


def tightness(times: float, limit: float = 0.05) -> Tightness:
    return Tightness(times * limit, limit, "front", np.zeros(3))


def watched(times, movement=0.001) -> TightnessWatch:
    """After windows in which the strain was so many times the limit and something moved so far [m]."""
    watch = TightnessWatch()
    for strain, way in zip(*(a.tolist() for a in np.broadcast_arrays(times, movement)), strict=True):
        watch.look(tightness(strain), way)
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


def test_what_is_held_far_too_tight_is_not_waited_for():
    assert watched([6.0] * 5).hopeless
    assert watched([6.0] * 5).patience(False, False) == 0.0
    assert not watched([6.0] * 4).hopeless
    # Cloth that swings is stretched for a moment, and what gives is not held.
    assert not watched([6.0] * 20, movement=0.02).hopeless
    assert not watched([6.0, 6.0, 6.0, 6.0, 4.0] * 4).hopeless


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


def test_garment_that_is_merged_on_far_too_large_a_body_ends_soon_and_says_where():
    # Two times 0.4 m on a column that is 0.96 m around, closed at one stroke by a merging distance of 1 m.
    column = trimesh.creation.box(extents=[0.336, 0.144, 1.0])
    panels = {
        "front": rectangle(0.4, 0.16, at=(0, 0.5, 0.4)),
        "back": rectangle(0.4, 0.16, at=(0, 0.5, -0.4), turned=(0, 180, 0)),
    }
    scene = Scene.build(
        pattern(panels, SIDES), body_of(column, move=[0, 0, 0.5]), Fabric.preset("cotton_poplin"),
        settings=Settings(spacing=0.04, merge_distance=1.0),
    )  # fmt: skip
    simulation = Simulation(scene)
    report = simulation.settle()
    assert not report.settled
    assert report.open_seams == {}
    assert simulation.time < 3.0
    assert report.rest_reason.startswith("too tight: panel '")
    assert report.rest_reason.endswith("5 % is the fabric's limit, and it does not come to rest")
    said = float(report.rest_reason.split("stretched by ")[1].split(" %")[0])
    # The longest of all sides along warp or weft, by itself.
    x, garment = simulation.positions, scene.garment
    sides = np.concatenate([garment.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    way = garment.rest[sides[:, 1]] - garment.rest[sides[:, 0]]
    straight = np.abs(way).min(axis=1) < 1e-9
    length = np.linalg.norm(x[sides[:, 1]] - x[sides[:, 0]], axis=1) / np.linalg.norm(way, axis=1)
    assert said == pytest.approx(100.0 * (length[straight].max() - 1.0), abs=1.0)
