"""One dial between speed and accuracy: what stands behind `quality` and `tolerance`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cloth_core.errors import SceneError

__all__ = ["EXPECTED_ERROR_SOURCE", "QUALITIES", "Settings", "settings_for"]

# Particle spacing [m] of each quality.
QUALITIES = {"draft": 0.025, "normal": 0.015, "fine": 0.010}

# Distance of the resting drape from that at 10 mm spacing, RMS over points of both surfaces, both ways [m]: built-in
# T-shirt in cotton poplin on the young body. Draft takes the figure of 30 mm; nothing finer than 10 mm is measured yet.
EXPECTED_ERROR = {"draft": 0.0097, "normal": 0.0071}
EXPECTED_ERROR_SOURCE = "RMS distance to the drape at 10 mm spacing, built-in T-shirt on the young body"


@dataclass(frozen=True)
class Settings:
    """Numerical settings of a run.

    Attributes:
        spacing: particle spacing [m].
        tolerance: largest error asked for [m], if one was.
        expected_error: what this spacing is measured to differ from a fine one [m], None where nothing is measured.
        time_step: [s]; None takes `safety` times the stable one. A longer one than that is cut into sub-steps.
        safety: share of the stable time step that is used.
        contact_offset: distance at which cloth is held from the body's surface [m] (the trade's skin offset).
        cloth_offset: distance at which layers of cloth are held apart [m].
        push_speed: fastest way out for cloth that lies nearer than the offset [m/s].
        closing_time: time within which the seams are drawn together [s].
        sewing_time: after this time seams that are still farther open than merge_distance are given up [s].
        seam_tolerance: a seam narrower than this is closed [m].
        merge_distance: a seam that a tight garment holds open by less than this is closed by merging its points [m].
        rest_displacement, rest_window: at rest when no particle moves farther than this [m] within this time [s].
        max_time: longest drape [s].
        settle_drag: air drag [1/s] while a run only looks for the resting shape.
    """

    spacing: float = QUALITIES["normal"]
    tolerance: float | None = None
    expected_error: float | None = None
    time_step: float | None = None
    safety: float = 0.9
    contact_offset: float = 0.003
    cloth_offset: float = 0.001
    push_speed: float = 0.5
    closing_time: float = 0.8
    sewing_time: float = 3.0
    seam_tolerance: float = 0.001
    merge_distance: float = 0.01
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
    """Settings of a quality, or the coarsest ones measured to meet a tolerance [m]; the finest if none does.

    Raises:
        SceneError: unknown quality, or a tolerance that is not positive.
    """
    if quality not in QUALITIES:
        raise SceneError(f"quality '{quality}': not known; use one of {', '.join(QUALITIES)}")
    if tolerance is not None:
        if not (math.isfinite(tolerance) and tolerance > 0.0):
            raise SceneError(f"tolerance: {tolerance!r} m is not a positive length; give one in metres")
        quality = next((name for name, error in EXPECTED_ERROR.items() if error <= tolerance), "fine")
    return Settings(QUALITIES[quality], tolerance, EXPECTED_ERROR.get(quality))
