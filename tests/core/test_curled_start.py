"""Sides of panels that start around an arm are curled inside of it."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, pattern, rectangle
from scipy.spatial.transform import Rotation

from cloth_core.body import Body
from cloth_core.curled_start import curled_inside_limbs
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


def column(radius: float, x: float = 0.0) -> trimesh.Trimesh:
    """An upright column, 1.2 m high."""
    return trimesh.creation.cylinder(
        radius, 1.2, sections=40, transform=trimesh.transformations.translation_matrix([x, 0, 0.6])
    )


def trunk_and_arms(*arms: float) -> Body:
    """A trunk 0.3 m thick and arms 8 cm thick, upright at the given x [m]."""
    return body_of(trimesh.util.concatenate([column(0.15), *(column(0.04, x) for x in arms)]))


def tube(half_distance: float = 0.18, turned: float = 0.0) -> Garment:
    """A front and a back 0.66 m wide, 2 x 0.33 m to each side: around the trunk it takes 0.24 m and more."""
    spin = np.radians(turned)
    at = (half_distance * np.sin(spin), 0.6, half_distance * np.cos(spin))
    panels = {
        "front": rectangle(0.66, 0.4, at=at, turned=(0, turned, 0)),
        "back": rectangle(0.66, 0.4, at=(-at[0], 0.6, -at[2]), turned=(0, 180 + turned, 0)),
    }
    return Garment.from_pattern(pattern(panels, SIDES), 0.03)


def sides_of(garment: Garment, x: np.ndarray) -> np.ndarray:
    """Lengths of all sides of the triangles [m]."""
    corner = x[garment.triangles]
    return np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)


@pytest.mark.parametrize("arms", [(0.33,), (-0.31, 0.33)])
def test_side_that_starts_around_an_arm_is_curled_inside_of_it(arms):
    garment, body = tube(), trunk_and_arms(*arms)
    curled = curled_inside_limbs(garment, body)
    for arm in arms:
        # The seam on that side lies between the arm and the trunk, and the straight lines that it closes along do.
        (seam,) = (s for s in garment.seams if garment.start[s.first, 0].mean() * arm > 0)
        for side in (seam.first, seam.second):
            assert (np.abs(curled.start[side, 0]) < abs(arm) - 0.04).all()
            assert (np.abs(curled.start[side, 0]) > 0.15).all()
    # Bent, but not stretched: a chord is shorter than its arc, 1 - (0.03 / 0.1)^2 / 24 of it.
    assert sides_of(garment, curled.start) == pytest.approx(sides_of(garment, garment.start), rel=0.01)
    assert np.array_equal(curled.start[:, 2], garment.start[:, 2])  # about an upright axis
    assert crossings(curled.start, curled.triangles, body) == 0
    if len(arms) == 1:  # the other side stays flat, though both panels may have gone outwards
        front = (garment.panel_of_particle == 0) & (garment.start[:, 0] < 0.0)
        assert np.ptp((curled.start - garment.start)[front], axis=0) == pytest.approx([0, 0, 0], abs=1e-12)


def test_curl_does_not_depend_on_where_the_body_faces():
    turn = Rotation.from_euler("z", 35, degrees=True).as_matrix()
    body = trunk_and_arms(0.33)
    turned = body_of(trimesh.Trimesh(body.vertices, body.triangles, process=False), turn)
    straight = curled_inside_limbs(tube(), body)
    askew = curled_inside_limbs(tube(turned=35.0), turned)
    assert straight.start != pytest.approx(tube().start, abs=0.01)
    np.testing.assert_allclose(askew.start, straight.start @ turn.T, atol=1e-9)


def test_without_an_arm_in_a_seam_nothing_is_curled():
    garment = tube()
    assert curled_inside_limbs(garment, trunk_and_arms()) is garment
    assert curled_inside_limbs(garment, trunk_and_arms(0.45)) is garment


def test_what_lies_in_a_sleeve_is_not_shut_out():
    # Both sides of a narrow tube are blocked by the one thing that it is to go around.
    garment = tube()
    assert curled_inside_limbs(garment, body_of(column(0.04, 0.33))) is garment


def test_tube_is_sewn_between_the_arms():
    panels = {
        "front": rectangle(0.66, 0.4, at=(0, 0.6, 0.18)),
        "back": rectangle(0.66, 0.4, at=(0, 0.6, -0.18), turned=(0, 180, 0)),
    }
    body = trunk_and_arms(-0.33, 0.33)
    scene = Scene.build(pattern(panels, SIDES), body, Fabric.preset("jersey"), settings=Settings(spacing=0.04))
    simulation = Simulation(scene)
    simulation.settle(lambda run: run.phase != "sewing")
    report = simulation.report()
    assert report.open_seams == {}
    assert report.max_seam_gap < 0.001
    assert report.body_intersections == report.self_intersections == 0
    x = simulation.positions
    assert np.hypot(x[:, 0], x[:, 1]).max() < 0.45
    at_arms = np.abs(x[:, 1]) < 0.03
    assert np.abs(x[at_arms, 0]).max() < 0.29  # inside of the arms, not around them
