"""Panels as triangle meshes: the outline is kept, nothing overlaps, no slivers, the lattice follows warp and weft."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.errors import GarmentError
from cloth_core.panel_mesh import PanelMesh, mesh_panel, smallest_angles
from cloth_core.pattern import Pattern, builtin_patterns


def sampled(line, spacing: float) -> np.ndarray:
    """A polyline cut into equal parts of at most the spacing."""
    line = shapely.LineString(line)
    count = max(math.ceil(line.length / spacing - 1e-6), 1)
    return shapely.get_coordinates(shapely.line_interpolate_point(line, np.linspace(0, 1, count + 1), normalized=True))


def polygon_edges(corners, spacing: float) -> list[np.ndarray]:
    return [sampled([corners[i - 1], corners[i]], spacing) for i in range(len(corners))]


def curve_edges(curve, spacing: float, pieces: int = 4) -> list[np.ndarray]:
    """A closed curve of a parameter in [0, 1], cut into pieces."""
    t = np.linspace(0, 1, 400 * pieces + 1)
    points = np.array([curve(2 * math.pi * u) for u in t])
    points[-1] = points[0]
    return [sampled(points[400 * k : 400 * (k + 1) + 1], spacing) for k in range(pieces)]


# Outlines of 0.2 to 0.6 m, like those of garment pieces: nothing sharper than 40 degrees, no curve tighter than 4 cm.
OUTLINES = {
    "square": lambda h: polygon_edges([(0, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)], h),
    "tilted square": lambda h: polygon_edges([(0, 0), (0.3, 0.1), (0.2, 0.4), (-0.1, 0.3)], h),
    "trapezium": lambda h: polygon_edges([(0, 0), (0.5, 0), (0.4, 0.45), (0.1, 0.45)], h),
    "L": lambda h: polygon_edges([(0, 0), (0.5, 0), (0.5, 0.2), (0.23, 0.2), (0.23, 0.55), (0, 0.55)], h),
    "hexagon": lambda h: polygon_edges(
        [(0.25 * math.cos(k * math.pi / 3), 0.25 * math.sin(k * math.pi / 3)) for k in range(6)], h
    ),
    "triangle": lambda h: polygon_edges([(0, 0), (0.5, 0.02), (0.2, 0.45)], h),
    "disc": lambda h: curve_edges(lambda t: (0.2 * math.cos(t), 0.2 * math.sin(t)), h),
    "ellipse": lambda h: curve_edges(lambda t: (0.3 * math.cos(t), 0.15 * math.sin(t)), h),
    "bean": lambda h: curve_edges(
        lambda t: ((0.2 + 0.05 * math.sin(2 * t)) * math.cos(t), (0.2 + 0.05 * math.cos(3 * t)) * math.sin(t)), h
    ),
    "clockwise": lambda h: polygon_edges([(0, 0), (0, 0.3), (0.4, 0.3), (0.4, 0)], h),
}  # fmt: skip


def outline_of(edges: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([e[:-1] for e in edges])


def doubled_areas(mesh: PanelMesh) -> np.ndarray:
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    u, w = b - a, c - a
    return u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]


def assert_fills_its_outline(mesh: PanelMesh, edges: list[np.ndarray]) -> None:
    """The mesh is a disc whose rim is the outline, point by point, and whose triangles fill it without overlap."""
    outline = outline_of(edges)
    count = len(outline)
    np.testing.assert_array_equal(mesh.points[:count], outline)
    for index, edge in zip(mesh.edge_points, edges, strict=True):
        np.testing.assert_allclose(mesh.points[index], edge, rtol=0, atol=1e-15)  # ends are shared with the neighbours
    polygon = shapely.Polygon(outline)
    signed = doubled_areas(mesh)
    assert (signed > 0).all() or (signed < 0).all()  # all wound one way,
    assert (signed[0] > 0) == shapely.is_ccw(polygon.exterior)  # the outline's
    assert abs(signed.sum()) / 2 == pytest.approx(polygon.area, rel=1e-9)
    sides = np.sort(np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    unique, uses = np.unique(sides, axis=0, return_counts=True)
    assert uses.max() <= 2
    rim = {tuple(s) for s in unique[uses == 1].tolist()}
    assert rim == {tuple(sorted((i, (i + 1) % count))) for i in range(count)}
    assert set(mesh.triangles.ravel().tolist()) == set(range(len(mesh.points)))  # no particle without cloth
    # Euler characteristic of a disc.
    assert len(mesh.points) - len(unique) + len(mesh.triangles) == 1
    # With one area and one rim, no two triangles overlap; a few are checked one by one.
    centres = mesh.points[mesh.triangles].mean(axis=1)
    assert shapely.contains_xy(polygon, centres).all()


@pytest.mark.parametrize("spacing", [0.03, 0.02, 0.013, 0.008])
@pytest.mark.parametrize("what", OUTLINES)
def test_ordinary_outlines_are_kept_and_have_no_sliver(what, spacing):
    edges = OUTLINES[what](spacing)
    mesh = mesh_panel(what, edges, spacing)
    assert_fills_its_outline(mesh, edges)
    assert np.degrees(smallest_angles(mesh.points, mesh.triangles).min()) >= 15.0


@settings(max_examples=40, deadline=None)
@given(
    corners=st.lists(st.tuples(st.floats(0, 2 * math.pi), st.floats(0.8, 1.2)), min_size=5, max_size=9),
    spacing=st.floats(0.01, 0.04), turn=st.floats(0, 1.5),
)  # fmt: skip
def test_star_shaped_outlines_of_any_kind_are_kept(corners, spacing, turn):
    # Corners around a middle, at least 25 degrees apart, 0.2 m away, more or less.
    angles = sorted(a for a, _ in corners)
    apart = np.diff([*angles, angles[0] + 2 * math.pi])
    angles = [a for a, gap in zip(angles, apart, strict=True) if 0.45 < gap]
    if len(angles) < 3 or max(np.diff([*angles, angles[0] + 2 * math.pi])) > 2.6:
        angles = [k * 2 * math.pi / len(corners) for k in range(len(corners))]
    radii = [0.2 * r for _, r in corners]
    outline = [(r * math.cos(a + turn), r * math.sin(a + turn)) for a, r in zip(angles, radii, strict=False)]
    edges = polygon_edges(outline, spacing)
    mesh = mesh_panel("star", edges, spacing)
    assert_fills_its_outline(mesh, edges)
    assert np.degrees(smallest_angles(mesh.points, mesh.triangles).min()) >= 15.0


@settings(max_examples=30, deadline=None)
@given(
    width=st.floats(0.2, 0.5), height=st.floats(0.2, 0.6), sag=st.floats(-0.08, 0.08), flare=st.floats(-0.08, 0.08),
    spacing=st.floats(0.008, 0.03),
)  # fmt: skip
def test_curved_hems_and_necks_are_kept_and_have_no_sliver(width, height, sag, flare, spacing):
    u = np.linspace(0, 1, 200)
    lower = np.column_stack([width * u, sag * 4 * u * (1 - u)])
    right = np.array([[width, 0], [width + flare, height]])
    upper = np.column_stack([width + flare - (width + 2 * flare) * u, height - sag * np.sin(math.pi * u)])
    left = np.array([[-flare, height], [0, 0]])
    edges = [sampled(line, spacing) for line in (lower, right, upper, left)]
    mesh = mesh_panel("piece", edges, spacing)
    assert_fills_its_outline(mesh, edges)
    assert np.degrees(smallest_angles(mesh.points, mesh.triangles).min()) >= 15.0


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (3, 2), (7, 11)])
def test_rectangle_is_the_papers_regular_grid(nx, ny):
    h = 0.02
    mesh = mesh_panel("r", polygon_edges([(0, 0), (nx * h, 0), (nx * h, ny * h), (0, ny * h)], h), h)
    assert len(mesh.points) == (nx + 1) * (ny + 1)
    assert len(mesh.quads) == nx * ny
    assert len(mesh.triangles) == 2 * nx * ny  # no band
    assert len(mesh.rows) == (nx - 1) * (ny + 1)
    assert len(mesh.columns) == (nx + 1) * (ny - 1)
    place = np.rint(mesh.points / h).astype(int)
    np.testing.assert_allclose(mesh.points, place * h, atol=1e-12)
    assert {tuple(p) for p in place.tolist()} == {(i, j) for i in range(nx + 1) for j in range(ny + 1)}
    steps = place[mesh.quads] - place[mesh.quads[:, :1]]
    assert (steps == [[0, 0], [1, 0], [1, 1], [0, 1]]).all()
    # The diagonals turn from cell to cell, so that no direction is preferred.
    diagonal = {}
    for quad, halves in zip(mesh.quads, mesh.triangles.reshape(-1, 2, 3), strict=True):
        shared = set(halves[0].tolist()) & set(halves[1].tolist())
        diagonal[tuple(place[quad[0]])] = shared == {quad[0], quad[2]}
    assert all(diagonal[i, j] != diagonal[i + 1, j] for i in range(nx - 1) for j in range(ny))
    assert all(diagonal[i, j] != diagonal[i, j + 1] for i in range(nx) for j in range(ny - 1))


@pytest.mark.parametrize("what", OUTLINES)
def test_rows_lie_along_weft_and_columns_along_warp(what):
    mesh = mesh_panel(what, OUTLINES[what](0.015), 0.015)
    for triples, along, across in ((mesh.rows, 0, 1), (mesh.columns, 1, 0)):
        assert len(triples) > 10
        before, centre, after = (mesh.points[triples[:, k]] for k in range(3))
        np.testing.assert_allclose(before[:, across], centre[:, across], atol=1e-7)
        np.testing.assert_allclose(after[:, across], centre[:, across], atol=1e-7)
        step = after[:, along] - centre[:, along]
        np.testing.assert_allclose(centre[:, along] - before[:, along], step, atol=1e-7)
        assert (step > 0.5 * 0.015).all()
        assert (step <= 0.015 * (1 + 1e-9)).all()
    quads = mesh.points[mesh.quads]
    np.testing.assert_allclose(quads[:, 0, 1], quads[:, 1, 1], atol=1e-7)
    np.testing.assert_allclose(quads[:, 0, 0], quads[:, 3, 0], atol=1e-7)
    # Most of an ordinary panel is grid.
    assert len(mesh.quads) * 2 > 0.5 * len(mesh.triangles)


def test_lattice_is_as_fine_as_asked():
    coarse, fine = (mesh_panel("d", OUTLINES["disc"](h), h) for h in (0.02, 0.01))
    assert len(fine.points) == pytest.approx(4 * len(coarse.points), rel=0.15)
    longest = max(
        np.linalg.norm(fine.points[fine.triangles[:, k]] - fine.points[fine.triangles[:, k - 1]], axis=1).max()
        for k in range(3)
    )
    assert longest < 2.2 * 0.01


def test_same_panel_gives_the_same_numbers():
    for what in ("bean", "L"):
        one, two = (mesh_panel(what, OUTLINES[what](0.015), 0.015) for _ in range(2))
        for field in ("points", "triangles", "quads", "rows", "columns"):
            np.testing.assert_array_equal(getattr(one, field), getattr(two, field))


def test_outline_points_come_first_and_lattice_nodes_row_by_row():
    edges = OUTLINES["disc"](0.02)
    mesh = mesh_panel("d", edges, 0.02)
    inner = mesh.points[len(outline_of(edges)) :]
    keys = list(zip(np.rint(inner[:, 1] * 1e9).tolist(), inner[:, 0].tolist(), strict=True))
    assert keys == sorted(keys)


def test_outline_that_crosses_itself_is_refused_with_the_panels_name():
    with pytest.raises(GarmentError, match=r"panel 'bow': the outline sampled at 50 mm crosses itself"):
        mesh_panel("bow", polygon_edges([(0, 0), (1, 1), (1, 0), (0, 1)], 0.05), 0.05)


def test_smallest_angles():
    points = np.array([[0, 0], [1, 0], [0, 1], [0.5, math.sqrt(3) / 2], [2, 0]])
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], dtype=np.int32)
    assert np.degrees(smallest_angles(points, triangles)) == pytest.approx([45.0, 60.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("name", builtin_patterns())
@pytest.mark.parametrize("spacing", [0.025, 0.015])
def test_panels_of_the_builtin_patterns_have_no_sliver(name, spacing):
    for panel in Pattern.load(name).panels.values():
        edges = [e.sample(max(math.ceil(e.length / spacing), 1) + 1) for e in panel.edges]
        mesh = mesh_panel(panel.name, edges, spacing)
        assert_fills_its_outline(mesh, edges)
        assert np.degrees(smallest_angles(mesh.points, mesh.triangles).min()) >= 15.0, panel.name
