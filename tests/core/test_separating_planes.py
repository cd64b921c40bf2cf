"""Planes between triangles of the cloth and a body: what they claim, against distances by textbook formulas."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, placed, plain_fabric, sheet
from naive_geometry import edge_edge_distance, point_triangle_distance
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cloth_core.body import Body
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.garment import Garment
from cloth_core.mesh_topology import unique_edges
from cloth_core.near_planes import NEAR
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.separating_planes import SeparatingPlanes, given_up, triangles_of_particles
from cloth_core.simulation import Simulation

Floats = NDArray[np.float64]

OFFSET = 0.003


def distance_to_body(corners: Floats, body: Body) -> Floats:
    """Of a triangle, (3, 3) [m], from each of the body's, (t,)."""
    p = body.vertices[body.triangles].transpose(1, 0, 2)
    far = []
    for k in range(3):
        far += [point_triangle_distance(corners[k], *p), point_triangle_distance(p[k], *corners)]
        far += [edge_edge_distance(corners[k], corners[k - 1], p[m], p[m - 1]) for m in range(3)]
    return np.sqrt(np.min(far, axis=0))


def certainly_apart(planes: SeparatingPlanes, body: Body, place: Floats, radii: Floats) -> None:
    """Nothing of the body that a triangle could reach within the radii of its corners is above its plane."""
    assert planes.separated.any()
    for t in np.flatnonzero(planes.separated):
        corners = planes.corners[t]
        height = body.vertices @ planes.normal[t] - planes.level[t]
        above = height[body.triangles].max(axis=1) > 1e-12
        far = distance_to_body(place[corners], body)
        assert (far[above] > radii[corners].max()).all()


def over_a_ball(seed: int, radius: float = 0.104) -> tuple[Garment, Body, Floats]:
    rng = np.random.default_rng(seed)
    body = body_of(trimesh.creation.icosphere(2, radius=0.1), Rotation.random(random_state=seed).as_matrix())
    garment = sheet(0.12, 0.12, 0.02)
    x = garment.start - garment.start.mean(axis=0)
    height = np.sqrt(radius**2 - (x[:, :2] ** 2).sum(axis=1))
    return garment, body, np.column_stack([x[:, :2], height]) + 2e-4 * rng.standard_normal(x.shape)


@pytest.mark.parametrize("seed", range(3))
def test_all_that_is_near_lies_below_the_plane_and_the_corners_above(seed):
    garment, body, x = over_a_ball(seed)
    contact = Contact(garment.triangles, BodyContact(body, OFFSET), radius=0.006)
    found = contact.search(x, 0.004)
    planes = found.separating
    assert planes.separated.mean() > 0.5
    np.testing.assert_allclose(np.linalg.norm(planes.normal[planes.separated], axis=1), 1.0, rtol=1e-12)
    certainly_apart(planes, body, x, contact.broad.radii)
    for t in np.flatnonzero(planes.separated):
        corners = garment.triangles[t]
        height = x[corners] @ planes.normal[t] - planes.level[t]
        assert (height >= planes.high - 1e-12).all()
        # Sides of what has a plane never come to where they count.
        assert (height - found.travel[corners] >= planes.lowest - 1e-12).all()


@pytest.mark.parametrize("seed", range(3))
def test_what_has_no_plane_has_all_the_pairs_that_there_are(seed):
    # Sides of cloth near sides of the body: all but those of separated triangles.
    garment, body, x = over_a_ball(seed, radius=0.1025)
    body_search = BodyContact(body, OFFSET)
    found = Contact(garment.triangles, body_search, radius=0.006).search(x, 0.004)
    listed = {tuple(row) for row in np.column_stack([found.pairs.particles, found.pairs.body]).tolist()}
    apart = garment.triangles[found.separating.separated]
    of_apart = {tuple(side) for side in unique_edges(apart)[0].tolist()}
    reach = body_search.side_offset + 0.002  # every particle may go at least so far
    sides = [tuple(side) for side in unique_edges(garment.triangles)[0].tolist()]
    expected = 0
    body_sides = unique_edges(body.triangles)[0]
    for i, j in sides:
        if (i, j) not in of_apart:
            far = edge_edge_distance(x[i], x[j], *body.vertices[body_sides].transpose(1, 0, 2))
            for a, b in body_sides[far < reach**2].tolist():
                assert (i, j, -1, -1, a, b) in listed
                expected += 1
    assert expected > 0


def test_a_triangle_that_comes_low_gets_another_plane_or_its_pairs():
    garment, body, x = over_a_ball(0)
    contact = Contact(garment.triangles, BodyContact(body, OFFSET), radius=0.015)
    found = contact.search(x, 0.002)
    planes, before = found.separating, found.separating.separated.copy()
    searches = contact.broad.searches
    # Round the ball and a little nearer: too low above the old planes, but not above others.
    turned = 0.985 * x @ Rotation.from_euler("x", 5.0, degrees=True).as_matrix().T
    old = planes.normal.copy()
    found = contact.search(turned, 1e-4)
    assert contact.broad.searches == searches
    renewed = before & planes.separated & (planes.normal != old).any(axis=1)
    assert renewed.sum() > 20
    certainly_apart(planes, body, contact.broad.x, contact.broad.radii)
    # Towards the ball there is no plane any more: each triangle gets its pairs, as if it had never had one.
    pressed = turned * 0.97 / 0.985
    lost = before & planes.separated
    found = contact.search(pressed, 1e-4)
    lost &= ~planes.separated
    assert contact.broad.searches == searches
    assert lost.any()
    named = {tuple(sorted(p for p in row if p >= 0)) for row in found.pairs.particles.tolist()}
    for t in np.flatnonzero(lost):
        sides = [tuple(sorted(side)) for side in np.stack([garment.triangles[t], np.roll(garment.triangles[t], 1)], 1)]
        assert named & set(sides)
    body_sides = body.vertices[unique_edges(body.triangles)[0]].transpose(1, 0, 2)
    sides_of_lost = unique_edges(garment.triangles[lost])[0].tolist()
    nearest = np.sqrt([edge_edge_distance(pressed[i], pressed[j], *body_sides).min() for i, j in sides_of_lost])
    free = found.travel[unique_edges(garment.triangles[lost])[0]].max(axis=1)
    assert (free < nearest)[nearest > NEAR].all()


def test_no_plane_fits_where_the_body_reaches_round_the_cloth():
    # A sheet that lies in the opening of a bowl: the bowl's rim is above it.
    bowl = trimesh.creation.icosphere(3, radius=0.1)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.03)
    garment = sheet(0.04, 0.04, 0.02)
    x = garment.start - garment.start.mean(axis=0) + [0.0, 0.0, -0.094]
    body = Body.from_arrays(bowl.vertices, bowl.faces, "bowl")
    found = Contact(garment.triangles, BodyContact(body, OFFSET), radius=0.1).search(x, 0.09)
    assert not found.separating.separated.any()
    assert len(found.pairs.kind) > 0


def test_while_a_body_moves_nothing_relies_on_a_plane():
    garment, body, x = over_a_ball(1)
    search = BodyContact(body, OFFSET)
    search.moves = True
    found = Contact(garment.triangles, search, radius=0.006).search(x, 0.004)
    assert not found.separating.separated.any()
    assert len(found.pairs.kind) > 100


def test_planes_come_and_go_with_the_motion_of_a_body():
    ball = trimesh.creation.icosphere(2, radius=0.1)
    scene = Scene(
        garment=placed(sheet(0.2, 0.2, 0.02), move=[0.0, 0.0, 0.105]), body=body_of(ball), fabric=plain_fabric(),
        settings=Settings(contact_offset=OFFSET),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.advance(0.1)
    assert simulation._contacts.separating.separated.any()
    simulation.move_body(body_of(ball).vertices + np.array([0.0, 0.0, 0.02]), 0.05)
    while simulation.body_moves:
        simulation.advance(0.01)
        if simulation.body_moves:
            assert not simulation._contacts.separating.separated.any()
        x, triangles = simulation.sewn_mesh()
        assert crossings(x, triangles, simulation.scene.body) == 0
    simulation.advance(0.05)
    assert simulation._contacts.separating.separated.any()
    x, triangles = simulation.sewn_mesh()
    assert crossings(x, triangles, simulation.scene.body) == 0


@pytest.mark.parametrize("coarseness", [0, 1, 2, 3])
@pytest.mark.parametrize("speed", [0.5, 5.0])
def test_nothing_passes_through_a_ball_of_any_coarseness(coarseness, speed):
    # From an icosahedron, on whose edges sides of the cloth have to be held, to a ball on which they need not.
    body = body_of(trimesh.creation.icosphere(coarseness, radius=0.1))
    garment = placed(
        sheet(0.3, 0.3, 0.03), Rotation.from_euler("xy", [7.0, 11.0], degrees=True).as_matrix(), [0, 0, 0.15]
    )
    scene = Scene(
        garment=garment, body=body, fabric=plain_fabric(), settings=Settings(contact_offset=OFFSET),
        without=("self contact",),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation._v[:, 2] = -speed
    simulation._search_contacts()
    separated = False
    for _ in range(30):
        simulation.advance(0.01)
        x, triangles = simulation.sewn_mesh()
        assert crossings(x, triangles, body) == 0
        separated |= bool(simulation._contacts.separating.separated.any())
    assert separated or coarseness == 0


def test_triangles_of_a_particle_are_those_that_name_it():
    triangles = sheet(0.1, 0.1, 0.02).triangles
    start, entries = triangles_of_particles(triangles, int(triangles.max()) + 1)
    for i in range(len(start) - 1):
        assert sorted(entries[start[i] : start[i + 1]]) == np.flatnonzero((triangles == i).any(axis=1)).tolist()


def test_nothing_is_given_up_while_all_is_high():
    garment, body, x = over_a_ball(2)
    contact = Contact(garment.triangles, BodyContact(body, OFFSET), radius=0.006)
    planes = contact.search(x, 0.004).separating
    before = planes.separated.copy()
    away = x * 1.005
    assert len(given_up(away, np.full(len(x), 0.001), planes, body.vertices, body.triangles)) == 0
    np.testing.assert_array_equal(planes.separated, before)
