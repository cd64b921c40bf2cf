"""What is simulated, as plain data: garments, fabric, body, pins, gravity, air, settings. Nothing here runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.calibration import Cloth
from cloth_core.crossed_start import crossed_start_warnings
from cloth_core.errors import SceneError
from cloth_core.fabric import Fabric
from cloth_core.fitting_height import fitting_lift, lifted
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.pattern_layers import layers_of
from cloth_core.placement import below_body_warnings
from cloth_core.quality import Settings, settings_for, with_expected_error
from cloth_core.start_around_body import started_around
from cloth_core.switched_off import check_without

__all__ = ["Scene"]

STANDARD_GRAVITY = 9.80665  # m/s^2
# How far each particle of a disturbed start is from its place [m].
_DISTURBANCE = 1e-4
# Farthest coordinate [m]: double precision has steps of 2 nm there.
_FARTHEST = 1e7


@dataclass(frozen=True)
class Scene:
    """A garment in its surroundings.

    Attributes:
        garment: particles, triangles and seams; its start positions are clear of the body.
        fabric: what it is made of.
        body: what it collides with, or None.
        pins: particles (unsewn numbering) that are held where they start, shape (p,).
        gravity: [m/s^2], shape (3,).
        air_drag: k_a [1/s].
        settings: spacing, time step, contact, rest.
        without: names of terms that are switched off by hand; a report says what the run lacks for want of them.
        worn: the patterns that it was built from, if any, innermost first.
        lifts: how far each of them starts above where the pattern puts it [m].
        seed: with which the start was disturbed (`disturbed`); 0 if it was not.
        warnings: one line each.
    """

    garment: Garment
    fabric: Fabric
    body: Body | None = None
    pins: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    gravity: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    air_drag: float = 1.0
    settings: Settings = field(default_factory=Settings)
    without: tuple[str, ...] = ()
    worn: tuple[Pattern, ...] = ()
    lifts: tuple[float, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        if len(self.gravity) != 3 or not all(math.isfinite(g) for g in self.gravity):
            raise SceneError(f"gravity: {self.gravity!r} is not three finite numbers; give m/s^2, z up")
        if not (math.isfinite(self.air_drag) and self.air_drag >= 0.0):
            raise SceneError(f"air drag: {self.air_drag!r} is not a number of at least 0; give it in 1/s")
        check_without(self.without)
        _check_places(self.garment)
        pins = np.asarray(self.pins)
        if pins.size and (pins.min() < 0 or pins.max() >= self.garment.particle_count):
            wrong = int(pins[(pins < 0) | (pins >= self.garment.particle_count)][0])
            raise SceneError(f"pins: particle {wrong} does not exist, there are {self.garment.particle_count}")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know before the run, one line each."""
        settings = self.settings
        lines: tuple[str, ...] = ()
        if settings.tolerance is not None and (settings.expected_error or math.inf) > settings.tolerance * (1.0 + 1e-9):
            lines = (
                f"tolerance {1000 * settings.tolerance:g} mm: finer than any setting is measured to reach; the finest, "
                f"{1000 * settings.spacing:g} mm, is taken without a promise",
            )
        return lines + (self.body.warnings if self.body else ()) + self.garment.warnings + self._crossed_start

    @cached_property
    def _crossed_start(self) -> tuple[str, ...]:
        return crossed_start_warnings(self.garment)

    @classmethod
    def build(
        cls,
        patterns: Pattern | Sequence[Pattern],
        body: Body | None = None,
        fabric: Fabric | None = None,
        *,
        quality: str = "normal",
        tolerance: float | None = None,
        settings: Settings | None = None,
        gravity: float = STANDARD_GRAVITY,
        air_drag: float = 1.0,
        pins: Sequence[int] = (),
        without: Sequence[str] = (),
        lifts: Sequence[float] | None = None,
    ) -> Scene:
        """Discretise patterns and put them around a body.

        Args:
            patterns: one or several, the innermost garment first; all their panels become one scene.
            body: what they are draped on.
            fabric: cotton poplin if none is given.
            quality: draft, normal or fine; ignored when settings are given.
            tolerance: largest error [m]; ignored when settings are given.
            settings: all numerical settings by hand.
            gravity: downward [m/s^2].
            air_drag: k_a [1/s].
            pins: particles that are held, unsewn numbering.
            without: names of terms to switch off.
            lifts: how far each garment starts above where its pattern puts it [m], the innermost first; if none are
                given, as far as is needed to sew it around the body, and not at all with pins or without a body.

        Raises:
            ClothError: anything that does not fit together.
        """
        one = [patterns] if isinstance(patterns, Pattern) else list(patterns)
        if not one:
            raise SceneError("scene: there is no pattern; give at least one")
        worn = layers_of(one)
        fabric = Fabric.preset("cotton_poplin") if fabric is None else fabric
        cloth = Cloth.of(sum(pattern.area for pattern in worn), fabric)
        chosen = settings_for(quality, tolerance, cloth) if settings is None else with_expected_error(settings, cloth)
        garments = [Garment.from_pattern(p, chosen.spacing) for p in worn]
        garment = Garment.joined(garments)
        if body is not None:
            _check_scale(garment, body)
        if lifts is None:
            lifts = [0.0 if body is None or len(pins) else fitting_lift(p, body, chosen.contact_offset) for p in worn]
        garment = lifted(garment, worn, lifts, body)
        if body is not None:
            garment = replace(garment, warnings=garment.warnings + below_body_warnings(garment, body))
        garment = started_around(garment, body, chosen.contact_offset)
        return cls(
            garment=garment,
            fabric=fabric,
            body=body,
            pins=np.unique(np.asarray(pins, dtype=np.int32)),
            gravity=(0.0, 0.0, -gravity),
            air_drag=air_drag,
            settings=chosen,
            without=tuple(without),
            worn=tuple(worn),
            lifts=tuple(float(lift) for lift in lifts),
        )

    @property
    def closing_time(self) -> float:
        """Time within which the seams of all garments are drawn together, one garment after the other [s]."""
        return self.garment.layer_count * self.settings.closing_time

    @property
    def sewing_time(self) -> float:
        """After this time seams that are still open are given up [s]."""
        return self.closing_time - self.settings.closing_time + self.settings.sewing_time

    def with_spacing(self, spacing: float) -> Scene:
        """The same scene at another particle spacing [m]; only for one that was built from patterns, without pins.

        Raises:
            ClothError: a panel cannot be meshed or placed at that spacing.
        """
        scene = Scene.build(
            self.worn, self.body, self.fabric, settings=replace(self.settings, spacing=spacing),
            gravity=-self.gravity[2], air_drag=self.air_drag, without=self.without, lifts=self.lifts,
        )  # fmt: skip
        return scene.disturbed(self.seed)

    def with_body(self, body: Body | None) -> Scene:
        """The same scene around another body; what has been checked is not checked again."""
        scene = copy(self)
        object.__setattr__(scene, "body", body)
        return scene

    def disturbed(self, seed: int) -> Scene:
        """The same scene with each particle 0.1 mm off its start, in a direction drawn with seed; 0 for nothing."""
        if seed <= 0:
            return self
        way = np.random.default_rng(seed).standard_normal(self.garment.start.shape)
        way *= _DISTURBANCE / np.linalg.norm(way, axis=1, keepdims=True)
        return replace(self, garment=replace(self.garment, start=self.garment.start + way), seed=seed)


def _check_places(garment: Garment) -> None:
    """Refuse a particle whose place is no number, or so far away that rounding would be seen."""
    for what, places in (("start", garment.start), ("rest", garment.rest)):
        wrong = np.flatnonzero(~(np.abs(places) <= _FARTHEST).all(axis=1))
        if len(wrong):
            where = garment.panel_names[garment.panel_of_particle[wrong[0]]]
            raise SceneError(
                f"panel '{where}', particle {wrong[0]}: its {what} position {places[wrong[0]].tolist()} is not within "
                f"{_FARTHEST:g} m of the origin; mend the pattern or move the scene"
            )


def _check_scale(garment: Garment, body: Body) -> None:
    """Refuse a garment and a body of which one was probably given in another unit."""
    size = float(np.ptp(garment.start, axis=0).max())
    body_size = float(np.ptp(body.vertices, axis=0).max())
    ratio = size / body_size
    if 1.0 / 30.0 < ratio < 30.0:
        return
    too_large, factor = ("garment", ratio) if ratio > 1.0 else (f"body '{body.name}'", 1.0 / ratio)
    unit = "millimetres" if factor > 300.0 else "centimetres"
    raise SceneError(
        f"scale: the garment is {size:.3g} m and body '{body.name}' {body_size:.3g} m large; "
        f"the {too_large} was probably given in {unit} and taken for metres; convert it"
    )
