"""End to end: each built-in garment on each of the paper's three women, from the pattern to rest."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import shapely
from apparatus import crossings
from naive_geometry import is_edge_intersecting_triangle

from cloth_core.body import Body, builtin_bodies
from cloth_core.intersections import crossing_edges
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

GARMENTS = ["tshirt", "skirt", "trousers", "dress"]
SPACING = 0.03  # a little coarser than draft, so that twelve drapes fit into a test


@dataclass(frozen=True)
class Drape:
    """A garment at rest on a body."""

    report: Report
    x: np.ndarray
    triangles: np.ndarray
    unsewn: np.ndarray
    simulation: Simulation


@cache
def draped(garment: str, body: str) -> Drape:
    simulation = Simulation(Scene.build(Pattern.load(garment), Body.load(body), settings=Settings(spacing=SPACING)))
    report = simulation.settle()
    return Drape(report, *simulation.sewn_mesh(), simulation.positions, simulation)


def test_the_papers_three_women():
    assert builtin_bodies() == ["elderly", "middle_aged", "young"]


@pytest.mark.parametrize("body", builtin_bodies())
@pytest.mark.parametrize("garment", GARMENTS)
def test_garment_is_draped(garment, body):
    drape = draped(garment, body)
    report, woman = drape.report, Body.load(body)
    assert report.settled, report.rest_reason
    assert report.open_seams == {}
    assert report.max_seam_gap < 0.001
    assert report.body_intersections == 0
    assert report.max_penetration <= 0.0005
    assert report.max_strain <= report.strain_limit
    # The same by other means: unsewn points coincide, nothing crosses the body either way, no particle is inside it.
    for seam in drape.simulation.scene.garment.seams:
        assert np.linalg.norm(drape.unsewn[seam.first] - drape.unsewn[seam.second], axis=1).max() < 0.001
    assert crossings(drape.x, drape.triangles, woman) == 0
    assert np.isfinite(drape.x).all()
    # It is worn: it surrounds the body and did not slide to the floor.
    assert drape.x[:, 2].max() > 0.45 * np.ptp(woman.vertices[:, 2])
    assert drape.x[:, 1].min() < 0 < drape.x[:, 1].max()
    assert woman.signed_distance(drape.x).min() > 0.0


def test_crossings_of_a_drape_are_those_of_the_textbook():
    # Every side of the skirt against every triangle of the body whose boxes meet, by signs of volumes.
    drape, woman = draped("skirt", "middle_aged"), Body.load("middle_aged")
    x = drape.x.copy()
    assert edges_through(x, drape.triangles, woman) == drape.report.body_intersections == 0
    # And where there are some: the same skirt pushed a centimetre sideways.
    x[:, 0] += 0.01
    found = len(crossing_edges(x, drape.triangles, woman.vertices, woman.triangles))
    assert found == edges_through(x, drape.triangles, woman) > 10


def edges_through(x: np.ndarray, triangles: np.ndarray, body: Body) -> int:
    sides = {tuple(sorted((t[k], t[(k + 1) % 3]))) for t in triangles.tolist() for k in range(3)}
    corners = body.vertices[body.triangles]
    corners = corners[((corners.min(axis=1) <= x.max(axis=0)) & (corners.max(axis=1) >= x.min(axis=0))).all(axis=1)]
    low, high = corners.min(axis=1), corners.max(axis=1)
    count = 0
    for i, j in sides:
        near = ((low <= np.maximum(x[i], x[j])) & (high >= np.minimum(x[i], x[j]))).all(axis=1)
        count += is_edge_intersecting_triangle(x[i], x[j], *corners[near].transpose(1, 0, 2)).any()
    return int(count)


def test_rest_is_rest():
    # What is reported as settled stays where it is.
    simulation = draped("skirt", "young").simulation
    before = simulation.positions
    simulation.advance(0.5)
    assert np.linalg.norm(simulation.positions - before, axis=1).max() < 0.005


@pytest.mark.parametrize("body", builtin_bodies())
def test_skirt_surrounds_the_hips(body):
    # The slice of the body at hip height lies within the hull of the cloth at that height, at about the offset.
    x, woman = draped("skirt", body).x, Body.load(body)
    level = 0.5 * np.ptp(woman.vertices[:, 2])
    hips = woman.vertices[(np.abs(woman.vertices[:, 2] - level) < 0.01) & (np.abs(woman.vertices[:, 0]) < 0.2)]
    cloth = x[np.abs(x[:, 2] - level) < 0.03]
    hull = shapely.MultiPoint(cloth[:, :2]).convex_hull
    assert len(hips) > 20
    assert shapely.contains_xy(hull.buffer(0.005), hips[:, :2]).mean() > 0.95
    assert hull.area < 3.0 * shapely.MultiPoint(hips[:, :2]).convex_hull.area  # it is worn, not hung up around
