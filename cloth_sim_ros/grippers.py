"""Grippers as the node's users see them: a name, the last pose that was sent, and the cloth around it."""

import threading

import numpy as np
import numpy.typing as npt

from cloth_core.errors import SceneError
from cloth_core.grasp import Pose

__all__ = ["Grippers", "particles_near"]


class Grippers:
    """Last poses of all grippers; any thread may call."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._poses: dict[str, Pose] = {}
        self._moved: dict[str, Pose] = {}

    def set_pose(self, name: str, pose: Pose) -> bool:
        """Notes where a gripper is; false if it is there already."""
        with self._lock:
            if self._poses.get(name) == pose:
                return False
            self._poses[name] = self._moved[name] = pose
            return True

    def pose(self, name: str) -> Pose:
        """Where a gripper is.

        Raises:
            SceneError: nobody has said so yet.
        """
        pose = self._poses.get(name)
        if pose is None:
            raise SceneError(f"{name}: its pose is not known; publish ~/{name}/pose first")
        return pose

    def take_moved(self) -> dict[str, Pose]:
        """Those that have moved since the last call, with their last poses."""
        with self._lock:
            moved, self._moved = self._moved, {}
        return moved


def particles_near(name: str, pose: Pose, positions: npt.NDArray[np.float64], radius: float) -> npt.NDArray[np.int32]:
    """Particles of positions [m], (n, 3), within `radius` [m] of a gripper's pose.

    Raises:
        SceneError: there is none; says how far away the nearest one is.
    """
    distance = np.sqrt(((positions - pose.position) ** 2).sum(axis=1))
    chosen = np.flatnonzero(distance <= radius).astype(np.int32)
    if len(chosen) == 0:
        raise SceneError(
            f"{name}: no cloth within grasp_radius = {radius:g} m of it, the nearest is {distance.min():.3g} m away; "
            "move it nearer or raise the parameter"
        )
    return chosen
