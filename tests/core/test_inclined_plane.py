"""A sheet on an inclined plane: it sticks while tan(angle) <= mu, else it slides with a = g (sin - mu cos)."""

import math

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, placed, plain_fabric, sheet, throw
from scipy.spatial.transform import Rotation

from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

MU = 0.4
OFFSET = 0.003


def on_a_slope(angle: float, friction: float, speed: float = 0.0, body: str = "box") -> tuple[Simulation, np.ndarray]:
    """A sheet that lies at rest on a slope falling towards +x; and the unit vector downhill."""
    turn = Rotation.from_euler("y", angle).as_matrix()
    if body == "box":
        slope = body_of(trimesh.creation.box(extents=[4.0, 1.0, 0.2]), turn, turn @ [0.0, 0.0, -0.1])
    else:  # one quad of two triangles, open
        corners = [[-2, -0.5, 0], [2, -0.5, 0], [2, 0.5, 0], [-2, 0.5, 0]]
        slope = body_of(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), turn)
    garment = placed(sheet(0.2, 0.2, 0.04, z=OFFSET), turn)
    scene = Scene(
        garment=garment, body=slope, fabric=plain_fabric(friction=friction, damping_time=1e-4), air_drag=0.0,
        gravity=(0.0, 0.0, -GRAVITY), settings=Settings(contact_offset=OFFSET),
    )  # fmt: skip
    simulation = Simulation(scene)
    downhill = turn @ [1.0, 0.0, 0.0]
    throw(simulation, speed * downhill)
    return simulation, downhill


@pytest.mark.parametrize("body", ["box", "quad"])
@pytest.mark.parametrize("steepness", [0.0, 0.5, 0.9, 0.99])
def test_sticks_while_the_tangent_is_below_the_friction(steepness, body):
    simulation, _ = on_a_slope(math.atan(steepness * MU), MU, body=body)
    start = simulation.positions
    simulation.advance(0.5)
    assert np.abs(simulation.positions - start).max() < 1e-6


@pytest.mark.parametrize("body", ["box", "quad"])
@pytest.mark.parametrize("steepness", [1.05, 1.3, 2.0, 4.0])
def test_slides_with_the_acceleration_of_coulombs_law(steepness, body):
    angle = math.atan(steepness * MU)
    simulation, downhill = on_a_slope(angle, MU, body=body)
    start = simulation.positions
    simulation.advance(0.4)
    way = (simulation.positions - start) @ downhill
    acceleration = GRAVITY * (math.sin(angle) - MU * math.cos(angle))
    assert way == pytest.approx(acceleration * 0.4**2 / 2, rel=0.02)
    assert np.ptp(way) < 1e-3 * way.mean()  # as a whole
    normal = np.cross(downhill, [0.0, 1.0, 0.0])
    np.testing.assert_allclose((simulation.positions - start) @ normal, 0.0, atol=1e-6)


@pytest.mark.parametrize("angle", [0.2, 0.4])
def test_slides_freely_without_friction(angle):
    simulation, downhill = on_a_slope(angle, 0.0)
    start = simulation.positions
    simulation.advance(0.3)
    assert (simulation.positions - start) @ downhill == pytest.approx(GRAVITY * math.sin(angle) * 0.3**2 / 2, rel=0.01)


def test_friction_brings_a_moving_sheet_to_a_stop():
    # On the level: v^2 / (2 mu g), and then it stays.
    simulation, downhill = on_a_slope(0.0, MU, speed=1.0)
    start = simulation.positions
    simulation.advance(1.0 / (MU * GRAVITY) + 0.1)
    way = (simulation.positions - start) @ downhill
    assert way == pytest.approx(1.0 / (2 * MU * GRAVITY), rel=0.02)
    stopped = simulation.positions
    simulation.advance(0.2)
    assert np.abs(simulation.positions - stopped).max() < 1e-6
