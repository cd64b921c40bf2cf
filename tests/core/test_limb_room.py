"""Sleeves whose seams a limb blocks start where the limb lies between their panels."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, rectangle
from scipy.spatial.transform import Rotation

from cloth_core import limb_room
from cloth_core.blocked_lines import BlockedLines, seam_lines
from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.intersections import crossing_edges
from cloth_core.limb_room import with_room_for_limbs
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

# A level arm along x, 8 cm thick, at a height of 1 m.
ARM = body_of(
    trimesh.creation.cylinder(0.04, 0.8, sections=48),
    Rotation.from_euler("y", 90, degrees=True).as_matrix(),
    move=[0, 0, 1.0],
)
# Sewn along their upper and lower edges.
LONG_SIDES = [[("front", 0), ("back", 0)], [("front", 2), ("back", 2)]]


def sleeve(lowest: float, height: float = 0.2):
    """Panels 30 cm long and so high, 8 cm in front of and behind the arm, from a height of `lowest` [m] on."""
    middle = lowest + 0.5 * height
    return pattern(
        {
            "front": rectangle(0.3, height, at=(0, middle, 0.08)),
            "back": rectangle(0.3, height, at=(0, middle, -0.08), turned=(0, 180, 0)),
        },
        LONG_SIDES,
    )


@pytest.mark.parametrize("lowest", [0.97, 0.99, 1.02, 0.81, 0.79])
def test_arm_in_a_seam_gets_between_the_panels(lowest):
    garment = Garment.from_pattern(sleeve(lowest), 0.03)
    # The lines of a seam at height z pass through the arm if |z - 1 m| < 4 cm: one of the two does, at the start.
    heights = np.array([lowest, lowest + 0.2])
    assert (np.abs(heights - 1.0) < 0.04).sum() == 1
    moved = with_room_for_limbs(garment, ARM)
    way = moved.start - garment.start
    np.testing.assert_allclose(way, np.broadcast_to(way[0], way.shape), atol=1e-12)  # as one
    assert abs(way[0, 1]) < 1e-9  # neither nearer nor farther
    below, above = heights + way[0, 2]
    assert below < 0.961
    assert above > 1.039
    assert np.linalg.norm(way[0]) < 0.08


def soup(count: int, seed: int = 3) -> Body:
    """Large triangles every which way, as no body has them: around the sleeve, but without touching its panels."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform([-0.6, -0.07, 0.4], [0.6, 0.07, 1.6], (count, 3, 3))
    return Body("soup", corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


def test_lines_are_counted_as_the_exact_counter_does():
    garment = Garment.from_pattern(sleeve(0.97), 0.03)
    lines = seam_lines(list(garment.seams))
    flat = np.concatenate([lines, lines[:, 1:]], axis=1)
    for body in (ARM, soup(5), soup(50)):
        naive = len(crossing_edges(garment.start, flat, body.vertices, body.triangles))
        assert 0 < naive <= len(lines)
        counter = BlockedLines(body)
        assert counter.count(garment.start, lines) == naive
        assert counter.count(garment.start, lines, enough=naive - 1) == naive - 1
        assert not counter.spent


def test_search_that_takes_too_many_tests_moves_nothing(monkeypatch):
    garment = Garment.from_pattern(sleeve(0.98), 0.03)
    assert with_room_for_limbs(garment, ARM) is not garment
    monkeypatch.setattr(limb_room, "_MOST_TESTS", 100)
    assert with_room_for_limbs(garment, ARM) is garment
    counter = BlockedLines(ARM, 10)
    lines = seam_lines(list(garment.seams))
    assert counter.count(garment.start, lines) == len(lines)
    assert counter.spent


def test_where_cloth_is_in_the_way_it_goes_past_it():
    """The shortest way, straight down, leads through a shelf of cloth below one end of the sleeve."""
    panels = {
        "front": rectangle(0.3, 0.2, at=(0, 1.085, 0.08)),
        "back": rectangle(0.3, 0.2, at=(0, 1.085, -0.08), turned=(0, 180, 0)),
        "shelf": rectangle(0.1, 0.4, at=(-0.15, 0.957, 0), turned=(90, 0, 0)),
    }
    garment = Garment.from_pattern(pattern(panels, LONG_SIDES), 0.03)
    moved = with_room_for_limbs(garment, ARM)
    sewn = garment.panel_of_particle < 2
    np.testing.assert_array_equal(moved.start[~sewn], garment.start[~sewn])
    assert moved.start[sewn, 2].min() < 0.961
    assert moved.start[sewn, 0].min() > -0.1
    alone = Garment.from_pattern(sleeve(0.985), 0.03)
    assert (with_room_for_limbs(alone, ARM).start - alone.start)[0] == pytest.approx([0.0, 0.0, -0.03], abs=1e-9)


def test_what_is_free_stays_where_the_pattern_puts_it():
    garment = Garment.from_pattern(sleeve(0.9), 0.03)
    assert with_room_for_limbs(garment, ARM) is garment


def test_sleeve_that_starts_too_high_is_sewn_around_the_arm():
    scene = Scene.build(sleeve(0.98), ARM, Fabric.preset("jersey"), settings=Settings(spacing=0.03))
    simulation = Simulation(scene)
    report = simulation.settle()
    assert report.open_seams == {}
    assert report.body_intersections == report.self_intersections == 0
    x = simulation.positions
    assert x[:, 2].min() < 0.95  # below the arm as well as
    assert x[:, 2].max() > 1.03  # above it
