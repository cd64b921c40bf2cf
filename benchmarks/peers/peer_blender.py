"""Blender's cloth modifier through bpy, one frame_set() per frame, reading the evaluated mesh each time."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from peers import scenes

# Blender's cloth ignores the frame rate: at time_scale 1 one frame advances sqrt(0.001) s (gravity is
# scaled by 0.001 per frame^2), so this makes one frame 1/60 s. Checked by a free fall, see README.
TIME_SCALE = 1 / scenes.FPS / 0.001**0.5


def mesh_object(name: str, v: np.ndarray, f: np.ndarray) -> Any:
    """A mesh of vertices (n, 3) [m] and triangles, linked to the scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(v.tolist(), [], f.tolist())
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def run(scene: scenes.Scene) -> dict[str, Any]:
    """Drives one scene."""
    # 0.3 kg per particle with every stiffness scaled alike moves the same; at the true 0.2 g and less
    # Blender's solver stalls: an unpinned 32 x 32 cloth falls 0.25 m in 0.5 s instead of 1.23 m. Bending is
    # off for the same reason: with 1e-5 N m the 64 x 64 cloth falls 0.97 m; without it, right.
    s = scene.settings_over(
        dict(
            quality=5 if scene.sphere else 3,
            stretch=1.5 * (scene.n - 1),
            shear=0.75 * (scene.n - 1),
            bending=0.0,
            damping=0.02,
            collision_quality=2,
            distance=0.003,
            thickness=0.002,
            vertex_mass=0.3,
        )
    )
    unit = s["vertex_mass"] / (scenes.MASS / scene.n**2) / 1000  # SI to Blender: its time unit is the frame
    bpy.ops.wm.read_factory_settings(use_empty=True)
    sc = bpy.context.scene
    sc.gravity = (0, 0, -scenes.GRAVITY)
    sc.frame_start, sc.frame_end = 1, scene.frames + 1
    ob = mesh_object("cloth", scene.x, scene.triangles)
    md = ob.modifiers.new("cloth", "CLOTH")
    md.point_cache.frame_start, md.point_cache.frame_end = 1, scene.frames + 1
    c, col = md.settings, md.collision_settings
    c.quality, c.time_scale, c.mass = s["quality"], TIME_SCALE, s["vertex_mass"]
    c.tension_stiffness = c.compression_stiffness = s["stretch"] * unit
    c.shear_stiffness, c.bending_stiffness = s["shear"] * unit, s["bending"] * unit
    c.tension_damping = c.compression_damping = c.shear_damping = s["damping"] * unit * 1000**0.5
    c.bending_damping, c.air_damping = 0.0, 0.0
    if scene.pins:
        ob.vertex_groups.new(name="pin").add(scene.pins, 1.0, "REPLACE")
        c.vertex_group_mass = "pin"
    col.use_collision, col.use_self_collision = scene.sphere, scene.self_collision
    col.collision_quality, col.distance_min, col.friction = s["collision_quality"], s["distance"], 5.0
    if scene.self_collision:
        col.self_distance_min = 0.3 * scene.spacing
    if scene.sphere:
        ball = mesh_object("ball", *scenes.icosphere())
        ball.modifiers.new("collision", "COLLISION")
        ball.collision.thickness_outer = s["thickness"]
        ball.collision.cloth_friction = scenes.FRICTION * 10  # Blender's friction has no unit: 0 to 80
    sc.frame_set(1)
    out = np.empty(3 * scene.n**2, np.float32)

    def frame():
        sc.frame_set(sc.frame_current + 1)

    def positions():
        ev = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
        ev.data.vertices.foreach_get("co", out)
        return out.reshape(-1, 3)

    r = scenes.drive(scene, frame, positions)
    return {
        **r,
        "settings": s,
        "threads": 2,
        "version": f"bpy {bpy.app.version_string}",
        "collider": "icosphere mesh, 3 subdivisions",
    }
