"""A few points that poke through cloth are moved out of it; what is entangled is left as it is."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, sheet
from naive_geometry import is_edge_intersecting_triangle

from cloth_core.blocked_lines import BlockedLines
from cloth_core.nudging import _Crossings, _Surroundings, nudged_apart


def crossing_sides(x: np.ndarray, triangles: np.ndarray) -> int:
    """Sides that cross a triangle with which they share no corner, by the textbook."""
    sides = np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    own = (sides[:, None, :, None] == triangles[None, :, None, :]).any(axis=(2, 3))
    p, q = (x[sides[:, k], None] for k in range(2))
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return int((is_edge_intersecting_triangle(p, q, a, b, c) & ~own).any(axis=1).sum())


def two_sheets(depth: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet, and one above it of which one corner hangs through it by depth [m]."""
    flat = sheet(0.2, 0.2, 0.04)
    upper = flat.start + np.array([0.0131, 0.0172, 0.02])
    upper[int(np.linalg.norm(flat.start, axis=1).argmin())] -= [0.0, 0.0, 0.02 + depth]
    x = np.concatenate([flat.start, upper])
    return x, np.concatenate([flat.triangles, flat.triangles + len(upper)])


@pytest.mark.parametrize("depth", [0.0002, 0.0009, 0.0031])
def test_a_point_that_pokes_through_is_moved_back(depth):
    x, triangles = two_sheets(depth)
    before = crossing_sides(x, triangles)
    assert before > 0
    moved, count = nudged_apart(x, triangles, None, 0)
    assert count == crossing_sides(moved, triangles) == 0
    way = np.linalg.norm(moved - x, axis=1)
    assert (way > 0.0).sum() <= 2
    assert depth <= way.max() * np.sqrt(3) + 1e-12
    assert way.max() <= 0.004


def test_not_more_than_needed_is_done():
    x, triangles = two_sheets(0.0009)
    present = crossing_sides(x, triangles)
    moved, count = nudged_apart(x, triangles, None, present)
    assert count == present
    assert np.array_equal(moved, x)


def test_what_is_deep_inside_never_crosses_more_than_before():
    x, triangles = two_sheets(0.03)
    moved, count = nudged_apart(x, triangles, None, 0)
    assert count == crossing_sides(moved, triangles) <= crossing_sides(x, triangles)


def test_a_point_is_not_moved_into_the_body():
    # A plate right below the sheet: the way down is barred, whatever would be shorter.
    x, triangles = two_sheets(0.0009)
    plate = body_of(trimesh.creation.box(extents=[1.0, 1.0, 0.1]), move=[0.0, 0.0, -0.0512])
    moved, count = nudged_apart(x, triangles, plate, 0)
    assert count == 0
    assert crossing_sides(moved, triangles) == 0
    assert crossings(moved, triangles, plate) == 0


def test_a_tip_of_the_body_in_a_triangle_counts_and_is_left():
    # A needle through the middle of a triangle: nobody's side is in the way, and the seam may not merge here.
    x, triangles = two_sheets(0.0009)
    middle = x[triangles[0]].mean(axis=0)
    needle = body_of(trimesh.creation.cone(0.004, 0.02), move=[middle[0], middle[1], -0.01])
    tips = crossings(x, triangles, needle)
    assert tips > 0 == len(_Crossings.of(x, triangles, needle).through_body)
    assert nudged_apart(x, triangles, needle, 0)[1] == tips
    moved, count = nudged_apart(x, triangles, needle, tips)
    assert count == tips == crossings(moved, triangles, needle)
    assert crossing_sides(moved, triangles) == 0


def test_counting_around_one_point_is_counting_all():
    rng = np.random.default_rng(7)
    plate = body_of(trimesh.creation.icosphere(2, 0.05), move=[0.01, 0.0, 0.03])
    through_plate = BlockedLines(plate)
    x, triangles = two_sheets(0.0031)
    found = _Crossings.of(x, triangles, plate)
    assert found.number == crossing_sides(x, triangles) + len(found.through_body)
    seen = set()
    for point in found.points.tolist():
        surroundings = _Surroundings.of(x, triangles, found, point)
        for _ in range(10):
            moved = x.copy()
            moved[point] += rng.uniform(-0.002, 0.002, 3)
            there = surroundings.crossings(moved, through_plate)
            assert there == _Crossings.of(moved, triangles, plate).number
            seen.add(there - found.number)
    assert min(seen) < 0 < max(seen)
