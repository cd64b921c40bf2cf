"""Boxes of a body's triangles are made where the search comes near, and anew where the body has moved."""

import numpy as np
import trimesh
from apparatus import body_of, sheet

from cloth_core.aabb_tree import build_tree, refit_tree
from cloth_core.body_contact import BodyContact, VertexPlanes
from cloth_core.mesh_topology import representatives

OFFSET, RADIUS = 0.003, 0.01


def candidates(contact: BodyContact, x: np.ndarray, triangles: np.ndarray) -> tuple[VertexPlanes, np.ndarray, ...]:
    tree = build_tree(x, triangles)
    refit_tree(tree, x, triangles, OFFSET + RADIUS)
    return contact.candidates(x, triangles, representatives(triangles), tree, RADIUS)


def test_a_body_that_moves_under_the_cloth_is_searched_as_one_that_was_always_there():
    garment = sheet(0.3, 0.3, 0.03)
    ball = body_of(trimesh.creation.icosphere(3, radius=0.2))
    contact = BodyContact(ball, OFFSET)
    seen = []
    for k in range(12):
        body = ball.moved(ball.vertices + np.array([0.03 * k, 0.01 * k, 0.0]))
        contact.body = body
        for height in (0.195, 0.21):  # twice where it is: what the first search has made the second one uses
            x = garment.start + np.array([0.0, 0.0, height])
            found = candidates(contact, x, garment.triangles)
            expected = candidates(BodyContact(body, OFFSET), x, garment.triangles)
            for one, other in zip((*found[0][:3], *found[1:]), (*expected[0][:3], *expected[1:]), strict=True):
                np.testing.assert_array_equal(one, other)
            seen.append(len(found[1]))
    assert min(seen[:6]) > 20


def test_no_boxes_are_made_of_what_is_out_of_reach():
    garment = sheet(0.1, 0.1, 0.02)
    ball = body_of(trimesh.creation.icosphere(4, radius=0.2))
    contact = BodyContact(ball, OFFSET)
    candidates(contact, garment.start + np.array([0.0, 0.0, 0.205]), garment.triangles)
    made = np.flatnonzero(contact._boxes.made)
    assert 10 < len(made) < 0.1 * len(ball.triangles)
    corners = ball.vertices[ball.triangles[made]]
    np.testing.assert_array_equal(contact._boxes.triangles[made, :3], corners.min(axis=1))
    np.testing.assert_array_equal(contact._boxes.triangles[made, 3:6], corners.max(axis=1))
