"""One dial between speed and accuracy: what stands behind `quality` and `tolerance`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cloth_core.errors import SceneError

__all__ = ["QUALITIES", "Settings", "settings_for"]

# Particle spacing [m] of each quality.
QUALITIES = {"draft": 0.025, "normal": 0.015, "fine": 0.010}


@dataclass(frozen=True)
class Settings:
    """Numerical settings of a run.

    Attributes:
        spacing: particle spacing [m].
        time_step: [s]; None takes `safety` times the stable one. A longer one than that is cut into sub-steps.
        safety: share of the stable time step that is used.
        contact_offset: distance at which cloth is held from the body's surface [m] (the trade's skin offset).
        push_speed: fastest way out for cloth that lies nearer than the offset [m/s].
        closing_time: time within which the seams are drawn together [s].
        sewing_time: after this time seams that are still open are given up [s].
        seam_tolerance: a seam narrower than this is closed [m].
        rest_displacement, rest_window: at rest when no particle moves farther than this [m] within this time [s].
        max_time: longest drape [s].
        settle_drag: air drag [1/s] while a run only looks for the resting shape.
    """

    spacing: float = QUALITIES["normal"]
    time_step: float | None = None
    safety: float = 0.9
    contact_offset: float = 0.003
    push_speed: float = 0.5
    closing_time: float = 0.8
    sewing_time: float = 3.0
    seam_tolerance: float = 0.001
    rest_displacement: float = 0.0005
    rest_window: float = 0.1
    max_time: float = 20.0
    settle_drag: float = 4.0

    def __post_init__(self) -> None:
        for key, value in self.__dict__.items():
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise SceneError(f"settings, {key}: {value!r} is not a positive number; give one in SI units")
        if self.safety > 1.0:
            raise SceneError(f"settings, safety: {self.safety:g} is above 1, where no run is stable; use at most 1")


def settings_for(quality: str = "normal", tolerance: float | None = None) -> Settings:
    """Settings of a quality, or the coarsest ones expected to meet a tolerance [m].

    Raises:
        SceneError: unknown quality, or a tolerance that no setting meets.
    """
    if quality not in QUALITIES:
        raise SceneError(f"quality '{quality}': not known; use one of {', '.join(QUALITIES)}")
    if tolerance is None:
        return Settings(spacing=QUALITIES[quality])
    raise SceneError(f"tolerance {1000 * tolerance:g} mm: not calibrated")
