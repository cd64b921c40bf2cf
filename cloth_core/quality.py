"""One dial between speed and accuracy: what stands behind `quality` and `tolerance`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cloth_core.calibration import Cloth, calibration
from cloth_core.errors import SceneError

__all__ = ["INTEGRATORS", "NOT_MEASURED", "QUALITIES", "Settings", "settings_for", "with_expected_error"]

# Particle spacing [m] of each quality.
QUALITIES = {"draft": 0.025, "normal": 0.015, "fine": 0.010}

INTEGRATORS = ("symplectic", "implicit")

NOT_MEASURED = "not measured at these settings"

# What a calibrated setting may differ in from the default ones: the resting drape does not depend on it.
_FREE = ("spacing", "tolerance", "expected_error", "expected_error_source", "max_time")


@dataclass(frozen=True)
class Settings:
    """Numerical settings of a run.

    Attributes:
        spacing: particle spacing [m].
        tolerance: largest error asked for [m], if one was.
        expected_error: promised RMS distance to the reference drape of the source [m], None where nothing is measured.
        expected_error_source: where that promise comes from.
        integrator: "symplectic" (Euler, explicit), or "implicit" for cloth that is very stiff (docs/integrators.md).
        time_step: [s]; None takes `safety` times the stable one, for implicit steps 1/120 s, with a body 1/500 s.
            A longer symplectic step than that is cut into sub-steps.
        safety: share of the stable time step that is used.
        contact_offset: distance at which cloth is held from the body's surface [m] (the trade's skin offset).
        cloth_offset: distance at which layers of cloth are held apart [m].
        push_speed: fastest way out for cloth that lies nearer than the offset [m/s].
        closing_time: time within which the seams of one garment are drawn together [s]; of several one after the other.
        sewing_time: after this time seams that are still farther open than merge_distance are given up [s]; for each
            garment that is worn over another, the closing time is added.
        seam_tolerance: a seam narrower than this is closed [m].
        merge_distance: a seam that a tight garment holds open by less than this is closed by merging its points [m].
        rest_displacement, rest_window: at rest when no particle moves farther than this [m] within this time [s].
        max_time: longest drape [s].
        settle_drag: air drag [1/s] while a run only looks for the resting shape.
    """

    spacing: float = QUALITIES["normal"]
    tolerance: float | None = None
    expected_error: float | None = None
    expected_error_source: str = NOT_MEASURED
    integrator: str = INTEGRATORS[0]
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
    settle_drag: float = 2.0

    def __post_init__(self) -> None:
        for key, value in self.__dict__.items():
            if value is None or isinstance(value, str):
                continue
            if not (math.isfinite(value) and value > 0.0):
                raise SceneError(f"settings, {key}: {value!r} is not a positive number; give one in SI units")
        if self.integrator not in INTEGRATORS:
            raise SceneError(
                f"settings, integrator: {self.integrator!r} is not known; use one of {', '.join(INTEGRATORS)}"
            )
        if self.safety > 1.0:
            raise SceneError(f"settings, safety: {self.safety:g} is above 1, where no run is stable; use at most 1")


def settings_for(quality: str = "normal", tolerance: float | None = None, cloth: Cloth | None = None) -> Settings:
    """Settings of a quality, or the coarsest ones promised to meet a tolerance [m]; the finest if none is.

    Args:
        quality: draft, normal or fine.
        tolerance: largest error [m], in place of the quality.
        cloth: what it is for; without it the least favourable of all that is calibrated.

    Raises:
        SceneError: unknown quality, or a tolerance that is not positive.
    """
    if quality not in QUALITIES:
        raise SceneError(f"quality '{quality}': not known; use one of {', '.join(QUALITIES)}")
    spacing = QUALITIES[quality]
    if tolerance is not None:
        if not (math.isfinite(tolerance) and tolerance > 0.0):
            raise SceneError(f"tolerance: {tolerance!r} m is not a positive length; give one in metres")
        spacing = calibration().spacing(tolerance, cloth) or min(QUALITIES.values())
    return with_expected_error(Settings(spacing, tolerance), cloth)


def with_expected_error(settings: Settings, cloth: Cloth | None = None) -> Settings:
    """The settings with what is promised for them; nothing is where they differ from those that were calibrated."""
    plain = replace(Settings(), **{key: getattr(settings, key) for key in _FREE})
    promise = calibration().promise(settings.spacing, cloth) if settings == plain else None
    source = NOT_MEASURED if promise is None else calibration().source
    return replace(settings, expected_error=promise, expected_error_source=source)
