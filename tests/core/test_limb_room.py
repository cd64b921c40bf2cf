"""Sleeves whose seams a limb blocks start where the limb lies between their panels."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, rectangle
from scipy.spatial.transform import Rotation

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
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
