"""Bodies with flipped winding, holes and several shells: what is repaired carries cloth as the good body does."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import crossings, sheet

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

# Two balls side by side and a hollow one: centre, radius [m].
LEFT, RIGHT, INNER = ((-0.1, 0.0, 0.0), 0.08), ((0.1, 0.0, 0.0), 0.08), ((-0.1, 0.0, 0.0), 0.04)


def ball(centre, radius: float) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, radius).apply_translation(centre)


def mixed(mesh: trimesh.Trimesh, share: float, seed: int) -> trimesh.Trimesh:
    """Some triangles turned, here and there."""
    turned = np.random.default_rng(seed).random(len(mesh.faces)) < share
    return with_faces(mesh, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))


def patched(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """All triangles on one side turned, as where a hole was filled by hand."""
    side = mesh.triangles_center[:, 1] > np.quantile(mesh.triangles_center[:, 1], 0.8)
    return with_faces(mesh, np.where(side[:, None], mesh.faces[:, ::-1], mesh.faces))


def holed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Without its underside."""
    height = mesh.triangles_center[:, 2]
    return with_faces(mesh, mesh.faces[height > np.quantile(height, 0.15)])


def inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return with_faces(mesh, mesh.faces[:, ::-1])


def with_faces(mesh: trimesh.Trimesh, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def body_of_shells(*shells: trimesh.Trimesh) -> Body:
    both = trimesh.util.concatenate(shells)
    return Body.from_arrays(both.vertices, both.faces, "shells")


GOOD = (ball(*LEFT), ball(*RIGHT))
# Shells as they come, and what must be said of them.
SHELLS = {
    "one inside out": ((GOOD[0], inside_out(GOOD[1])), {"triangles turned outside out": 320}, None),
    "both inside out": (tuple(map(inside_out, GOOD)), {"triangles turned outside out": 640}, None),
    "mixed winding in both": ((mixed(GOOD[0], 0.3, 1), mixed(GOOD[1], 0.8, 2)), {"agree with their neighbours"}, None),
    "a patch turned": ((patched(GOOD[0]), GOOD[1]), {"agree with their neighbours"}, None),
    "a hole": ((holed(GOOD[0]), GOOD[1]), set(), "sides have one triangle only; the surface is open there"),
    "a hole, inside out": ((holed(inside_out(GOOD[0])), GOOD[1]), {"outside out"}, "the surface is open there"),
    "a hole and a turned patch": ((holed(patched(GOOD[0])), GOOD[1]), {"agree with"}, "the surface is open there"),
    "holes, patches, all turned": (
        (inside_out(holed(mixed(GOOD[0], 0.2, 3))), holed(mixed(patched(GOOD[1]), 0.2, 4))),
        {"agree with their neighbours"}, "the surface is open there",
    ),
    "a shell within": ((*GOOD, ball(*INNER)), set(), "1 shells lie inside another one"),
    "a shell within, inside out": ((*GOOD, inside_out(ball(*INNER))), set(), "1 shells lie inside another one"),
}  # fmt: skip


@pytest.mark.parametrize("what", SHELLS)
def test_shells_with_holes_and_any_winding_all_face_outwards(what):
    shells, repairs, warning = SHELLS[what]
    body = body_of_shells(*shells)
    if isinstance(repairs, dict):
        assert body.repairs == repairs
    for part in repairs:
        assert sum(count for name, count in body.repairs.items() if part in name) > 0
    assert (body.warnings == ()) if warning is None else any(warning in line for line in body.warnings)
    # Away from the centre of its ball: known without any winding.
    corner = body.vertices[body.triangles]
    centre = corner.mean(axis=1)
    ball_of = np.where(centre[:, :1] < 0.0, LEFT[0], RIGHT[0])
    outward = (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * (centre - ball_of)).sum(axis=1)
    outer = np.linalg.norm(centre - ball_of, axis=1) > 0.06
    assert (outward[outer] > 0.0).all()
    # And what is inside is: nowhere near the open underside, where that is a matter of taste.
    points = np.random.default_rng(0).uniform([-0.25, -0.15, -0.02], [0.25, 0.15, 0.15], (400, 3))
    depth = np.minimum(*(np.linalg.norm(points - at, axis=1) - radius for at, radius in (LEFT, RIGHT)))
    clear = np.abs(depth) > 0.01
    np.testing.assert_array_equal(body.signed_distance(points[clear]) < 0.0, depth[clear] < 0.0)


def draped(body: Body) -> Simulation:
    scene = Scene(
        garment=sheet(0.3, 0.2, 0.025, z=0.09), body=body, fabric=replace(Fabric.preset("wool"), friction=0.6),
        settings=Settings(spacing=0.025, max_time=6.0),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.settle()
    return simulation


@pytest.fixture(scope="module")
def on_good():
    return draped(body_of_shells(*GOOD))


@pytest.mark.parametrize("what", SHELLS)
def test_cloth_lies_on_the_repaired_body_as_on_the_good_one(what, on_good):
    body = body_of_shells(*SHELLS[what][0])
    found = draped(body)
    assert found.settled == on_good.settled is True
    x = found.positions
    assert crossings(x, found.triangles, body) == 0
    for at, radius in (LEFT, RIGHT):
        assert np.linalg.norm(x - at, axis=1).min() > radius * np.cos(np.pi / 16)  # the flat of its triangles
    # The order of the triangles decides which of several contacts acts first; the drape is the same.
    assert np.sqrt(((x - on_good.positions) ** 2).sum(axis=1).mean()) < 0.005
