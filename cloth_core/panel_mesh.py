"""Step 1 of the paper: a flat panel becomes a regular grid of triangles with a conforming boundary.

Inside the panel the particles are the nodes of a lattice aligned with weft (panel x) and warp (panel y); whole lattice
cells become *quads* with both diagonals as springs. Between the outermost quads and the outline lies a band of Delaunay
triangles, so that outlines are exact and the points of two stitched edges match one to one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.errors import GarmentError
from cloth_core.unique_rows import unique_rows

__all__ = ["PanelMesh", "mesh_panel", "smallest_angles"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Lattice nodes nearer to the outline than this share of the spacing are left out. From 0.55 on, each side of a whole
# cell is a Delaunay edge whatever the outline does (a boundary point that keeps 0.55 from both of its ends stays
# outside the cell's circumscribed circle), so that the band always meets the grid edge to edge.
_CLEARANCES = (0.55, 0.65, 0.75)
_PHASES = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))
_GOOD_ANGLE = 22.0  # degrees; the first lattice that reaches it is taken, otherwise the best of all


@dataclass(frozen=True)
class PanelMesh:
    """Triangle mesh of one panel in its own plane.

    Attributes:
        points: particle positions [m], shape (n, 2); the outline first, in loop order, then lattice nodes row by row.
        triangles: corner indices, shape (m, 3), wound like the outline; the two halves of each quad come first.
        quads: whole lattice cells, shape (q, 4): lower left, lower right, upper right, upper left.
        columns, rows: particle triples (before, centre, after) in line along weft and along warp, shape (k, 3).
        edge_points: for each outline edge the indices of its particles from start to end.
    """

    points: Floats
    triangles: Ints
    quads: Ints
    rows: Ints
    columns: Ints
    edge_points: tuple[Ints, ...]


def smallest_angles(points: Floats, triangles: Ints) -> Floats:
    """Smallest corner angle [rad] of each triangle, shape (m,); points have shape (n, 2) or (n, 3)."""
    sides = np.stack(
        [
            np.linalg.norm(points[triangles[:, (k + 1) % 3]] - points[triangles[:, (k + 2) % 3]], axis=1)
            for k in range(3)
        ]
    )
    sides.sort(axis=0)
    a, b, c = sides
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = (b * b + c * c - a * a) / (2 * b * c)
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=1.0), -1.0, 1.0)), dtype=np.float64)


def mesh_panel(name: str, edges: list[Floats], spacing: float) -> PanelMesh:
    """Mesh the panel whose outline is given edge by edge.

    Args:
        name: the panel's name, for messages.
        edges: sampled outline edges [m], each (k, 2); the end of one is the start of the next.
        spacing: lattice spacing [m]; it is reduced a little so that the panel's extent is a whole number of cells.

    Raises:
        GarmentError: the outline cannot be meshed (it crosses itself once it is sampled this coarsely).
    """
    import shapely

    outline = np.concatenate([edge[:-1] for edge in edges])
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid or polygon.area <= 0.0:
        raise GarmentError(
            f"panel '{name}': the outline sampled at {1000 * spacing:g} mm crosses itself; use a smaller spacing"
        )
    shapely.prepare(polygon)
    best: tuple[float, tuple[Floats, Ints, Ints, Ints, Ints]] | None = None
    for phase in _PHASES:
        for clearance in _CLEARANCES:
            candidate = _lattice_mesh(polygon, outline, spacing, phase, clearance)
            if candidate is None:
                continue
            angle = float(np.degrees(smallest_angles(candidate[0], candidate[1]).min()))
            if best is None or angle > best[0] + 1e-9:
                best = (angle, candidate)
            if best[0] >= _GOOD_ANGLE:
                break
        if best is not None and best[0] >= _GOOD_ANGLE:
            break
    if best is None:
        raise GarmentError(f"panel '{name}': no triangulation keeps its outline; use a smaller spacing")
    points, triangles, quads, rows, columns = best[1]
    if not shapely.is_ccw(shapely.LinearRing(outline)):
        triangles = np.ascontiguousarray(triangles[:, ::-1])  # the normal follows the loop direction

    edge_points, first = [], 0
    for edge in edges:
        index = np.arange(first, first + len(edge), dtype=np.int32)
        index[-1] %= len(outline)
        edge_points.append(index)
        first += len(edge) - 1
    return PanelMesh(points, triangles, quads, rows, columns, tuple(edge_points))


def _lattice_mesh(
    polygon: Any, outline: Floats, spacing: float, phase: tuple[float, float], clearance: float
) -> tuple[Floats, Ints, Ints, Ints, Ints] | None:
    """One trial: lattice with a phase (in cells) and a clearance (in spacings); None where it does not conform."""
    import shapely

    area = float(shapely.area(polygon))
    low, high = outline.min(axis=0), outline.max(axis=0)
    cells = np.maximum(np.ceil((high - low) / spacing - 1e-6).astype(int), 1)
    step = (high - low) / cells
    origin = low + (np.array(phase) - 1.0) * step
    nx, ny = cells + 3
    ix, iy = np.meshgrid(np.arange(nx), np.arange(ny))
    nodes = np.stack([origin[0] + ix * step[0], origin[1] + iy * step[1]], axis=-1)
    flat = nodes.reshape(-1, 2)

    # node_id: particle index of each lattice node, or -1. A boundary point that lies on a node *is* that node.
    node_id = np.full(nx * ny, -1, dtype=np.int64)
    grid_place = np.rint((outline - origin) / step).astype(int)
    on_node = np.linalg.norm(nodes[grid_place[:, 1], grid_place[:, 0]] - outline, axis=1) < 1e-6 * spacing
    node_id[(grid_place[:, 1] * nx + grid_place[:, 0])[on_node]] = np.flatnonzero(on_node)
    boundary = shapely.LineString(np.vstack([outline, outline[:1]]))
    shapely.prepare(boundary)
    inside = shapely.contains_xy(polygon, flat)
    inside[inside] = shapely.distance(boundary, shapely.points(flat[inside])) >= clearance * min(step)
    inside &= node_id < 0
    node_id[inside] = len(outline) + np.arange(np.count_nonzero(inside))
    points = np.vstack([outline, flat[inside]])

    ids = node_id.reshape(ny, nx)
    corners = np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1)
    whole: NDArray[np.bool_] = np.asarray((corners >= 0).all(axis=-1))
    cy, cx = np.nonzero(whole)
    cell = np.stack([cx, cy], axis=1)
    middle = shapely.contains_xy(polygon, origin + (cell + 0.5) * step)
    clear = middle & ~shapely.intersects(boundary, _cell_boxes(origin, step, cell, shrink=1e-4))
    whole[cy[~clear], cx[~clear]] = False
    cy, cx = cy[clear], cx[clear]
    quads = corners[cy, cx].astype(np.int32).reshape(-1, 4)

    band = _delaunay_band(polygon, points, ids, origin, step, whole)
    a, b, c, d = quads.T
    even = ((cx + cy) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(even, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    halves = np.concatenate([first, second], axis=1).reshape(-1, 3)
    triangles = np.vstack([halves, band]).astype(np.int32)
    if not _conforms(points, triangles, len(outline), area):
        remainder = shapely.difference(polygon, shapely.union_all(_cell_boxes(origin, step, cell[clear])))
        constrained = _constrained_band(remainder, points)
        if constrained is None:
            return None
        triangles = np.vstack([halves, constrained]).astype(np.int32)
        used = np.zeros(len(points), dtype=bool)
        used[: len(outline)] = True
        used[triangles] = True
        renumber = (np.cumsum(used) - 1).astype(np.int32)
        points, triangles, quads = points[used], renumber[triangles], renumber[quads]
        ids = np.where((ids >= 0) & used[np.maximum(ids, 0)], renumber[np.maximum(ids, 0)], -1)
        if not _conforms(points, triangles, len(outline), area):
            return None

    # Triples in line whose two links are both sides of whole cells.
    padded = np.zeros((ny + 1, nx + 1), dtype=bool)
    padded[1:ny, 1:nx] = whole
    link_x = padded[:-1, 1:nx] | padded[1:, 1:nx]  # (ny, nx-1): node (i, j) to (i, j+1)
    link_y = padded[1:ny, :-1] | padded[1:ny, 1:]  # (ny-1, nx)
    r, q = np.nonzero(link_x[:, :-1] & link_x[:, 1:])
    rows = np.stack([ids[r, q], ids[r, q + 1], ids[r, q + 2]], axis=1).astype(np.int32)
    r, q = np.nonzero(link_y[:-1] & link_y[1:])
    columns = np.stack([ids[r, q], ids[r + 1, q], ids[r + 2, q]], axis=1).astype(np.int32)
    return points, triangles, quads, rows, columns


def _cell_boxes(origin: Floats, step: Floats, cell: NDArray[np.integer], shrink: float = 0.0) -> Any:
    """The lattice cells (k, 2) as boxes, made smaller by a share of the step on each side."""
    import shapely

    low, high = origin + (cell + shrink) * step, origin + (cell + 1 - shrink) * step
    return shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])


def _delaunay_band(
    polygon: Any, points: Floats, ids: Ints, origin: Floats, step: Floats, whole: NDArray[np.bool_]
) -> Ints:
    """Delaunay triangles that lie inside the panel but in no whole cell, counter-clockwise, shape (k, 3).

    ids (ny, nx) are the points of the lattice's nodes. Nodes with two rings of whole cells around them are left out:
    they are corners of no such triangle, and in a large panel they are nearly all.
    """
    import shapely
    from scipy.ndimage import binary_erosion
    from scipy.spatial import Delaunay

    deep = binary_erosion(whole, np.ones((3, 3)), iterations=2)
    deep = deep[:-1, :-1] & deep[:-1, 1:] & deep[1:, :-1] & deep[1:, 1:]
    needed = np.ones(len(points), dtype=bool)
    needed[ids[1:-1, 1:-1][deep]] = False
    index = np.flatnonzero(needed).astype(np.int32)
    triangles = index[Delaunay(points[index]).simplices]
    corner = points[triangles]
    area = _doubled_areas(points, triangles)
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    centre = corner.mean(axis=1)
    cell = np.floor((centre - origin) / step).astype(int)
    ok = (cell[:, 0] >= 0) & (cell[:, 1] >= 0) & (cell[:, 0] < whole.shape[1]) & (cell[:, 1] < whole.shape[0])
    in_grid = np.zeros(len(triangles), dtype=bool)
    in_grid[ok] = whole[cell[ok, 1], cell[ok, 0]]
    flat = np.abs(area) < 1e-9 * step.min() ** 2
    keep = ~in_grid & ~flat & shapely.contains_xy(polygon, centre)
    band = triangles[keep]
    # qhull's order is its own affair; ours is a fixed rule: smallest corner first, then sorted.
    band = np.take_along_axis(band, (band.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return np.asarray(band[np.lexsort(band.T[::-1])], dtype=np.int32)


def _constrained_band(remainder: Any, points: Floats) -> Ints | None:
    """Constrained Delaunay triangulation of what the whole cells leave over, as indices into points."""
    import shapely
    from scipy.spatial import KDTree

    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(remainder))
    if len(parts) == 0:
        return np.zeros((0, 3), dtype=np.int32)
    corner = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    distance, index = KDTree(points).query(corner.reshape(-1, 2))
    if distance.max() > 1e-9:
        return None
    triangles = index.reshape(-1, 3).astype(np.int32)
    area = _doubled_areas(points, triangles)
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    return np.asarray(triangles[area != 0], dtype=np.int32)


def _doubled_areas(points: Floats, triangles: Ints) -> Floats:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    u, w = b - a, c - a
    return np.asarray(u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0], dtype=np.float64)


def _conforms(points: Floats, triangles: Ints, outline_count: int, area: float) -> bool:
    """Whether the triangles fill the polygon exactly and their free sides are the outline's, each once."""
    if abs(_doubled_areas(points, triangles).sum() / 2 - area) > 1e-9 * area:
        return False
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique = unique_rows(sides)
    free = unique.rows[unique.counts == 1]
    ring = np.arange(outline_count)
    expected = np.unique(np.sort(np.stack([ring, (ring + 1) % outline_count], 1), axis=1), axis=0)
    return bool(unique.counts.max() <= 2 and free.shape == expected.shape and (free == expected).all())
