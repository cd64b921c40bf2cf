"""Free fall leaves a sheet as it is; a scene that is turned or moved gives the same result, turned or moved."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, pattern, placed, plain_fabric, rectangle, sheet
from scipy.spatial.transform import Rotation

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.springs import spring_strains


def curved_panel() -> Garment:
    """A panel with a curved outline, so that it has a band of triangles that are not of the grid."""
    data = rectangle(0.4, 0.3, at=(0, 0.5, 0), turned=(20, 30, 0))
    data["edges"][2]["curvature"] = {"type": "quadratic", "params": [[0.5, 0.3]]}
    data["edges"][0]["curvature"] = {"type": "circle", "params": [0.3, 0, 1]}
    return Garment.from_pattern(pattern({"panel": data}), 0.02)


def one_panel_of(name: str) -> Garment:
    """The first panel of a built-in pattern, unsewn."""
    whole = Pattern.load(name)
    first = next(iter(whole.panels))
    return Garment.from_pattern(replace(whole, panels={first: whole.panels[first]}, stitches=()), 0.02)


@pytest.mark.parametrize("area_density", [0.005, 0.2, 2.0])
@pytest.mark.parametrize(
    "garment", [sheet(0.4, 0.3, 0.02), curved_panel(), one_panel_of("tshirt")], ids=["sheet", "curved", "tshirt"]
)
def test_free_fall_is_exact_and_strains_nothing(garment, area_density):
    scene = Scene(
        garment=garment, fabric=Fabric.preset("cotton_poplin", area_density=area_density), air_drag=0.0,
        gravity=(0.0, 0.0, -GRAVITY), settings=Settings(time_step=1e-4 if area_density > 0.01 else 5e-6),
    )  # fmt: skip
    simulation = Simulation(scene)
    dt = simulation.time_step
    assert dt == scene.settings.time_step  # no sub-steps: the count of steps below is the one that is done
    simulation.advance(0.03)
    n = simulation.steps
    assert n == round(0.03 / dt)
    fallen = garment.start - simulation.positions
    # Symplectic Euler: dt^2 g n (n + 1) / 2, a little more than g t^2 / 2.
    np.testing.assert_allclose(fallen[:, 2], GRAVITY * dt * dt * n * (n + 1) / 2, rtol=1e-9)
    np.testing.assert_allclose(fallen[:, :2], 0.0, atol=1e-12)
    assert np.abs(spring_strains(simulation.positions, simulation.model.springs)).max() < 1e-11


def test_falling_garment_reaches_terminal_speed():
    garment = sheet(0.2, 0.2, 0.05)
    scene = Scene(
        garment=garment, fabric=plain_fabric(structural_warp=2.0, structural_weft=2.0, shear=1.0), air_drag=5.0
    )
    simulation = Simulation(scene)
    simulation.advance(6.0)
    before = simulation.positions
    simulation.advance(0.5)
    np.testing.assert_allclose((before - simulation.positions)[:, 2], 0.5 * GRAVITY / 5.0, rtol=1e-9)


# ---- the same scene elsewhere


def swinging(rotation: np.ndarray, move: np.ndarray, seconds: float) -> np.ndarray:
    """A sheet pinned at one side swings down from level; its positions."""
    garment = sheet(0.3, 0.2, 0.025)
    held = np.flatnonzero(garment.rest[:, 0] < -0.149)
    scene = Scene(
        garment=placed(garment, rotation, move), fabric=Fabric.preset("cotton_poplin"), pins=held.astype(np.int32),
        gravity=tuple(rotation @ [0.0, 0.0, -GRAVITY]), settings=Settings(time_step=1e-4),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.advance(seconds)
    return simulation.positions


def dropped(rotation: np.ndarray, move: np.ndarray, seconds: float) -> np.ndarray:
    """A sheet dropped on a ball; its positions."""
    ball = body_of(trimesh.creation.icosphere(subdivisions=3, radius=0.1), rotation, move)
    scene = Scene(
        garment=placed(sheet(0.25, 0.2, 0.025, z=0.13), rotation, move), body=ball,
        fabric=Fabric.preset("cotton_poplin"), gravity=tuple(rotation @ [0.0, 0.0, -GRAVITY]),
        settings=Settings(time_step=1e-4),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.advance(seconds)
    return simulation.positions


TURNS = {
    "about the vertical": Rotation.from_euler("z", 40, degrees=True).as_matrix(),
    "onto its side": Rotation.from_euler("x", 90, degrees=True).as_matrix(),
    "anyhow": Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(),
}


@pytest.mark.parametrize("turn", TURNS)
def test_turned_scene_gives_the_turned_result(turn):
    straight = swinging(np.eye(3), np.zeros(3), 0.25)
    turned = swinging(TURNS[turn], np.zeros(3), 0.25)
    assert np.ptp(straight[:, 2]) > 0.15  # it has swung
    np.testing.assert_allclose(turned, straight @ TURNS[turn].T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("turn", TURNS)
def test_turned_scene_with_contact_gives_the_turned_result(turn):
    straight = dropped(np.eye(3), np.zeros(3), 0.15)
    turned = dropped(TURNS[turn], np.zeros(3), 0.15)
    assert np.ptp(straight[:, 2]) > 0.02  # it lies on the ball and hangs down around it
    # The boxes of a turned scene are others and so is the order of its contacts: impulses that share a particle come
    # out a little differently, and a fall in folds amplifies that.
    np.testing.assert_allclose(turned, straight @ TURNS[turn].T, rtol=0, atol=5e-4)


def test_scene_moved_by_10_km_gives_the_same_to_the_precision_of_its_coordinates():
    # There a coordinate has steps of 1.8e-12 m, a thousand times those of a scene at the origin: after 2500 steps the
    # results still agree to a nanometre.
    move = np.array([1e4, -1e4, 1e4])
    here, there = swinging(np.eye(3), np.zeros(3), 0.25), swinging(np.eye(3), move, 0.25)
    np.testing.assert_allclose(there - move, here, rtol=0, atol=1e-8)


def test_scene_with_contact_moved_by_10_km_gives_the_same_to_the_precision_of_its_coordinates():
    move = np.array([1e4, -1e4, 1e4])
    here, there = dropped(np.eye(3), np.zeros(3), 0.15), dropped(np.eye(3), move, 0.15)
    np.testing.assert_allclose(there - move, here, rtol=0, atol=1e-5)
