"""PyBullet deformable world: mass-spring cloth loaded from an OBJ file."""

from __future__ import annotations

import os
import tempfile
from typing import Any

import numpy as np
import pybullet as p
from peers import scenes


def run(scene: scenes.Scene) -> dict[str, Any]:
    """Drives one scene."""
    ke = (100 if scene.sphere else 1000) * (scene.n - 1) / 31  # N/m; springs are explicit
    s = scene.settings_over(
        dict(
            substeps=round((30 if scene.sphere else 100) * (scene.n / 32) ** 1.5),
            elastic=ke,
            damping=0.01,
            bending=0.1,
            margin=0.003,
            repulsion=100.0,
            damp_all=1,
        )
    )
    p.connect(p.DIRECT)
    p.resetSimulation(p.RESET_USE_DEFORMABLE_WORLD)
    p.setGravity(0, 0, -scenes.GRAVITY)
    p.setTimeStep(1 / scenes.FPS / s["substeps"])
    with tempfile.TemporaryDirectory() as d:
        path = os.path.join(d, "cloth.obj")
        with open(path, "w") as f:
            f.writelines(f"v {q[0]:.9g} {q[1]:.9g} {q[2]:.9g}\n" for q in scene.x)
            f.writelines(f"f {t[0]} {t[1]} {t[2]}\n" for t in scene.triangles + 1)
        cloth = p.loadSoftBody(
            path,
            mass=scenes.MASS,
            useMassSpring=1,
            useNeoHookean=0,
            useBendingSprings=1,
            springElasticStiffness=s["elastic"],
            springDampingStiffness=s["damping"],
            springDampingAllDirections=s["damp_all"],
            springBendingStiffness=s["bending"],
            useSelfCollision=int(scene.self_collision),
            frictionCoeff=scenes.FRICTION,
            collisionMargin=s["margin"],
            useFaceContact=1,
            repulsionStiffness=s["repulsion"],
        )

    def get() -> np.ndarray:
        return np.array(p.getMeshData(cloth, -1, flags=p.MESH_DATA_SIMULATION_MESH)[1])

    start = get()
    assert len(start) == scene.n**2, f"{len(start)} nodes, expected {scene.n**2}"
    order = np.lexsort(np.round(start * 1e4)[:, :2].T)  # PyBullet may reorder the vertices
    back = np.empty(len(order), int)
    back[np.lexsort(np.round(scene.x * 1e4)[:, :2].T)] = order
    assert np.abs(start[back] - scene.x).max() < 1e-4
    for i in scene.pins:
        p.createSoftBodyAnchor(cloth, int(back[i]), -1, -1)
    if scene.sphere:
        ball = p.createMultiBody(
            0, p.createCollisionShape(p.GEOM_SPHERE, radius=scenes.RADIUS), basePosition=scenes.CENTRE.tolist()
        )
        p.changeDynamics(ball, -1, lateralFriction=scenes.FRICTION)

    def frame():
        for _ in range(s["substeps"]):
            p.stepSimulation()

    r = scenes.drive(scene, frame, lambda: get()[back])
    p.disconnect()
    return {**r, "settings": s, "threads": 1, "version": "pybullet 3.2.7", "collider": "analytic sphere shape"}
