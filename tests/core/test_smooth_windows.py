"""Smooth parts of cloth are left out of the search for self contact, and nothing meets there all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from apparatus import panel, pattern, placed, rectangle, sheet, throw

from cloth_core.aabb_tree import build_tree
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_edges
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.smooth_windows import (
    FOLDED,
    FOLDING,
    SMOOTH,
    SmoothWindows,
    common_window,
    node_windows,
    smoothness,
)

SPACING = 0.01
RANDOM = np.random.default_rng(7)


def bent(rest: np.ndarray, radius: float) -> np.ndarray:
    """The plane rolled up on a cylinder: an isometry; the angle at x is x / radius."""
    x, y = rest[:, 0], rest[:, 1]
    return np.column_stack([radius * np.sin(x / radius), y, radius * (1.0 - np.cos(x / radius))])


def stirred(rest: np.ndarray, seed: int) -> np.ndarray:
    """Waves along several directions, sheared and stretched a little."""
    rng = np.random.default_rng(seed)
    x = np.column_stack([rest @ np.array([[1.0, 0.2], [-0.1, 0.95]]), np.zeros(len(rest))])
    for _ in range(6):
        wave, phase = rng.normal(size=2) * 25.0, rng.uniform(0, 6)
        x += np.sin(rest @ wave + phase)[:, None] * rng.normal(size=3) * 0.003
    return np.asarray(x @ np.linalg.qr(rng.normal(size=(3, 3)))[0])


def points_in(
    garment: Garment, triangles: np.ndarray, x: np.ndarray, count: int = 400
) -> tuple[np.ndarray, np.ndarray]:
    """Random points of some triangles, in the panel and in space."""
    chosen = RANDOM.choice(triangles, count)
    weight = RANDOM.dirichlet(np.ones(3), count)
    corners = garment.triangles[chosen]
    return (
        np.einsum("ck,cka->ca", weight, garment.rest[corners]),
        np.einsum("ck,cka->ca", weight, x[corners]),
    )


def owned(garment: Garment, window: int) -> np.ndarray:
    return np.flatnonzero((garment.windows.of_triangle == window).any(axis=(0, 2)))


@pytest.mark.parametrize("seed", range(4))
def test_points_of_a_window_are_no_nearer_than_its_m_says(seed):
    # The bound of the theorem against distances of random points, and against closest ones of neighbouring particles.
    garment = sheet(0.3, 0.25, SPACING)
    x = stirred(garment.rest, seed)
    windows = garment.windows
    count = len(windows.height)
    everything = np.ones(count, dtype=bool)
    certified = 0
    for m in (0.3, 0.5, 0.7, 0.9):
        for window in np.flatnonzero(smoothness(x, garment.triangles, windows, np.full(count, m), everything)):
            certified += 1
            flat, space = points_in(garment, owned(garment, window), x)
            apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)
            assert (np.linalg.norm(space[:, None] - space[None], axis=2) >= (m - 1e-9) * apart).all()
    assert certified > 20


def test_m_of_a_cylinder_is_the_cosine_of_half_its_arc():
    garment = sheet(0.3, 0.25, SPACING)
    windows = garment.windows
    count = len(windows.height)
    for radius in (0.06, 0.1, 0.2):
        x = bent(garment.rest, radius)
        for window in range(count):
            cover = windows.cover[windows.start[window] : windows.start[window + 1]]
            middle = garment.rest[garment.triangles[cover]].mean(axis=1)[:, 0]
            half = 0.5 * np.ptp(middle) / radius
            if half > 0.5 * np.pi:
                continue
            alone = np.arange(count) == window
            expected = np.cos(half)
            # The covering triangles lie not quite evenly about the middle.
            for m, fits in ((expected - 0.08, True), (expected + 0.08, False)):
                assert smoothness(x, garment.triangles, windows, np.full(count, m), alone)[window] == fits


def notched(depth: float) -> Garment:
    """A square with a notch in its upper side."""
    vertices = [(0.0, 0.0), (0.4, 0.0), (0.4, 0.4), (0.21, 0.4), (0.2, 0.4 - depth), (0.19, 0.4), (0.0, 0.4)]
    return Garment.from_pattern(pattern({"front": panel(vertices)}), SPACING)


def test_windows_with_a_notch_in_them_are_left_to_the_search():
    # Both sides of a notch can pass over each other while all around is flat.
    garment = notched(0.2)
    windows = garment.windows
    top = garment.rest[:, 1].max()
    middle = 0.5 * (garment.rest[:, 0].min() + garment.rest[:, 0].max())
    notch = shapely.Polygon([(middle - 0.01, top), (middle, top - 0.2), (middle + 0.01, top)])
    for window in range(len(windows.height)):
        corners = garment.rest[garment.triangles[owned(garment, window)]].reshape(-1, 2)
        assert shapely.MultiPoint(corners).convex_hull.intersection(notch).area < 1e-9
    assert 0 < len(windows.height) < len(sheet(0.4, 0.4, SPACING).windows.height)


@pytest.mark.parametrize("name", ["rectangle", "tshirt", "trousers"])
def test_hulls_of_windows_are_covered_by_the_cloth(name):
    garment = Garment.from_pattern(Pattern.load(name), 0.02)
    windows = garment.windows
    assert len(windows.height) > 10
    for window in RANDOM.choice(len(windows.height), 40):
        corners = garment.rest[garment.triangles[owned(garment, window)]].reshape(-1, 2)
        cover = windows.cover[windows.start[window] : windows.start[window + 1]]
        assert len(np.unique(garment.panel_of_triangle[cover])) == 1
        cloth = shapely.union_all(shapely.polygons(garment.rest[garment.triangles[cover]]))
        assert shapely.MultiPoint(corners).convex_hull.difference(cloth).area < 1e-8


def test_larger_windows_hold_the_smaller_ones():
    garment = Garment.from_pattern(Pattern.load("tshirt"), 0.015)
    windows = garment.windows
    assert (windows.parent >= 0).sum() > 20
    for window in np.flatnonzero(windows.parent >= 0):
        inside, outside = owned(garment, window), owned(garment, int(windows.parent[window]))
        assert np.isin(inside, outside).all()


def test_neighbouring_tiles_share_a_window():
    garment = sheet(0.31, 0.27, SPACING)  # a rectangle: every window is convex
    finest = garment.windows.of_triangle[-1]
    centre = garment.rest[garment.triangles].mean(axis=1)
    side = garment.windows.side[-1]
    one, other = RANDOM.integers(0, len(centre), (2, 20000))
    near = (np.abs(centre[one] - centre[other]) < side).all(axis=1)
    shared = (finest[one[near]][:, :, None] == finest[other[near]][:, None]) & (finest[one[near]] >= 0)[:, :, None]
    assert near.sum() > 1000
    assert shared.any(axis=(1, 2)).all()


def test_nodes_have_the_windows_that_all_below_them_have():
    garment = sheet(0.3, 0.25, 0.02)
    windows, triangles = garment.windows, garment.triangles
    tree = build_tree(garment.start, triangles)
    smooth = RANDOM.random(len(windows.height)) < 0.6
    common = node_windows(tree, windows.of_triangle, smooth)

    def below(node: int) -> set[int]:
        if tree.triangle[node] >= 0:
            return {int(tree.triangle[node])}
        return below(node + 1) | below(int(tree.right[node]))

    for node in range(len(tree.right)):
        of_all = set.intersection(*({int(w) for w in windows.of_triangle[:, t].ravel() if w >= 0} for t in below(node)))
        listed = {int(w) for w in common[node] if w >= 0}
        assert listed <= {w for w in of_all if smooth[w]}
        if tree.triangle[node] >= 0 and len({w for w in of_all if smooth[w]}) <= 8:
            assert listed == {w for w in of_all if smooth[w]}
    for i, j in RANDOM.integers(0, len(common), (500, 2)):
        assert common_window(common, i, j) == bool(({*common[i]} & {*common[j]}) - {-1})


def test_what_folds_is_noticed_and_searched_again():
    garment = sheet(0.3, 0.25, SPACING)
    smooth = SmoothWindows(garment.windows, 0.001)
    flat = bent(garment.rest, 100.0)
    smooth.look(flat, garment.triangles)
    assert smooth.smooth.any()
    assert (smooth.room(garment.triangles, len(flat)) > 0.0).all()
    assert smooth.state(flat, garment.triangles) == SMOOTH
    states = [smooth.state(bent(garment.rest, radius), garment.triangles) for radius in (1.0, 0.3, 0.125, 0.06, 0.03)]
    assert states == sorted(states)
    assert FOLDING in states
    assert states[-1] == FOLDED
    smooth.look(flat, garment.triangles)  # what folded so fast is not trusted at once
    assert not smooth.smooth.all()
    rolled = bent(garment.rest, 0.02)
    smooth.look(rolled, garment.triangles)
    assert not smooth.smooth.any()
    assert (smooth.room(garment.triangles, len(rolled)) == 0.0).all()


# ---- in a run


def folding_sheet(speed: float) -> Simulation:
    """A weightless sheet whose right half is thrown over its left one, which is held."""
    garment = placed(sheet(0.4, 0.2, 0.02))
    held = np.flatnonzero(garment.start[:, 0] < 0.01).astype(np.int32)
    fabric = Fabric.preset("silk")
    simulation = Simulation(Scene(garment=garment, fabric=fabric, pins=held, gravity=(0.0, 0.0, 0.0), air_drag=0.0))
    u = simulation.positions[:, 0] / 0.2
    throw(simulation, np.column_stack([-speed * np.maximum(u, 0.0), np.zeros(len(u)), speed * np.maximum(u, 0.0)]))
    return simulation


@pytest.mark.parametrize("speed", [2.0, 20.0])
def test_sheet_that_is_folded_over_itself_never_crosses(speed):
    simulation = folding_sheet(speed)
    contact = simulation.model.contact
    assert contact is not None
    assert contact.cloth is not None
    assert contact.cloth.smooth is not None
    assert len(contact.broad.pairs.kind) == 0  # flat: nothing to search
    most = 0
    while simulation.time < 0.6 / speed:
        simulation.tick()
        x, triangles = simulation.sewn_mesh()
        assert len(self_crossing_edges(x, triangles)) == 0
        most = max(most, len(contact.broad.pairs.kind))
    assert most > 0
    assert not contact.cloth.smooth.smooth.all()


def test_steps_in_which_it_folded_too_far_are_done_again(monkeypatch):
    # Verdicts FOLDED and FOLDING, given when they are not due, only cost searches: the sheet comes to the same place.
    garment = placed(sheet(0.4, 0.2, 0.02))
    scene = Scene(garment=garment, fabric=Fabric.preset("cotton_poplin"), pins=np.array([0], dtype=np.int32))
    runs = [Simulation(scene), Simulation(scene)]
    runs[0].advance(0.2)
    state, calls = SmoothWindows.state, []

    def doubtful(self, x, triangles):
        calls.append(0)
        verdict = state(self, x, triangles)
        return (FOLDED, FOLDING, verdict)[len(calls) % 3]

    monkeypatch.setattr(SmoothWindows, "state", doubtful)
    runs[1].advance(0.2)
    assert len(calls) > 10
    assert runs[1].time == pytest.approx(runs[0].time, abs=1e-12)
    np.testing.assert_allclose(runs[1].positions, runs[0].positions, atol=1e-4)
    assert self_crossing_edges(*runs[1].sewn_mesh()).size == 0


def test_sheet_that_swings_without_folding_does_the_same_without_self_contact():
    garment = placed(sheet(0.3, 0.3, 0.02))
    corners = np.flatnonzero((garment.rest == garment.rest.max(axis=0)).any(axis=1) & (garment.rest[:, 1] > 0.14))
    scene = Scene(garment=garment, fabric=Fabric.preset("denim"), pins=corners.astype(np.int32))
    searched, free = Simulation(scene), Simulation(replace(scene, without=("self contact",)))
    for simulation in (searched, free):
        simulation.advance(0.3)
    assert searched.model.contact is not None
    assert len(searched.model.contact.broad.pairs.kind) < 10
    assert searched.model.contact.broad.searches < 40
    np.testing.assert_allclose(searched.positions, free.positions, atol=1e-3)


def test_what_is_left_out_is_told():
    garment = placed(sheet(0.3, 0.25, 0.02))
    simulation = Simulation(Scene(garment=garment, fabric=Fabric.preset("denim")))
    facts = simulation.describe()["terms"]["self contact"]
    assert facts["active"]
    assert f"{len(garment.triangles)} triangles are too smooth now" in facts["reason"]
    assert "too smooth" not in Simulation(replace(simulation.scene, without=("self contact",))).describe()["terms"][
        "self contact"
    ]["reason"]  # fmt: skip


def test_two_sides_sewn_to_a_tube_are_no_window():
    # The rest shape of a panel knows nothing of what is sewn to it; its windows do not reach across the seam.
    tube = pattern({"tube": rectangle(0.3, 0.3)}, [(("tube", 1), ("tube", 3))])
    whole = Garment.from_pattern(tube, 0.02).windows.whole
    assert not whole.all()
    assert sheet(0.3, 0.3, 0.02).windows.whole.all()
