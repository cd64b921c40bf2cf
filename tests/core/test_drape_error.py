"""The distance of two drapes, against trimesh's closest points and against shapes whose distance is known."""

import math

import numpy as np
import pytest
import trimesh

from cloth_core.drape_error import Drape, drape_error, motion_error, sample_points
from cloth_core.errors import ClothError


def of_mesh(mesh: trimesh.Trimesh) -> Drape:
    return Drape.of_surface(np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int32))


def level(width: float, height: float, z: float = 0.0, x: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, 0, z], [x + width, 0, z], [x + width, height, z], [x, height, z]], dtype=float)
    return corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def two_layers(front_z: float, back_z: float) -> Drape:
    """A front and a back panel, both level, without a seam."""
    (a, ta), (b, tb) = level(0.3, 0.3, front_z), level(0.3, 0.3, back_z)
    panels = np.array([0, 0, 1, 1], dtype=np.int32)
    return Drape(np.concatenate([a, b]), np.concatenate([ta, tb + 4]).astype(np.int32), panels, ("front", "back"))


def test_every_distance_is_that_of_trimesh():
    # Two wavy sheets of different meshes: nearest points lie in faces, on sides and on corners.
    rng = np.random.default_rng(1)
    sheets = []
    for count in (7, 11):
        u, v = np.meshgrid(np.linspace(0, 0.4, count), np.linspace(0, 0.3, count), indexing="ij")
        points = np.stack([u.ravel(), v.ravel(), 0.05 * rng.standard_normal(count * count)], axis=1)
        k = np.arange(count * count).reshape(count, count)
        quads = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 4)
        sheets.append(trimesh.Trimesh(points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]), process=False))
    a, b = sheets
    found = drape_error(of_mesh(a), of_mesh(b), spacing=0.02)
    squares, largest = [], []
    for mesh, other in ((a, b), (b, a)):
        points, areas = sample_points(np.asarray(mesh.vertices), np.asarray(mesh.faces), 0.02)
        distance = trimesh.proximity.closest_point(other, points)[1]
        corners = trimesh.proximity.closest_point(other, mesh.vertices)[1]
        squares.append((areas * distance**2).sum() / areas.sum())
        largest.append(max(distance.max(), corners.max()))
    # trimesh regards points within 1e-8 of each other as one.
    assert found.rms == pytest.approx(math.sqrt(np.mean(squares)), abs=1e-8)
    assert found.largest == pytest.approx(max(largest), abs=1e-8)


def test_samples_stand_for_the_whole_area_and_lie_closer_than_asked():
    mesh = trimesh.creation.icosphere(subdivisions=1)
    points, areas = sample_points(np.asarray(mesh.vertices), np.asarray(mesh.faces), 0.2)
    assert areas.sum() == pytest.approx(mesh.area, rel=1e-12)
    # Centroids integrate a linear function exactly.
    assert areas @ points[:, 0] == pytest.approx((mesh.area_faces * mesh.triangles_center[:, 0]).sum(), abs=1e-12)
    assert trimesh.proximity.closest_point(mesh, points)[1].max() < 1e-12
    assert areas.max() <= math.sqrt(3) / 4 * 0.2**2


def test_sheets_one_above_the_other_are_their_height_apart():
    error = drape_error(Drape.of_surface(*level(0.3, 0.3)), Drape.of_surface(*level(0.3, 0.3, z=0.007)))
    assert error.rms == pytest.approx(0.007)
    assert error.largest == pytest.approx(0.007)


def test_same_surface_in_other_triangles_is_no_error():
    sheet = trimesh.Trimesh(*level(0.3, 0.3), process=False)
    finer = sheet.subdivide().subdivide()
    error = drape_error(of_mesh(sheet), of_mesh(finer))
    assert error.largest < 1e-15


def test_both_ways_count():
    """A sheet that covers only half: from it the other one is at no distance, from the other one it is."""
    whole, half = Drape.of_surface(*level(0.4, 0.2)), Drape.of_surface(*level(0.2, 0.2))
    error = drape_error(whole, half, spacing=0.001)
    assert error.largest == pytest.approx(0.2)
    # Distances over the whole sheet: 0 on one half, 0 to 0.2 evenly on the other; over the half sheet: 0.
    assert error.rms == pytest.approx(math.sqrt((0.2**2 / 3 / 2 + 0) / 2), rel=1e-3)
    assert drape_error(half, whole, spacing=0.001) == error


def test_panel_is_held_against_the_same_panel():
    """Front and back that have changed places: as one surface nothing has changed, as a garment everything has."""
    right, swapped = two_layers(0.02, 0.0), two_layers(0.0, 0.02)
    assert drape_error(right, swapped).rms == pytest.approx(0.02)
    assert drape_error(right, swapped).rms_of_panel == pytest.approx({"front": 0.02, "back": 0.02})
    plain = [Drape.of_surface(d.positions, d.triangles) for d in (right, swapped)]
    assert drape_error(*plain).largest < 1e-15


def test_panels_add_up_by_area():
    error = drape_error(two_layers(0.02, 0.0), two_layers(0.02, -0.01))
    assert error.rms_of_panel == pytest.approx({"front": 0.0, "back": 0.01})
    assert error.rms == pytest.approx(0.01 / math.sqrt(2))


def test_motion_is_compared_time_by_time():
    def at(*heights: float) -> list[Drape]:
        return [Drape.of_surface(*level(0.1, 0.1, z)) for z in heights]

    errors, rms = motion_error(at(0, 0, 0), at(0.0, 0.003, 0.004))
    assert [e.rms for e in errors] == pytest.approx([0.0, 0.003, 0.004])
    assert rms == pytest.approx(0.005 / math.sqrt(3))
    with pytest.raises(ClothError, match="2 and 1 times"):
        motion_error(at(0, 0), at(0))


def test_what_has_no_surface_is_refused():
    sheet = Drape.of_surface(*level(0.1, 0.1))
    with pytest.raises(ClothError, match="without triangles"):
        drape_error(sheet, Drape.of_surface(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int32)))
    broken = sheet.positions.copy()
    broken[2, 1] = np.nan
    with pytest.raises(ClothError, match="not finite"):
        drape_error(Drape.of_surface(broken, sheet.triangles), sheet)
