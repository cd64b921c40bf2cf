"""Loads and compiles before a node serves what its first garment would load and compile while it serves.

Imports and the loading of compiled code hold Python's lock for up to 0.1 s at a time, in which no service answers; on a
machine where nothing has been compiled yet, compiling takes a minute.
"""

import json
import tempfile
from pathlib import Path

import numpy as np

from cloth_core.blocked_lines import BlockedLines
from cloth_core.body import Body
from cloth_core.grasp import Pose
from cloth_core.mesh_files import write_mesh
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation

__all__ = ["warm_up"]

# A handkerchief of two halves above a box; all that costs time here is loading, not simulating.
_HALF = 0.06
_SPACING = 0.02
_MOST_TIME = 0.3
"""Simulated [s]."""


def warm_up() -> None:
    """Takes a very small garment through all that a node may do with one."""
    pattern = Pattern.from_json(_two_halves(), "warm-up")
    corners = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1.0, 1.0)])
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([t for a, b, c, d in sides for t in ([a, b, c], [a, c, d])], dtype=np.int32)
    body = Body.from_arrays(corners, triangles, "box")
    # Only garments that start around limbs ask for it.
    BlockedLines(body, 1).count(corners, np.array([[0, 1]], dtype=np.int32))
    simulation = ScheduledSimulation(Scene.build(pattern, body, settings=Settings(spacing=_SPACING)))
    simulation.describe()
    simulation.tick()
    simulation.settle(lambda running: running.time > _MOST_TIME)
    pose = Pose.of((0.0, 0.0, 0.1))
    simulation.grasp("gripper", np.array([0], dtype=np.int32), pose)
    simulation.move_grasp("gripper", Pose.of((0.0, 0.001, 0.1), (0.0, 0.0, 0.01, 1.0)))
    simulation.move_body(body.vertices - np.array([0.0, 0.0, 0.001]), 0.01)
    simulation.advance(0.01)
    simulation.release("gripper")
    simulation.tick()
    with tempfile.TemporaryDirectory() as directory:
        write_mesh(Path(directory) / "garment.glb", *simulation.sewn_mesh())
    simulation.report().to_json()


def _two_halves() -> str:
    """Two level squares side by side above the origin, sewn together at one edge, as GarmentCode JSON."""

    def panel(x: float) -> dict[str, object]:
        return {
            "translation": [x, 0.08, 0.0],
            "rotation": [-90.0, 0.0, 0.0],
            "vertices": [[-_HALF, -_HALF], [_HALF, -_HALF], [_HALF, _HALF], [-_HALF, _HALF]],
            "edges": [{"endpoints": [corner, (corner + 1) % 4]} for corner in range(4)],
        }

    stitch = [{"panel": "left", "edge": 1}, {"panel": "right", "edge": 3}]
    return json.dumps(
        {
            "pattern": {"panels": {"left": panel(-1.1 * _HALF), "right": panel(1.1 * _HALF)}, "stitches": [stitch]},
            "properties": {"units_in_meter": 1, "curvature_coords": "relative"},
        }
    )
