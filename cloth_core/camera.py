"""The camera of a picture: a long lens that looks at the scene from a named side and is framed to fit.

World: metres, z up; bodies face -y, so the front view looks along +y and the body's left side is at +x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["LENS", "MARGIN", "VIEWS", "Camera"]

VIEWS = {
    "front": (0.0, 3.0),
    "back": (180.0, 3.0),
    "left": (90.0, 3.0),
    "right": (270.0, 3.0),
    "three_quarter": (35.0, 8.0),
}
"""Azimuth [deg] from -y, counter-clockwise seen from above, and elevation [deg] of the camera. "left" is the body's
left side, +x."""

LENS = 8.0
"""Distance from the camera to the middle of the picture in half-diagonals of the scene: hardly any perspective."""

MARGIN = 0.05
"""Share of the picture that stays free on each side."""


@dataclass(frozen=True)
class Camera:
    """Pinhole camera: p [m] falls on pixel `centre + scale (x, -y) / z` where x, y, z = axes (p - eye)."""

    eye: NDArray[np.float64]
    axes: NDArray[np.float64]
    """Rows right, up, forward: orthonormal, shape (3, 3)."""
    scale: float
    """Focal length [pixels]."""
    centre: tuple[float, float]
    """Pixel coordinates of the optical axis; (0, 0) is the outer corner of the top left pixel."""

    @classmethod
    def of_views(
        cls, views: Sequence[str], scene: NDArray[np.float64], frame: NDArray[np.float64], size: tuple[int, int]
    ) -> list[Camera]:
        """One camera per view at one scale: distances follow from `scene` (n, 3), and `frame` (k, 3) fills the size."""
        distance = LENS * max(float(np.linalg.norm(np.ptp(scene, axis=0))) / 2, 1e-6)
        cameras, middles, scales = [], [], []
        for view in views:
            azimuth, elevation = np.radians(VIEWS[view])
            right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
            level = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
            forward = np.cos(elevation) * level - np.sin(elevation) * np.array([0.0, 0.0, 1.0])
            eye = (frame.min(0) + frame.max(0)) / 2 - distance * forward
            camera = cls(eye, np.array([right, np.cross(right, forward), forward]), 1.0, (0.0, 0.0))
            low, high = (function(camera.project(frame), axis=0) for function in (np.min, np.max))
            cameras.append(camera)
            middles.append((low + high) / 2)
            scales.append(float(np.min((1 - 2 * MARGIN) * np.array(size) / np.maximum(high - low, 1e-9))))
        scale = min(scales)
        centres = [(size[0] / 2 - scale * float(x), size[1] / 2 - scale * float(y)) for x, y in middles]
        return [cls(c.eye, c.axes, scale, centre) for c, centre in zip(cameras, centres, strict=True)]

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixel coordinates (n, 2) of points [m] (n, 3) in front of the camera."""
        x, y, z = self.axes @ (np.asarray(points, dtype=np.float64) - self.eye).T
        z = np.maximum(z, 1e-6)
        return np.column_stack([x / z, -y / z]) * self.scale + self.centre

    def directions(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float32]:
        """Directions (n, 3), one metre deep, through pixel coordinates (n,)."""
        across = (np.asarray(x) - self.centre[0]) / self.scale
        down = (np.asarray(y) - self.centre[1]) / self.scale
        right, up, forward = self.axes
        return np.column_stack([across * right[k] - down * up[k] + forward[k] for k in range(3)]).astype(np.float32)

    def to_world(self, direction: Sequence[float]) -> NDArray[np.float32]:
        """Unit vector in the world of a direction (right, up, towards the viewer)."""
        world = np.asarray(direction) @ (self.axes * np.array([[1], [1], [-1]]))
        unit: NDArray[np.float32] = (world / np.linalg.norm(world)).astype(np.float32)
        return unit
