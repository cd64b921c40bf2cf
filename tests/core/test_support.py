"""What nothing holds up is named, panel by panel."""

from dataclasses import replace

import numpy as np
import trimesh
from apparatus import body_of, pattern, plain_fabric, rectangle

from cloth_core.model import Model
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.support import PATIENCE_WITH_FALLEN, why_fallen, why_unsupported

PLATE = body_of(trimesh.creation.box(extents=[0.5, 0.5, 0.1]), move=[0.0, 0.0, 0.05])
PANELS = {
    "held": rectangle(0.3, 0.3, at=(0, 0.104, 0), turned=(-90, 0, 0)),
    "loose": rectangle(0.1, 0.1, at=(0.6, 0.104, 0), turned=(-90, 0, 0)),
}


def scene() -> Scene:
    return Scene.build(pattern(PANELS), PLATE, plain_fabric(), settings=Settings(spacing=0.05))


def test_part_that_has_fallen_past_the_body_is_named():
    made = scene()
    model, garment = Model(made), made.garment
    x = garment.start.copy()
    loose = garment.panel_of_particle == 1
    particle = int(np.flatnonzero(loose)[3])
    assert why_fallen(made, model.number, x, particle) == ""
    x[loose, 2] -= 1.0
    line = why_fallen(made, model.number, x, particle)
    assert line.startswith("panel 'loose' is not supported by the body")
    assert why_fallen(made, model.number, x, int(np.flatnonzero(~loose)[3])) == ""
    assert why_fallen(replace(made, gravity=(0.0, 0.0, 0.0)), model.number, x, particle) == ""
    # The garment as a whole is held.
    assert why_unsupported(made, x) is None


def test_run_says_which_part_came_off():
    simulation = Simulation(scene())
    report = simulation.settle()
    assert not report.settled
    assert report.rest_reason.startswith("panel 'loose' is not supported by the body")
    # What falls is not waited for as long as what trembles, 6 s; the rest of the garment has its time to come to rest.
    assert PATIENCE_WITH_FALLEN < simulation.time < 5.0
