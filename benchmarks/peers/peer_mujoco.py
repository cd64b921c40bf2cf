"""MuJoCo 2D flex: continuum membrane + bending, position-implicit `discrete` integrator."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from peers import scenes


def run(scene: scenes.Scene) -> dict[str, Any]:
    """Drives one scene."""
    s = scene.settings_over(
        dict(
            substeps=2 if scene.sphere else 1,
            young=2e7,
            poisson=0.2,
            thickness=2e-4,
            damping=2e-3,
            radius=1e-3,
            solver="CG" if scene.sphere else "Newton",
            tolerance=1e-6,
            iterations=100 if scene.n <= 64 else 500,
            threads=2,
        )
    )
    pts = " ".join(f"{v:.9g}" for v in scene.x.ravel())
    tri = " ".join(map(str, scene.triangles.ravel()))
    pin = f'<pin id="{" ".join(map(str, scene.pins))}"/>' if scene.pins else ""
    ball = (
        f'<geom type="sphere" size="{scenes.RADIUS}" pos="0 0 {scenes.CENTRE[2]}" friction="{scenes.FRICTION}"/>'
        if scene.sphere
        else ""
    )
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="{1 / scenes.FPS / s["substeps"]}" gravity="0 0 -{scenes.GRAVITY}" integrator="discrete"
  solver="{s["solver"]}" tolerance="{s["tolerance"]}" iterations="{s["iterations"]}"/>
<worldbody>{ball}
 <flexcomp name="c" type="direct" dim="2" mass="{scenes.MASS}" radius="{s["radius"]}" point="{pts}" element="{tri}">
  <contact selfcollide="{"auto" if scene.self_collision else "none"}" condim="3"
   friction="{scenes.FRICTION}" contype="{int(scene.sphere)}" conaffinity="{int(scene.sphere)}"/>
  <elasticity young="{s["young"]}" poisson="{s["poisson"]}" thickness="{s["thickness"]}" elastic2d="both"
   damping="{s["damping"]}"/>{pin}
 </flexcomp></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    if s["threads"] > 1:
        mujoco.mju_threadpool(data, s["threads"] - 1)

    def frame():
        mujoco.mj_step(model, data, s["substeps"])

    free = np.setdiff1d(np.arange(scene.n**2), scene.pins)

    def positions():  # from qpos: flexvert_xpos is still that of the step's start
        x = scene.x.copy()
        x[free] += data.qpos.reshape(-1, 3)
        return x

    r = scenes.drive(scene, frame, positions)
    return {
        **r,
        "settings": s,
        "threads": s["threads"],
        "version": mujoco.__version__,
        "collider": "analytic sphere geom",
        "warnings": int(sum(w.number for w in data.warning)),
    }
