"""New origins and travels of single particles: still nothing can meet, and nothing that could is left off the list.

Against all pairs with textbook formulas.
"""

import numpy as np
import pytest
import trimesh
from all_pairs import all_pairs, crumpled, free_ways
from apparatus import keep_within_travel, sheet
from naive_geometry import edge_edge_distance, point_triangle_distance

from cloth_core.body import Body
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.contact_state import ContactState
from cloth_core.mesh_topology import unique_edges
from cloth_core.near_planes import NEAR
from cloth_core.pair_contacts import CLOTH_VERTEX
from cloth_core.self_contact import SelfContact
from cloth_core.travel_renewal import pairs_of_particles, renew_spent

OFFSET = 0.001
NO_BODY = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32)
STEP = 1e-4


def renewable(found: ContactState) -> ContactState:
    wanted = found.renewal._replace(steps=30.0, least_reach=0.002, least_room=1e-4, allowed=True)
    return found._replace(renewal=wanted)


def some_go_far(rng: np.random.Generator, x: np.ndarray, found: ContactState, share: float) -> np.ndarray:
    """Most go less than half of their travel, some try to go farther than all of it."""
    part = np.where(rng.uniform(size=len(x)) < share, rng.uniform(0.7, 1.2, len(x)), rng.uniform(0.0, 0.3, len(x)))
    way = rng.normal(size=x.shape)
    return np.asarray(x + way * (part * found.travel / np.linalg.norm(way, axis=1))[:, None])


@pytest.mark.parametrize("seed", range(3))
def test_two_parts_of_cloth_together_may_never_travel_as_far_as_they_are_apart(seed):
    rng = np.random.default_rng(seed)
    garment = sheet(0.12, 0.12, 0.02)
    x = crumpled(garment, seed)
    identity = np.arange(garment.particle_count)
    search = SelfContact.of(garment, identity, garment.triangles, OFFSET, sewing=False)
    contact = Contact(garment.triangles, None, search, radius=0.006)
    found = renewable(contact.search(x, 0.002))
    renewals = 0
    for _ in range(80):
        x = some_go_far(rng, x, found, 0.02)
        moved = np.zeros(len(x))
        keep_within_travel(x, np.zeros_like(x), found, moved)
        before = found.origin.copy()
        if not renew_spent(x, np.zeros_like(x), found, *NO_BODY, moved, STEP):
            found = renewable(contact.search(x, 0.002))
            continue
        new = (found.origin != before).any(axis=0)
        renewals += int(new.sum())
        np.testing.assert_array_equal(found.origin.T[new], x[new])
        assert (moved[new] == 0.0).all()
        # Everybody is inside of its ball, none has used it up, and the balls of two parts do not come together.
        way = np.linalg.norm(x - found.origin.T, axis=1)
        assert (way <= 0.651 * found.travel).all()
        every = all_pairs(found.origin.T, garment.triangles, identity)
        together, distance = free_ways(found.origin.T, found.travel, every)
        broad_x = found.renewal.broad_x
        from_broad = np.linalg.norm(found.origin.T - broad_x, axis=1) + found.travel
        all_together, broad_distance = free_ways(broad_x, from_broad, all_pairs(broad_x, garment.triangles, identity))
        apart = distance > NEAR
        # Or they were so far apart at the broad phase that both can go nowhere near each other.
        assert ((together <= 0.95 * distance) | (all_together <= broad_distance - OFFSET))[apart].all()
        # What can come into contact is on the list, at a distance that it has at least.
        pairs, count = found.pairs, found.pairs.listed_count[0]
        listed = pairs.listed[:count]
        assert len(set(listed.tolist())) == count
        kind, rows = pairs.kind[listed], pairs.particles[listed]
        p = found.origin.T[rows].transpose(1, 0, 2)
        exact = np.sqrt(np.where(kind == CLOTH_VERTEX, point_triangle_distance(*p), edge_edge_distance(*p)))
        assert (pairs.listed_distance[:count] <= exact + 1e-9).all()
        keys = {key(k == CLOTH_VERTEX, row) for k, row in zip(kind, rows.tolist(), strict=True)}
        vertices = np.arange(len(distance)) < len(every.vertices)
        all_rows = np.concatenate([every.vertices, every.sides])
        for k in np.flatnonzero(distance - together < OFFSET):
            assert key(bool(vertices[k]), all_rows[k].tolist()) in keys
    assert renewals > 10


def key(vertex: bool, row: list[int]) -> tuple[object, ...]:
    if vertex:
        return (row[0], *sorted(row[1:]))
    return tuple(sorted([tuple(sorted(row[:2])), tuple(sorted(row[2:]))]))


def distances_to(
    body: Body, x: np.ndarray, travel: np.ndarray, triangles: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Of all vertices from all faces, faces from vertices and sides from sides: distances, and what each may travel."""
    edges, body_edges = unique_edges(triangles)[0], unique_edges(body.triangles)[0]
    corner, cloth_corner = body.vertices[body.triangles], x[triangles]
    far = [
        point_triangle_distance(x[:, None], *corner.transpose(1, 0, 2)),
        point_triangle_distance(body.vertices, *cloth_corner.transpose(1, 0, 2)[:, :, None]),
        edge_edge_distance(*x[edges].transpose(1, 0, 2)[:, :, None], *body.vertices[body_edges].transpose(1, 0, 2)),
    ]
    free = [travel, travel[triangles].max(axis=1), travel[edges].max(axis=1)]
    # Each pair for itself: what was far at the broad phase need not be the nearest one now.
    return [np.sqrt(d) for d in far], [np.broadcast_to(f[:, None], d.shape) for f, d in zip(free, far, strict=True)]


@pytest.mark.parametrize("seed", range(3))
def test_cloth_may_never_travel_as_far_as_it_is_from_a_body(seed):
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.06)
    body = Body.from_arrays(ball.vertices, ball.faces, "ball")
    garment = sheet(0.14, 0.14, 0.02)
    x = garment.start - garment.start.mean(axis=0)
    x = x[:, [0, 2, 1]] if np.ptp(x[:, 2]) > np.ptp(x[:, 1]) else x
    x = x + [0.0, 0.0, 0.064] + 0.001 * rng.uniform(-1.0, 1.0, x.shape)
    body_search = BodyContact(body, 0.003)
    contact, side_offset = Contact(garment.triangles, body_search, radius=0.02), body_search.side_offset
    found = renewable(contact.search(x, 0.01))
    renewals = 0
    for _ in range(25):
        x = some_go_far(rng, x, found, 0.05)
        moved = np.zeros(len(x))
        keep_within_travel(x, np.zeros_like(x), found, moved)
        before = found.origin.copy()
        if not renew_spent(x, np.zeros_like(x), found, body.vertices, body.triangles, moved, STEP):
            found = renewable(contact.search(x, 0.01))
            continue
        renewals += int((found.origin != before).any(axis=0).sum())
        broad_x = found.renewal.broad_x
        from_broad = np.linalg.norm(found.origin.T - broad_x, axis=1) + found.travel
        here = zip(*distances_to(body, found.origin.T, found.travel, garment.triangles), strict=True)
        there = zip(*distances_to(body, broad_x, from_broad, garment.triangles), strict=True)
        for (nearest, free), (broad_distance, all_the_way) in zip(here, there, strict=True):
            enough = (free <= 0.901 * nearest) | (all_the_way <= broad_distance - side_offset)
            assert enough[nearest > NEAR].all()
    assert renewals > 15


def test_too_many_at_once_ask_for_a_search():
    garment = sheet(0.16, 0.16, 0.02)
    x = crumpled(garment, 1)
    search = SelfContact.of(garment, np.arange(len(x)), garment.triangles, OFFSET, sewing=False)
    found = renewable(Contact(garment.triangles, None, search).search(x, 0.002))
    moved = found.travel**2
    assert not renew_spent(x, np.zeros_like(x), found, *NO_BODY, moved, STEP)
    # Some may have been renewed before it gave up: nobody may go on as if nothing had been used up.
    assert np.isinf(moved).all()
    moved = found.travel**2
    not_allowed = found._replace(renewal=found.renewal._replace(allowed=False))
    moved[1:] = 0.0
    assert not renew_spent(x, np.zeros_like(x), not_allowed, *NO_BODY, moved, STEP)


def test_a_particle_that_is_too_fast_for_what_it_gets_asks_for_a_search():
    # The search shortens the step until nothing is stopped at the end of its travel.
    garment = sheet(0.16, 0.16, 0.02)
    x = garment.start.copy()
    search = SelfContact.of(garment, np.arange(len(x)), garment.triangles, OFFSET, sewing=False)
    for speed, enough in ((1.0, True), (200.0, False)):
        found = renewable(Contact(garment.triangles, None, search).search(x, 0.002))
        v, moved = np.zeros_like(x), np.zeros(len(x))
        v[5], moved[5] = [speed, 0.0, 0.0], found.travel[5] ** 2
        assert renew_spent(x, v, found, *NO_BODY, moved, STEP) == enough


def test_pairs_of_each_particle_are_those_that_name_it():
    rng = np.random.default_rng(3)
    particles = rng.integers(-1, 12, (40, 4)).astype(np.int32)
    start, entries = pairs_of_particles(particles, 12)
    for i in range(12):
        named = [s for s, row in enumerate(particles.tolist()) for p in row if p == i]
        assert entries[start[i] : start[i + 1]].tolist() == named
