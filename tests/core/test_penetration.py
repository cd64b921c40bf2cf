"""Depth of cloth inside bodies whose distance has a closed form."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, sheet

from cloth_core.penetration import max_penetration

BOX = body_of(trimesh.creation.box(extents=[0.4, 0.4, 0.2]))


def test_sheet_outside_has_no_depth():
    flat = sheet(0.6, 0.6, 0.1, z=0.101)
    assert max_penetration(flat.start, flat.triangles, BOX) == 0.0
    assert max_penetration(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), BOX) == 0.0


@pytest.mark.parametrize("depth", [1e-4, 0.01, 0.05])
def test_sheet_sunk_into_a_box_is_as_deep_as_it_sank(depth):
    flat = sheet(0.3, 0.3, 0.1, z=0.1 - depth)
    assert max_penetration(flat.start, flat.triangles, BOX) == pytest.approx(depth, rel=1e-9)


def test_side_that_cuts_a_corner_of_the_box_is_deep_between_its_particles():
    # A strip at 45 degrees whose particles are all outside; it passes 2 cm below the upper edge of the box.
    middle, along, across = np.array([0.2 - 0.02, 0.0, 0.1 - 0.02]), np.array([1.0, 0, -1]), np.array([0, 1.0, 0])
    x = np.array([middle - 0.1 * along, middle + 0.1 * along, middle - 0.1 * along + 0.05 * across])
    assert BOX.signed_distance(x).min() > 0.0
    deepest = max_penetration(x, np.array([[0, 1, 2]], dtype=np.int32), BOX)
    assert deepest == pytest.approx(0.02, rel=1e-9)  # the middle is one of the points looked at


def test_tip_that_comes_through_the_middle_of_a_triangle_is_seen():
    needle = body_of(trimesh.creation.cone(0.02, 0.3, sections=32))  # its tip is at z = 0.3
    x = np.array([[-0.3, -0.2, 0.15], [0.3, -0.2, 0.15], [0.0, 0.4, 0.15]])
    triangle = np.array([[0, 1, 2]], dtype=np.int32)
    assert needle.signed_distance(x).min() > 0.0
    # Half-way up the cone's radius is 1 cm, measured level; its wall leans, so it is a little nearer than that.
    assert max_penetration(x, triangle, needle) == pytest.approx(0.01 * np.cos(np.arctan(0.02 / 0.3)), rel=0.02)
