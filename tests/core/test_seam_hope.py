"""When seams are given up: not while they get nearer, soon when neither pull nor stretch brings them together."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, rectangle

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.seam_hope import SeamHope, far_points, stretch_beside
from cloth_core.simulation import Simulation

LOOK = 0.05  # s
SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


def lost_at(still_open, stretch=0.0, pull=1.0, full_pull=False, length=0.5) -> int | None:
    """Number of the look at which hope is lost; each argument for all looks or for each."""
    hope = SeamHope()
    each = np.broadcast_arrays(still_open, length, stretch, pull, full_pull)
    for k, (gap, long, strain, hard, full) in enumerate(zip(*(a.tolist() for a in each), strict=True)):
        if hope.lost(gap, long, strain, hard, full, LOOK * k):
            return k
    return None


def test_what_gets_nearer_is_not_given_up_however_tight():
    nearer = 0.5 * 0.92 ** np.arange(40)  # by more than a fifth in four looks
    assert lost_at(nearer, stretch=10.0, pull=8.0, full_pull=True) is None
    assert lost_at(nearer, pull=1.25 ** np.arange(40)) is None


def test_what_has_closed_is_not_given_up():
    assert lost_at(np.zeros(40), stretch=10.0, pull=8.0, full_pull=True) is None


def test_full_pull_gets_three_tenths_of_a_second():
    stays = np.full(40, 0.5)
    assert lost_at(stays, pull=8.0, full_pull=True) == 6
    assert lost_at(stays) is None  # it will be pulled harder


def test_pull_that_was_doubled_in_vain_is_enough():
    pull = 1.25 ** np.arange(10)
    assert lost_at(np.full(10, 0.5), pull=pull) == 3  # 1.25^3 = 1.95
    # It counts from where they last got nearer, in small steps too.
    assert lost_at([0.5, 0.49, 0.495, 0.487, 0.487, 0.487, 0.487, 0.487, 0.487, 0.487], pull=pull) == 6


def test_cloth_stretched_by_twice_its_limit_is_too_tight_at_the_fourth_look():
    stays = np.full(10, 0.5)
    assert lost_at(stays, stretch=2.0) == 3
    assert lost_at(stays, stretch=1.9) is None
    assert lost_at(stays, stretch=20.0, length=0.19) is None  # a few points may slip past what holds them
    assert lost_at(stays, stretch=[2.0, 2.0, 2.0, 1.0, 2.0, 2.0, 2.0, 1.0, 2.0, 2.0]) is None


def test_stretch_and_gaps_are_those_of_what_is_open():
    garment = Garment.from_pattern(
        pattern(
            {"front": rectangle(0.4, 0.2), "back": rectangle(0.4, 0.2, at=(0, 0, -0.1), turned=(0, 180, 0))}, SIDES
        ),
        0.04,
    )
    x = garment.start.copy()
    points, total = far_points(garment.seams, x, 0.01)
    ends = np.concatenate([np.concatenate([s.first, s.second]) for s in garment.seams])
    assert sorted(points.tolist()) == sorted(ends.tolist())
    assert total == pytest.approx(sum(0.1 * len(s.first) for s in garment.seams))
    # Drawn out upwards by a quarter; across nothing changes.
    x[:, 2] *= 1.25
    assert stretch_beside(garment, points, x) == pytest.approx(0.25, abs=1e-9)
    assert stretch_beside(garment, points[:0], x) == 0.0
    x[garment.seams[0].second] = x[garment.seams[0].first]
    closed = {*garment.seams[0].first.tolist(), *garment.seams[0].second.tolist()}
    assert not closed.intersection(far_points(garment.seams, x, 0.01)[0].tolist())


@pytest.mark.parametrize(("wider", "closes"), [(1.04, True), (1.4, False)])
def test_tube_around_a_column_closes_if_its_fabric_reaches_around(wider, closes):
    # Two times 0.4 m, and poplin may stretch by 5 %.
    around = trimesh.creation.cylinder(radius=wider * 0.8 / (2.0 * np.pi) - 0.003, height=1.0, sections=64)
    panels = {
        "front": rectangle(0.4, 0.16, at=(0, 0.5, 0.25)),
        "back": rectangle(0.4, 0.16, at=(0, 0.5, -0.25), turned=(0, 180, 0)),
    }
    body = body_of(around, move=[0.0, 0.0, 0.5])
    scene = Scene.build(pattern(panels, SIDES), body, Fabric.preset("cotton_poplin"), settings=Settings(spacing=0.04))
    simulation = Simulation(scene)
    report = simulation.settle(lambda run: run.phase != "sewing")
    assert (report.open_seams == {}) is closes
    assert report.body_intersections == report.self_intersections == 0
    assert simulation.time < scene.settings.sewing_time - 1.0
