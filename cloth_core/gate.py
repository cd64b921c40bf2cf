"""GarmentCode's gate for a good drape, with this simulator's own limits beside the published ones.

Korosteleva et al., "GarmentCodeData: A Dataset of 3D Made-to-Measure Garments With Sewing Patterns" (2024): a drape is
discarded if the simulation crashes, runs out of time, never becomes static, or ends with too many cloth edges through
the body or through the cloth. Seams are always closed there, because they are merged before the first step; here each
must have closed.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from cloth_core.report import Report
    from cloth_core.simulation import Simulation

__all__ = ["FRAME", "MOST_FRAMES", "MOST_WALL_TIME", "frame_movement", "judge"]

Floats = NDArray[np.float64]

FRAME = 1.0 / 60.0
"""Simulated time of one frame [s]."""
MOST_FRAMES = 2400
MOST_WALL_TIME = 600.0
"""[s]"""
STILL = 0.0003
"""A particle that moves farther than this in a frame is not static [m]."""
MOST_MOVING = 0.015
"""Share of the particles that may move farther, exclusive."""
MOST_BODY_INTERSECTIONS = 0
MOST_SELF_INTERSECTIONS = 0
MOST_OPEN_SEAMS = 0
GARMENTCODE_BODY_INTERSECTIONS = 35
GARMENTCODE_SELF_INTERSECTIONS = 300


def frame_movement(simulation: Simulation) -> Floats:
    """How far each particle moves in the next frame [m], (n,); on a copy, the simulation stays as it is.

    The copy moves as the simulation would under `advance`, without the extra air drag of `settle`.

    Raises:
        SimulationError: the state would no longer be finite.
    """
    scene = simulation.scene
    ahead = copy.deepcopy(simulation, {id(scene): scene})
    before = ahead.positions
    ahead.advance(FRAME)
    return np.asarray(np.sqrt(((ahead.positions - before) ** 2).sum(axis=1)))


def judge(report: Report, movement: Floats | None, failure: str | None = None) -> dict[str, Any]:
    """The gate's verdict as JSON types; what the report calls `gate`.

    Args:
        report: of the run.
        movement: of each particle in the frame after the end [m], see `frame_movement`; None if the run failed.
        failure: why the run could not go on, if it could not.

    Returns:
        `passed`; `failed`, one line for each criterion that is not met; `garmentcode_passed`, the same by the published
        limits; and under `criteria` the value of each with both limits.
    """
    moving = None
    if movement is not None:
        moving = float((movement > STILL).mean()) if len(movement) else 0.0
    share = "not known how many" if moving is None else f"{100 * moving:.2f} %"
    frames = report.simulated_time / FRAME
    body, cloth = report.body_intersections, report.self_intersections
    through = report.body_edges_through_cloth
    open_seams = ", ".join(f"{name} ({1000 * gap:.1f} mm)" for name, gap in report.open_seams.items())
    criteria = (
        _Criterion("crashes", int(failure is not None), 0, 0, f"crash: {failure}"),
        _Criterion(
            "frames", frames, MOST_FRAMES, MOST_FRAMES,
            f"time-out: {frames:.0f} frames of 1/60 s, at most {MOST_FRAMES} may pass",
        ),
        _Criterion(
            "wall_time", report.wall_time, MOST_WALL_TIME, MOST_WALL_TIME,
            f"time-out: {report.wall_time:.0f} s of wall time, at most {MOST_WALL_TIME:.0f} s may pass",
        ),
        _Criterion(
            "moving_share", moving, MOST_MOVING, MOST_MOVING,
            f"never static: {share} of the particles move more than {1000 * STILL:g} mm in a frame of 1/60 s, less "
            f"than {100 * MOST_MOVING:g} % may ({report.rest_reason})",
        ),
        _Criterion(
            "body_intersections", body, MOST_BODY_INTERSECTIONS, GARMENTCODE_BODY_INTERSECTIONS,
            f"{body} cloth edges cross the body, at most {MOST_BODY_INTERSECTIONS} may "
            f"(GarmentCode: {GARMENTCODE_BODY_INTERSECTIONS})",
        ),
        _Criterion(
            "body_edges_through_cloth", through, MOST_BODY_INTERSECTIONS, None,
            f"{through} edges of the body cross the cloth, at most {MOST_BODY_INTERSECTIONS} may",
        ),
        _Criterion(
            "self_intersections", cloth, MOST_SELF_INTERSECTIONS, GARMENTCODE_SELF_INTERSECTIONS,
            f"{cloth} cloth edges cross the cloth, at most {MOST_SELF_INTERSECTIONS} may "
            f"(GarmentCode: {GARMENTCODE_SELF_INTERSECTIONS})",
        ),
        _Criterion(
            "open_seams", len(report.open_seams), MOST_OPEN_SEAMS, None,
            f"seams still open: {open_seams}; check that the panels can reach each other around the body",
        ),
    )  # fmt: skip
    return {
        "passed": all(c.keeps(c.limit) for c in criteria),
        "failed": [c.line for c in criteria if not c.keeps(c.limit)],
        "garmentcode_passed": all(c.keeps(c.garmentcode_limit) for c in criteria),
        "criteria": {
            c.name: {
                "value": c.value,
                "limit": c.limit,
                "garmentcode_limit": c.garmentcode_limit,
                "passed": c.keeps(c.limit),
            }
            for c in criteria
        },
    }


class _Criterion(NamedTuple):
    """A measured value (None if there is none), the most that it may be here and there, and what to say otherwise.

    A limit of None is kept by everything.
    """

    name: str
    value: float | None
    limit: float
    garmentcode_limit: float | None
    line: str

    def keeps(self, limit: float | None) -> bool:
        if limit is None:
            return True
        if self.value is None:
            return False
        return self.value < limit if self.name == "moving_share" else self.value <= limit
