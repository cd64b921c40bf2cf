"""How far each particle may go between two searches of everything, and what that saves."""

import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, sheet, throw

from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.fabric import Fabric
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

OFFSET = 0.003
BALL = body_of(trimesh.creation.icosphere(2, radius=0.15))


def test_what_is_next_to_something_fast_gets_its_radius():
    garment = sheet(0.4, 0.4, 0.04, z=0.5)
    contact = Contact(garment.triangles, BodyContact(BALL, OFFSET), radius=0.03)
    x = garment.start
    wanted = np.full(len(x), 0.001)
    fast = int(np.argmin(np.linalg.norm(x[:, :2], axis=1)))
    wanted[fast] = 0.02
    contact.search(x, wanted)
    # Two triangles away, by the sides of the mesh.
    near = {fast}
    for _ in range(2):
        near |= {int(i) for t in garment.triangles if near & set(map(int, t)) for i in t}
    radii = contact.broad.radii
    assert radii[sorted(near)] == pytest.approx(radii[fast])
    others = np.setdiff1d(np.arange(len(x)), sorted(near))
    assert len(others) > 20
    assert radii[others].max() < 0.2 * radii[fast]


def test_sheet_thrown_at_a_ball_is_searched_rarely_and_never_passes():
    scene = Scene(
        garment=sheet(0.3, 0.3, 0.03, z=0.17), body=BALL, fabric=Fabric.preset("wool"), without=("self contact",),
        settings=Settings(spacing=0.03),
    )  # fmt: skip
    simulation = Simulation(scene)
    throw(simulation, [0.0, 0.0, -3.0])
    contact = simulation.model.contact
    for _ in range(60):
        simulation.tick()
        assert crossings(*simulation.sewn_mesh(), BALL) == 0
    assert 2 < contact.broad.searches < contact.narrow_phases
    assert contact.broad.searches < simulation.steps / 10
