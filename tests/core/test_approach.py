"""Panels that start far from the body are brought nearer, and nothing is passed through on the way."""

import json

import naive_geometry
import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, plain_fabric, rectangle

from cloth_core.body import Body
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene

# A column of 0.3 x 0.2 m, 2 m high; fronts are on -y, which a file calls +z.
COLUMN = body_of(trimesh.creation.box(extents=[0.3, 0.2, 2.0]), move=[0.0, 0.0, 1.0])
FACE = 0.1
SIDES = [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))]


def tube(front: float, back: float, **more: dict) -> Pattern:
    """Front and back of a tube around the column, at these distances from its middle [m]."""
    panels = {
        "front": rectangle(0.5, 0.4, at=(0.0, 1.0, front)),
        "back": rectangle(0.5, 0.4, at=(0.0, 1.0, -back), turned=(0, 180, 0)),
    }
    return pattern(panels | more, SIDES)


def started(of: Pattern, body: Body | None = COLUMN) -> Garment:
    return Scene.build(of, body, plain_fabric(), settings=Settings(spacing=0.05)).garment


def place(garment: Garment, name: str) -> np.ndarray:
    return garment.start[garment.panel_of_particle == garment.panel_names.index(name)]


def test_far_panels_are_brought_to_four_centimetres():
    garment = started(tube(0.4, 0.25))
    np.testing.assert_allclose(place(garment, "front")[:, 1], -FACE - 0.04, atol=1e-3)
    np.testing.assert_allclose(place(garment, "back")[:, 1], FACE + 0.04, atol=1e-3)
    # Straight: nothing else changes.
    flat = started(tube(0.4, 0.25), None)
    np.testing.assert_array_equal(garment.start[:, [0, 2]], flat.start[:, [0, 2]])


def test_what_is_near_stays_where_the_pattern_puts_it():
    for pieces in (tube(FACE + 0.08, FACE + 0.02), tube(FACE + 0.089, FACE + 0.089)):
        np.testing.assert_array_equal(started(pieces).start, started(pieces, None).start)


def test_without_seams_nothing_is_moved():
    loose = pattern({"sheet": rectangle(0.5, 0.4, at=(0.0, 1.0, 0.5))})
    np.testing.assert_array_equal(started(loose).start, started(loose, None).start)
    pocket = started(tube(0.4, 0.2, pocket=rectangle(0.1, 0.1, at=(0.0, 1.0, 0.5))))
    np.testing.assert_allclose(place(pocket, "pocket")[:, 1], -0.5)


def test_outer_panel_stays_outside_an_inner_one():
    inner = rectangle(0.3, 0.2, at=(0.0, 1.1, 0.15))
    garment = started(tube(0.4, 0.15, inner=inner))
    front, shirt = place(garment, "front"), place(garment, "inner")
    np.testing.assert_allclose(shirt[:, 1], -0.15)
    assert front[:, 1].max() < -0.15 - 0.002
    assert front[:, 1].min() > -0.16  # and it went there


@pytest.mark.parametrize(("lower_edge", "ahead"), [(1.15, 0.05), (1.21, 0.0)], ids=["covers", "above"])
def test_collar_stays_in_front_of_its_bodice(lower_edge, ahead):
    # The column is thin above the bodice: by itself the collar would go farther in. The bodice reaches up to 1.2 m.
    step = trimesh.creation.box(extents=[0.3, 0.2, 1.1])
    neck = trimesh.creation.box(extents=[0.1, 0.1, 0.4])
    neck.apply_translation([0.0, 0.0, 0.8])
    body = body_of(trimesh.util.concatenate([step, neck]), move=[0.0, 0.0, 0.55])
    panels = {
        "front": rectangle(0.5, 0.4, at=(0.0, 1.0, 0.4)),
        "back": rectangle(0.5, 0.4, at=(0.0, 1.0, -0.15), turned=(0, 180, 0)),
        "collar": rectangle(0.5, 0.1, at=(0.0, lower_edge + 0.05, 0.45)),
    }
    garment = started(pattern(panels, [*SIDES, (("collar", 0), ("front", 2), "right_wrong")]), body)
    front, collar = place(garment, "front")[:, 1], place(garment, "collar")[:, 1]
    np.testing.assert_allclose(front, -FACE - 0.04, atol=1e-3)
    np.testing.assert_allclose(collar, front[0] - ahead, atol=2e-3)


def test_panels_that_touch_go_together():
    panels = {
        "left": rectangle(0.25, 0.4, at=(0.325, 1.0, 0.4)),  # beside the column: by itself it would not stop there
        "right": rectangle(0.25, 0.4, at=(0.075, 1.0, 0.4)),
        "back": rectangle(0.5, 0.4, at=(0.0, 1.0, -0.15), turned=(0, 180, 0)),
    }
    stitches = [(("left", 1), ("back", 3)), (("right", 3), ("back", 1)), (("left", 3), ("right", 1))]
    garment = started(pattern(panels, stitches))
    for name in ("left", "right"):
        np.testing.assert_allclose(place(garment, name)[:, 1], -FACE - 0.04, atol=1e-3)


def test_panel_that_nothing_stops_does_not_go_past():
    beside = tube(0.4, 0.15, sleeve=rectangle(0.1, 0.1, at=(0.5, 1.0, 0.4)))
    beside = pattern(json.loads(beside.source)["pattern"]["panels"], [*SIDES, (("sleeve", 1), ("sleeve", 3))])
    assert -0.4 <= place(started(beside), "sleeve")[:, 1].max() < 0.0


def test_no_panel_goes_through_a_thin_thing_in_its_way():
    # A hand's breadth in front of the column stands a post of 2 mm, much thinner than the way.
    post = trimesh.creation.box(extents=[0.002, 0.002, 2.0])
    post.apply_translation([0.0, -0.25, 0.0])
    column = trimesh.creation.box(extents=[0.3, 0.2, 2.0])
    body = body_of(trimesh.util.concatenate([column, post]), move=[0.0, 0.0, 1.0])
    garment = started(tube(0.5, 0.15), body)
    front = place(garment, "front")
    assert front[:, 1].max() == pytest.approx(-0.251 - 0.04, abs=1e-3)


def test_slanted_panel_stops_at_the_given_distance():
    slanted = pattern(
        {
            "front": rectangle(0.5, 0.4, at=(0.0, 1.0, 0.5), turned=(30, 0, 0)),
            "back": rectangle(0.5, 0.4, at=(0.0, 1.0, -0.15), turned=(0, 180, 0)),
        },
        SIDES,
    )
    garment = started(slanted)
    triangles = garment.triangles[garment.panel_of_triangle == 0]
    # Textbook distances of all sides of the panel from all sides of the column, and of corners from triangles.
    x, body = garment.start, COLUMN
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    edges = np.concatenate([body.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    between = naive_geometry.edge_edge_distance(
        x[sides[:, 0], None], x[sides[:, 1], None], body.vertices[edges[:, 0]], body.vertices[edges[:, 1]]
    ).min()
    corner = body.vertices[body.triangles]
    above = naive_geometry.point_triangle_distance(
        x[np.unique(triangles), None], corner[:, 0], corner[:, 1], corner[:, 2]
    ).min()
    assert np.sqrt(min(between, above)) == pytest.approx(0.04, abs=1e-3)
