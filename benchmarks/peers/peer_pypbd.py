"""InteractiveComputerGraphics PositionBasedDynamics (C++/OpenMP, double): XPBD distance + bending constraints."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from peers import scenes


def y_up(p: np.ndarray) -> np.ndarray:  # gravity cannot be set from Python: it is fixed to -9.81 on y
    """Positions (n, 3) with y up, as this library has them."""
    return np.stack([p[:, 0], p[:, 2], -p[:, 1]], axis=1)


def run(scene: scenes.Scene, threads: str = "2") -> dict[str, Any]:  # pypbd is two threads, pypbd_1 one
    """Drives one scene; variant: number of threads, 2 unless given."""
    os.environ["OMP_NUM_THREADS"] = threads  # read when the library loads
    import pypbd as pbd

    # contacts are found once per step, constraints are projected `iterations` times per substep
    fine = (scene.n / 64) ** 1.43  # substeps this needs to stay under 5 % strain, found by measuring
    steps, substeps = (8, max(3, round(5 * fine))) if scene.sphere else (1, round(118 * fine))
    s = scene.settings_over(
        dict(
            steps=steps, substeps=substeps, iterations=1, stretch=1e5, bend=1e-3, tolerance=0.003, velocity_iterations=5
        )
    )
    if scene.self_collision:
        raise SystemExit("no cloth self-collision in this library (a ToDo in its source)")
    sim = pbd.Simulation.getCurrent()
    sim.initDefault()
    model, stepper = sim.getModel(), sim.getTimeStep()
    cloth = model.addTriangleModel(y_up(scene.x), scene.triangles.ravel().tolist(), testMesh=scene.sphere)
    particles = model.getParticles()
    for i in range(scene.n**2):
        particles.setMass(i, 0.0 if i in scene.pins else scenes.MASS / scene.n**2)
    model.addClothConstraints(cloth, 4, s["stretch"], 1.0, 1.0, 1.0, 0.3, 0.3, False, False)  # 4: XPBD distance
    model.addBendingConstraints(cloth, 3, s["bend"])  # 3: XPBD isometric
    cloth.setRestitutionCoeff(0.0)
    detection = stepper.getCollisionDetection()
    if scene.sphere:
        v, f = scenes.icosphere(centre=np.zeros(3))
        vd, mesh = pbd.VertexData(), pbd.IndexedFaceMesh()
        for p in v:
            vd.addVertex(p)
        mesh.initMesh(len(v), 3 * len(f) // 2, len(f))
        for t in f.tolist():
            mesh.addFace(t)
        mesh.buildNeighbors()
        ball = model.addRigidBody(
            1.0,
            vd,
            mesh,
            translation=y_up(scenes.CENTRE[None])[0],
            rotation=np.identity(3),
            scale=[1, 1, 1],
            testMesh=False,
            generateCollisionObject=False,
        )
        ball.setMass(0.0)
        ball.setFrictionCoeff(0.0)  # the library adds the two coefficients
        cloth.setFrictionCoeff(scenes.FRICTION)
        detection.addCollisionSphere(
            0, pbd.CollisionObject.RigidBodyCollisionObjectType, vd, 0, len(v), scenes.RADIUS, False, False
        )
        detection.setTolerance(s["tolerance"])
    stepper.setValueUInt(pbd.TimeStepController.NUM_SUB_STEPS, s["substeps"])
    stepper.setValueUInt(pbd.TimeStepController.MAX_ITERATIONS, s["iterations"])
    stepper.setValueUInt(pbd.TimeStepController.MAX_ITERATIONS_V, s["velocity_iterations"])
    pbd.TimeManager.getCurrent().setTimeStepSize(1 / scenes.FPS / s["steps"])

    def frame():
        for _ in range(s["steps"]):
            stepper.step(model)

    def positions():
        p = np.array(particles.getVertices(), float).reshape(-1, 3)[: scene.n**2]
        return np.stack([p[:, 0], -p[:, 2], p[:, 1]], axis=1)

    r = scenes.drive(scene, frame, positions)
    return {
        **r,
        "settings": s,
        "threads": int(threads),
        "version": "pyPBD 2.2.2",
        "collider": "analytic sphere distance",
    }
