"""Messages of one run of the simulator: its clock, and its meshes as markers."""

import numpy as np
import numpy.typing as npt

from cloth_sim_ros.deferred_message import DeferredMessage
from cloth_sim_ros.messages import NANOSECONDS, Color, MarkerEncoder

__all__ = ["BODY_COLOR", "GARMENT_COLOR", "RunMessages"]

GARMENT_COLOR: Color = (0.20, 0.42, 0.65, 1.0)
BODY_COLOR: Color = (0.80, 0.70, 0.62, 1.0)


class RunMessages:
    """Stamps and encodes what a run sends.

    The stamp of a message is the wall time at which the run started plus the simulated time, so that viewers neither
    show 1970 nor stretch the motion.

    Args:
        start: wall time at which the run starts [ns since 1970]
        frame_id: the coordinate frame of everything [m, z up]
        garment_color: red, green, blue, alpha from 0 to 1
        body_color: likewise
    """

    def __init__(
        self,
        start: int,
        frame_id: str,
        *,
        garment_color: Color = GARMENT_COLOR,
        body_color: Color = BODY_COLOR,
    ) -> None:
        self.start = start
        self._garment = MarkerEncoder(frame_id, "garment", 0, garment_color)
        self._body = MarkerEncoder(frame_id, "body", 0, body_color)

    def stamp(self, simulated_time: float) -> int:
        """Nanoseconds since 1970 at `simulated_time` [s] of this run."""
        return self.start + round(simulated_time * NANOSECONDS)

    def garment(
        self, simulated_time: float, positions: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]
    ) -> bytes:
        """Marker of the garment with positions [m], (n, 3), and triangles (m, 3) at `simulated_time` [s]."""
        return self._garment.encode(self.stamp(simulated_time), positions, triangles)

    def deferred_garment(
        self, simulated_time: float, positions: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]
    ) -> DeferredMessage:
        """The same, encoded when it is needed: nobody may change the two arrays from now on."""
        stamp = self.stamp(simulated_time)
        size = self._garment.size(len(triangles))
        return DeferredMessage(size, lambda: self._garment.encode(stamp, positions, triangles))

    def body(
        self, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32], simulated_time: float = 0.0
    ) -> bytes:
        """Marker of the body with vertices [m], (n, 3), and triangles (m, 3) at `simulated_time` [s]."""
        return self._body.encode(self.stamp(simulated_time), vertices, triangles)
