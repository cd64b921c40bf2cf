"""This package, through its public interface: explicit springs with a strain limit, contact without penetration."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
from peers import scenes
from peers.sheet import as_grid, sheet

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

# Subdivisions of the icosphere: its faces lie up to 1.4 mm inside the sphere, less than the contact offset.
_SUBDIVISIONS = 3


def run(scene: scenes.Scene) -> dict[str, Any]:
    """Drives one scene."""
    # The strain limit holds the cloth without stiffness, so that this is the stiffness of a fabric at any N. What lies
    # on a sphere is hardly pulled; softer springs allow longer steps there.
    softer = scene.sphere and not scene.self_collision
    s = scene.settings_over(
        {
            "structural": 400.0 if softer else 1000.0,
            "shear": 50.0,
            "bending": 1e-5,
            "damping_time": 1e-5,
            "strain_limit": 0.042,
        }
    )
    garment = sheet(scene.n)
    order = as_grid(garment, scene.x)
    fabric = Fabric(
        "sheet", scenes.DENSITY, s["structural"], s["structural"], s["shear"], s["bending"],
        damping_time=s["damping_time"], friction=scenes.FRICTION, strain_limit=s["strain_limit"],
    )  # fmt: skip
    body = Body.from_arrays(*scenes.icosphere(_SUBDIVISIONS), "ball") if scene.sphere else None
    simulation = Simulation(
        Scene(
            garment,
            fabric,
            body=body,
            pins=order[scene.pins].astype(np.int32),
            gravity=(0.0, 0.0, -scenes.GRAVITY),
            air_drag=0.0,
            settings=Settings(spacing=scene.spacing),
            without=() if scene.self_collision else ("self contact",),
        )
    )
    result = scenes.drive(scene, lambda: simulation.advance(1 / scenes.FPS), lambda: simulation.positions[order])
    return {
        **result,
        "settings": {**s, "steps_per_frame": round(simulation.steps / scene.frames)},
        "threads": 1,
        "version": f"cloth_sim_ros {version('cloth_sim_ros')}",
        "collider": f"icosphere mesh, {_SUBDIVISIONS} subdivisions",
    }
