"""A coarse drape as a start: places on it, what cuts through the body, and the same drape at the end."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, pattern, rectangle, sheet, sides_through

from cloth_core.body import Body
from cloth_core.calibration import Cloth, calibration
from cloth_core.coarse_start import interpolation_between, pushed_out_of_body
from cloth_core.drape_error import Drape, drape_error
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

CUBE = body_of(trimesh.creation.box(extents=[0.2, 0.2, 0.2]))


def test_places_of_a_rectangle_carry_every_linear_map_over_exactly():
    data = pattern({"panel": rectangle(0.3, 0.2)})
    coarse, fine = (Garment.from_pattern(data, spacing) for spacing in (0.05, 0.02))
    interpolation = interpolation_between(coarse, fine)
    linear = np.random.default_rng(4).standard_normal((2, 3))
    np.testing.assert_allclose(interpolation(coarse.rest @ linear), fine.rest @ linear, atol=1e-12)
    np.testing.assert_allclose(interpolation.weights.sum(axis=1), 1.0, rtol=1e-12)
    assert (interpolation.weights >= 0.0).all()


def test_points_of_a_seam_still_meet():
    shirt = Pattern.load("tshirt")
    coarse, fine = (Garment.from_pattern(shirt, spacing) for spacing in (0.06, 0.03))
    interpolation = interpolation_between(coarse, fine)
    # Coarse points that are sewn lie together; nothing else does.
    x = np.random.default_rng(5).standard_normal((coarse.particle_count, 3))[coarse.merged_indices]
    found = interpolation(x)
    for seam in fine.seams:
        np.testing.assert_allclose(found[seam.first], found[seam.second], atol=1e-12)


def test_cloth_that_cuts_across_an_edge_of_the_body_is_moved_out():
    # A sheet bent over an edge of the cube, 2 mm away from it, but with no particle near the edge.
    garment = sheet(0.1, 0.15, 0.05)
    x = garment.start.copy()
    along = garment.rest[:, 1]  # from the edge: -75, -25, 25 and 75 mm
    over = along < 0.0
    x[:, 0] = np.where(over, 0.102, 0.102 - along)
    x[:, 2] = np.where(over, 0.102 + along, 0.102)
    x[:, 1] = garment.rest[:, 0]
    assert crossings(x, garment.triangles, CUBE) > 0
    moved = pushed_out_of_body(x, garment.triangles, CUBE, 0.003)
    assert crossings(moved, garment.triangles, CUBE) == 0
    assert np.linalg.norm(moved - x, axis=1).max() < 0.02
    np.testing.assert_array_equal(pushed_out_of_body(moved, garment.triangles, CUBE, 0.003), moved)


def test_tip_that_comes_through_a_triangle_is_moved_out_of_it():
    # A cone whose tip is 4 mm above a sheet, in the middle of one of its triangles: no side of the sheet meets it.
    garment = sheet(0.12, 0.12, 0.04)
    middle = garment.start[garment.triangles[4]].mean(axis=0)
    cone = body_of(trimesh.creation.cone(0.05, 0.1), move=[middle[0], middle[1], middle[2] + 0.004 - 0.1])
    cloth = garment.start, garment.triangles
    assert sides_through(*cloth, cone.vertices, cone.triangles) == 0
    assert sides_through(cone.vertices, cone.triangles, *cloth) > 0
    moved = pushed_out_of_body(*cloth, cone, 0.003)
    assert crossings(moved, garment.triangles, cone) == 0
    assert 0.004 <= (moved - garment.start)[:, 2].max() < 0.02


def test_fine_start_on_a_body_with_tips_crosses_it_nowhere():
    scene = Scene.build(Pattern.load("dress"), Body.load("young"), settings=Settings(spacing=0.02))
    simulation = Simulation(scene)
    simulation.settle(lambda s: not s.drapes_coarsely)
    assert simulation.phase == "draping"
    assert crossings(*simulation.sewn_mesh(), scene.body) == 0


@pytest.mark.parametrize("garment", ["skirt", "tshirt"])
def test_drape_is_the_same_as_from_a_fine_start(garment, monkeypatch):
    def draped() -> tuple[Simulation, Drape]:
        simulation = Simulation(
            Scene.build(Pattern.load(garment), Body.load("middle_aged"), settings=Settings(spacing=0.02))
        )
        assert simulation.settle().settled
        g = simulation.scene.garment
        return simulation, Drape(simulation.positions, g.triangles, g.panel_of_triangle, g.panel_names)

    coarse, found = draped()
    monkeypatch.setattr("cloth_core.simulation._COARSEST", 0.0)
    fine, expected = draped()
    assert coarse.state_hash() != fine.state_hash()
    # Folds have many resting shapes (docs/accuracy.md); a run promises to be this near to the right one.
    scene = coarse.scene
    promise = calibration().promise(0.02, Cloth.of(scene.garment.areas.sum(), scene.fabric))
    assert promise is not None
    assert drape_error(found, expected).rms < promise


def test_a_disturbed_start_disturbs_the_coarse_one_too():
    scene = Scene.build(Pattern.load("skirt"), Body.load("young"), settings=Settings(spacing=0.03))
    assert scene.disturbed(0) is scene
    one, two = scene.disturbed(1), scene.disturbed(2)
    for other in (one, two):
        way = np.linalg.norm(other.garment.start - scene.garment.start, axis=1)
        np.testing.assert_allclose(way, 1e-4, rtol=1e-9)
    coarse, plain = one.with_spacing(0.06), scene.with_spacing(0.06)
    way = np.linalg.norm(coarse.garment.start - plain.garment.start, axis=1)
    np.testing.assert_allclose(way, 1e-4, rtol=1e-9)
