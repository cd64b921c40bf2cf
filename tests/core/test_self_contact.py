"""The search for contacts of cloth with itself: which pairs it finds and leaves out, and how far particles may travel.

Against all pairs with textbook formulas.
"""

import naive_geometry
import numpy as np
import pytest
from all_pairs import AllPairs, all_pairs, crumpled, free_ways
from apparatus import keep_within_travel, pattern, plain_fabric, rectangle, sheet

from cloth_core.contact import Contact
from cloth_core.garment import Garment
from cloth_core.model import Model
from cloth_core.near_planes import NEAR
from cloth_core.pair_contacts import CLOTH_SIDE, CLOTH_VERTEX
from cloth_core.scene import Scene
from cloth_core.seam_gaps import seam_gap_triangles
from cloth_core.self_contact import SelfContact

OFFSET = 0.001


def vertex_key(rows: np.ndarray) -> set[tuple[int, ...]]:
    return {(p, *sorted(t)) for p, *t in rows.tolist()}


def side_key(rows: np.ndarray) -> set[tuple[tuple[int, int], ...]]:
    return {tuple(sorted([tuple(sorted(r[:2])), tuple(sorted(r[2:]))])) for r in rows.tolist()}


def search_of(garment: Garment) -> SelfContact:
    return SelfContact.of(garment, np.arange(garment.particle_count), garment.triangles, OFFSET, sewing=False)


# ---- which pairs


@pytest.mark.parametrize("radius", [0.001, 0.006, 0.03])
@pytest.mark.parametrize("seed", range(3))
def test_search_finds_all_pairs_within_reach_and_no_others(seed, radius):
    garment = sheet(0.16, 0.16, 0.02)
    x = crumpled(garment, seed)
    rows, _, distance = search_of(garment).candidates(x, radius)
    expected = all_pairs(x, garment.triangles, garment.merged_indices)
    reach = OFFSET + 2.0 * radius
    for kind, key, every, far in (
        (CLOTH_VERTEX, vertex_key, expected.vertices, expected.vertex_distance),
        (CLOTH_SIDE, side_key, expected.sides, expected.side_distance),
    ):
        of_kind = rows[:, 0] == kind
        found = rows[of_kind, 1:5]
        near = key(every[far < reach * (1 - 1e-9)])
        assert len(near) > 20
        assert near <= key(found)
        assert key(found) <= key(every[far < reach * (1 + 1e-9)])
        assert len(key(found)) == len(found)  # each once
    p = x[rows[:, 1:5]].transpose(1, 0, 2)
    exact = np.where(
        rows[:, 0] == CLOTH_VERTEX, naive_geometry.point_triangle_distance(*p), naive_geometry.edge_edge_distance(*p)
    )
    np.testing.assert_allclose(distance, np.sqrt(exact), atol=1e-9)
    assert (rows[:, 5:] == -1).all()


TUBE = {
    "front": rectangle(0.2, 0.15, at=(0, 0.5, 0.03)),
    "back": rectangle(0.2, 0.15, at=(0, 0.5, -0.03), turned=(0, 180, 0)),
}
SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


@pytest.mark.parametrize("stitches", [[], SIDES], ids=["loose", "sewn"])
@pytest.mark.parametrize("closed", [False, True], ids=["open", "merged"])
def test_left_out_is_what_has_a_corner_in_common(stitches, closed):
    # With a reach beyond the whole garment only the topology decides. A seam that has been given up is a gap like any
    # other: its edges are kept apart.
    garment = Garment.from_pattern(pattern(TUBE, stitches), 0.05)
    model = Model(Scene(garment=garment, fabric=plain_fabric()), closed=garment.seams if closed else ())
    assert model.contact is not None
    assert model.contact.cloth is not None
    x = model.gather(garment.start, garment.particle_areas)
    rows, _, _ = model.contact.cloth.candidates(x, 10.0)
    expected = all_pairs(x, model.triangles, np.arange(model.particle_count))
    assert vertex_key(rows[rows[:, 0] == CLOTH_VERTEX, 1:5]) == vertex_key(expected.vertices)
    assert side_key(rows[rows[:, 0] == CLOTH_SIDE, 1:5]) == side_key(expected.sides)


def test_gaps_of_open_seams_count_as_cloth_while_they_are_sewn(monkeypatch):
    monkeypatch.setattr("cloth_core.self_contact._MET", 0.05)
    garment = Garment.from_pattern(pattern(TUBE, SIDES), 0.05)
    model = Model(Scene(garment=garment, fabric=plain_fabric()), sewing=True)
    assert model.contact is not None
    assert model.contact.cloth is not None
    with_gaps = model.contact.cloth.triangles
    cloth = len(garment.triangles)
    np.testing.assert_array_equal(with_gaps[:cloth], model.triangles)
    gaps = garment.start[with_gaps[cloth:]]
    # Two walls of 6 x 15 cm close the tube at x = -10 and 10 cm: they are tiled without a hole or overlap.
    area = 0.5 * np.linalg.norm(np.cross(gaps[:, 1] - gaps[:, 0], gaps[:, 2] - gaps[:, 0]), axis=1)
    for side in (-0.1, 0.1):
        wall = (np.abs(gaps[:, :, 0] - side) < 1e-9).all(axis=1)
        assert area[wall].sum() == pytest.approx(0.06 * 0.15)
        middle = gaps[wall].mean(axis=1)
        np.testing.assert_allclose(middle[:, 2].mean(), 0.5, atol=1e-9)
    assert area.sum() == pytest.approx(2 * 0.06 * 0.15)
    # And pairs with them are found by the same rule, while nothing has met.
    rows, _, _ = model.contact.cloth.candidates(garment.start, 10.0)
    expected = all_pairs(garment.start, with_gaps, np.arange(garment.particle_count))
    assert vertex_key(rows[rows[:, 0] == CLOTH_VERTEX, 1:5]) == vertex_key(expected.vertices)
    assert side_key(rows[rows[:, 0] == CLOTH_SIDE, 1:5]) == side_key(expected.sides)


def test_points_of_a_seam_count_as_one_once_they_have_met(monkeypatch):
    monkeypatch.setattr("cloth_core.self_contact._MET", 3.0 * OFFSET)
    garment = Garment.from_pattern(pattern(TUBE, SIDES), 0.05)
    model = Model(Scene(garment=garment, fabric=plain_fabric()), sewing=True)
    assert model.contact is not None
    search = model.contact.cloth
    assert search is not None
    seam = garment.seams[0]
    x = garment.start.copy()
    for k, gap in enumerate((0.5 * OFFSET, 2.5 * OFFSET, 4.0 * OFFSET)):
        x[seam.second[k]] = x[seam.first[k]] + [0.0, gap, 0.0]
    np.testing.assert_array_equal(search.one_point(garment.start), np.arange(len(x)))
    rows, _, _ = search.candidates(x, 10.0)
    number = search.one_point(x)
    one = number[seam.first] == number[seam.second]
    np.testing.assert_array_equal(one[:3], [True, True, False])
    assert not one[3:].any()
    # Only what has met is left out, and it stays so when the points go apart again.
    for places in (x, garment.start):
        rows, _, _ = search.candidates(places, 10.0)
        found = vertex_key(rows[rows[:, 0] == CLOTH_VERTEX, 1:5])
        merged = np.arange(len(x))
        merged[seam.second[:2]] = seam.first[:2]
        cloth = all_pairs(places, model.triangles, merged)
        expected = vertex_key(cloth.vertices)
        assert {row for row in found if set(row[1:]) in [set(t) for t in model.triangles.tolist()]} == expected


def test_gaps_that_cloth_crosses_wait_until_it_is_gone():
    # A third panel stands across the left side of the tube, then is taken away.
    wall = rectangle(0.1, 0.4, at=(-0.1, 0.5, 0.0))
    garment = Garment.from_pattern(pattern(TUBE | {"wall": wall}, SIDES), 0.05)
    model = Model(Scene(garment=garment, fabric=plain_fabric()), sewing=True)
    assert model.contact is not None
    search = model.contact.cloth
    assert search is not None
    cloth, gaps = len(model.triangles), len(seam_gap_triangles(garment.seams))
    kept = search.triangles[cloth:]
    assert len(kept) == gaps // 2
    assert (garment.start[kept][:, :, 0] > 0.0).all()
    x = garment.start.copy()
    for _ in range(30):
        search.candidates(x, 0.01)
    assert len(search.triangles) == cloth + gaps // 2
    x[garment.panel_of_particle == 2] -= [1.0, 0.0, 0.0]
    for _ in range(30):
        search.candidates(x, 0.01)
    assert len(search.triangles) == cloth + gaps
    # From then on they stay, whatever comes there, unless their seam comes no nearer.
    for may_leave, left in ((False, gaps), (True, gaps // 2)):
        search.gaps_may_leave = may_leave
        for _ in range(30):
            search.candidates(garment.start, 0.01)
        assert len(search.triangles) == cloth + left


def test_offset_is_less_only_where_parts_are_neighbours():
    # A triangle of the lattice is 2 cm / sqrt(2) high: neighbours rest farther apart than any offset here. With an
    # offset that they have no room for they get less, and nobody else does.
    garment = sheet(0.1, 0.1, 0.02)
    search = SelfContact.of(garment, np.arange(garment.particle_count), garment.triangles, 0.01, sewing=False)
    rows, offset, _ = search.candidates(garment.start, 10.0)
    sides = np.concatenate([garment.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    joined = np.zeros((garment.particle_count,) * 2, dtype=bool)
    joined[sides[:, 0], sides[:, 1]] = joined[sides[:, 1], sides[:, 0]] = True
    p, q, a, b = rows[:, 1:5].T
    vertex = rows[:, 0] == CLOTH_VERTEX
    near = np.where(
        vertex, joined[p, q] | joined[p, a] | joined[p, b], joined[p, a] | joined[p, b] | joined[q, a] | joined[q, b]
    )
    height = 0.02 / np.sqrt(2)
    np.testing.assert_allclose(offset[near], 0.3 * height)
    np.testing.assert_allclose(offset[~near], 0.01)
    # Nothing is held farther apart than it lies at rest.
    _, _, distance = search.candidates(garment.start, 10.0)
    assert (offset[near] < distance[near]).all()


# ---- how far particles may travel


def touching(every: AllPairs) -> np.ndarray:
    """Particles of pairs that nearly touch."""
    return np.concatenate(
        [every.vertices[every.vertex_distance <= NEAR], every.sides[every.side_distance <= NEAR]]
    ).ravel()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("uneven", [False, True], ids=["same reach", "each its own"])
def test_two_parts_together_may_never_travel_as_far_as_they_are_apart(seed, uneven):
    # What makes tunnelling impossible; also after moves in which the pairs of an earlier search are used again.
    rng = np.random.default_rng(seed)
    garment = sheet(0.16, 0.16, 0.02)
    x = crumpled(garment, seed)
    contact = Contact(garment.triangles, None, search_of(garment), radius=0.006)
    for _ in range(36):
        reach = 0.006 * (rng.uniform(size=len(x)) if uneven else 1.0)
        found = contact.search(x, reach)
        travel = found.travel
        every = all_pairs(x, garment.triangles, garment.merged_indices)
        together, distance = free_ways(x, travel, every)
        # What nearly touches is bounded in direction instead: see test_pinched.py.
        apart = distance > NEAR
        assert (together[apart] <= 0.95 * distance[apart]).all()
        # What has nothing near it may use up its whole radius.
        alone = ~np.isin(np.arange(len(x)), found.pairs.particles)
        assert (travel <= np.where(alone, found.renewal.radii, reach)).all()
        if not uneven:
            # No particle goes half as far as to anything, and it may go nearly so far, up to a millimetre at least.
            free = np.full(len(x), np.inf)
            for rows, far in ((every.vertices, every.vertex_distance), (every.sides, every.side_distance)):
                np.minimum.at(free, rows[far > NEAR].ravel(), np.repeat(far[far > NEAR], 4))
            assert (travel <= 0.45 * free + 1e-12).all()
            assert (travel >= np.minimum(0.44 * free, 0.999e-3))[~np.isin(np.arange(len(x)), touching(every))].all()
        way = rng.normal(size=x.shape)
        way *= (travel * rng.uniform(0.5, 1.2, len(x)) / np.linalg.norm(way, axis=1))[:, None]
        x = x + way
        keep_within_travel(x, np.zeros_like(x), found, np.zeros(len(x)))
        assert (np.linalg.norm(x - found.origin.T, axis=1) <= travel * (1 + 1e-12)).all()
    assert contact.narrow_phases == 36
    assert 1 < contact.broad.searches < 36
