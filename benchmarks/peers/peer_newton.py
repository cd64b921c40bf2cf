"""NVIDIA Newton on the CPU device of Warp: variant vbd, xpbd or semi."""

from __future__ import annotations

from typing import Any

import newton
import numpy as np
import warp as wp
from peers import scenes

DEFAULTS = dict(
    # membrane stiffness in N/m: mu and lambda of a sheet; bending per hinge; iterations per substep
    vbd=dict(
        substeps=0,
        iterations=1,
        tri_ke=1667.0,
        tri_ka=833.0,
        tri_kd=1e-3,
        edge_ke=1e-4,
        edge_kd=0.0,
        contact_ke=1e3,
        contact_kd=1e-3,
        radius=3e-3,
        graph=True,
    ),
    xpbd=dict(substeps=0, iterations=1, spring_ke=0.0, spring_kd=0.0, edge_ke=1e-5, radius=3e-3, graph=True),
    semi=dict(
        substeps=0,
        spring_ke=0.0,
        spring_kd=0.0,
        edge_ke=1e-5,
        contact_ke=500.0,
        contact_kd=0.05,
        contact_kf=0.1,
        radius=3e-3,
        graph=True,
    ),
)


def run(scene: scenes.Scene, variant: str) -> dict[str, Any]:
    """Drives one scene with a solver: vbd, xpbd or semi."""
    wp.config.quiet = True
    s = scene.settings_over(DEFAULTS[variant])
    m = scenes.MASS / scene.n**2
    if variant == "vbd":  # many substeps of one iteration beat few of many; the count is measured
        s["substeps"] = s["substeps"] or round((30 if scene.sphere else 60) * (scene.n / 32) ** 1.43)
    if variant != "vbd":  # 0 means: stiffness from the mesh size, substeps from the spring frequency
        s["spring_ke"] = s["spring_ke"] or 36.0 / scene.spacing
        if not s["substeps"]:
            limit = 2 / (16 * s["spring_ke"] / m) ** 0.5
            s["substeps"] = int(np.ceil(1 / scenes.FPS / ((0.8 if variant == "semi" else 1.0) * limit)))
        if variant == "semi":
            s["spring_kd"] = s["spring_kd"] or 0.05 * (s["spring_ke"] * m) ** 0.5

    b = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -scenes.GRAVITY))
    masses = np.full(scene.n**2, m)
    masses[scene.pins] = 0.0
    b.add_particles(
        pos=[wp.vec3(*p) for p in scene.x],
        vel=[wp.vec3(0.0)] * len(masses),
        mass=masses.tolist(),
        radius=[s["radius"]] * len(masses),
    )
    if variant == "vbd":
        t, k = scene.triangles, len(scene.triangles)
        b.add_triangles(
            t[:, 0], t[:, 1], t[:, 2], tri_ke=[s["tri_ke"]] * k, tri_ka=[s["tri_ka"]] * k, tri_kd=[s["tri_kd"]] * k
        )
    else:
        for i, j in np.concatenate([scene.edges, scene.diagonals]).tolist():
            b.add_spring(i, j, s["spring_ke"], s["spring_kd"], 0.0)
    q = scenes.hinges(scene.triangles)
    b.add_edges(
        *(q[:, c].tolist() for c in range(4)), edge_ke=[s["edge_ke"]] * len(q), edge_kd=[s.get("edge_kd", 0.0)] * len(q)
    )
    if scene.sphere:
        cfg = newton.ModelBuilder.ShapeConfig(mu=scenes.FRICTION)
        if variant != "xpbd":
            cfg.ke, cfg.kd, cfg.kf = s["contact_ke"], s["contact_kd"], s.get("contact_kf", 1e3)
        b.add_shape_sphere(
            -1, xform=wp.transform(wp.vec3(*scenes.CENTRE), wp.quat_identity()), radius=scenes.RADIUS, cfg=cfg
        )
    if variant == "vbd":
        b.color(include_bending=True)
    model = b.finalize(device="cpu")
    model.soft_contact_mu = scenes.FRICTION
    if variant != "xpbd":
        model.soft_contact_ke, model.soft_contact_kd = s["contact_ke"], s["contact_kd"]
        model.soft_contact_kf = s.get("contact_kf", 1e3)
    if variant == "semi":
        model.particle_ke, model.particle_kd, model.particle_kf = s["contact_ke"], s["contact_kd"], s["contact_kf"]
    model.particle_mu = scenes.FRICTION
    if not scene.self_collision:  # no particle-particle pass
        model.particle_grid = None
        model.particle_max_radius = 0.0
    if variant == "vbd":
        solver = newton.solvers.SolverVBD(
            model,
            iterations=s["iterations"],
            particle_enable_self_contact=scene.self_collision,
            particle_self_contact_radius=0.25 * scene.spacing,
            particle_self_contact_margin=0.4 * scene.spacing,
        )
    elif variant == "xpbd":
        solver = newton.solvers.SolverXPBD(model, iterations=s["iterations"])
    else:
        solver = newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)  # brute force: minutes per second
    states = [model.state(), model.state()]
    control = model.control()
    pipeline = newton.CollisionPipeline(model) if scene.sphere else None
    contacts = pipeline.contacts() if pipeline else None
    s["substeps"] += s["substeps"] % 2  # even, so that a captured frame ends in the state it began in
    dt = 1 / scenes.FPS / s["substeps"]

    def frame():
        for _ in range(s["substeps"]):
            states[0].clear_forces()
            if pipeline:
                pipeline.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, dt)
            states.reverse()

    graph = None
    if s["graph"]:
        start = [wp.clone(a) for a in (states[0].particle_q, states[0].particle_qd)]
        with wp.ScopedCapture(device="cpu") as capture:
            frame()
        graph = capture.graph
        states[0].particle_q.assign(start[0])
        states[0].particle_qd.assign(start[1])
    step = (lambda: wp.capture_launch(graph)) if graph else frame

    r = scenes.drive(scene, step, lambda: states[0].particle_q.numpy())
    return {
        **r,
        "settings": s,
        "threads": 1,
        "version": f"newton {newton.__version__}, warp {wp.__version__}",
        "collider": "analytic sphere shape",
    }
