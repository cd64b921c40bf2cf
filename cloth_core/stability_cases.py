"""The extremes over which the predicted stable time step is held to the measured one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from cloth_core.blow_up import BlowUp, measure_blow_up
from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.model import Model
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene

__all__ = ["StabilityCase", "stability_cases"]

_WIDTH = 0.2  # of the sheets [m]


@dataclass(frozen=True)
class StabilityCase:
    """One point of the map.

    Attributes:
        group: what is varied, with its unit.
        value: of what is varied; the case's number within the group where nothing is.
        name: for tables.
        run: does the experiment.
    """

    group: str
    value: float
    name: str
    run: Callable[[], BlowUp]


def stability_cases(quick: bool = False) -> list[StabilityCase]:
    """All cases, the dearest last; `quick` leaves out every other one and the finest sheets."""
    cases = [
        *_stiffnesses((1e-3, 1.0, 1e3, 1e8) if quick else tuple(10.0**e for e in range(-3, 9))),
        *_mass_ratios((1.0, 1e3, 1e6) if quick else tuple(10.0**e for e in range(7))),
        *_damping_ratios((0.0, 0.5, 10.0) if quick else (0.0, 0.05, 0.2, 0.5, 1.0, 3.0, 10.0, 100.0)),
        *_slivers((1.0, 1e2, 1e4) if quick else (1.0, 10.0, 1e2, 1e3, 1e4)),
        *_single_terms(),
        *_together(),
        *_drawn(8 if quick else 40),
        *_resolutions((2, 10, 50) if quick else (2, 3, 5, 10, 20, 50, 100, 200, 500)),
    ]
    return cases


def _fabric(**changes: float) -> Fabric:
    """A fabric without damping; a case adds what it is about."""
    values: dict[str, Any] = {
        "area_density": 0.2, "structural_warp": 400.0, "structural_weft": 400.0, "shear": 100.0, "bending": 0.0,
        "damping_time": 0.0, "bending_damping_time": 0.0, "friction": 0.0, "strain_limit": 10.0,
    }  # fmt: skip
    return Fabric(name="plain", **(values | changes))


def _sheet(width: float, height: float, spacing: float, z: float = 0.0) -> Garment:
    """A level sheet at height z [m]."""
    w, h = width / 2.0, height / 2.0
    panel = {
        "translation": [0, z, 0],
        "rotation": [-90, 0, 0],
        "vertices": [[-w, -h], [w, -h], [w, h], [-w, h]],
        "edges": [{"endpoints": [k, (k + 1) % 4]} for k in range(4)],
    }
    pattern = {
        "pattern": {"panels": {"sheet": panel}, "stitches": [], "panel_order": ["sheet"]},
        "properties": {"curvature_coords": "relative", "units_in_meter": 1},
    }
    return Garment.from_pattern(Pattern.from_json(json.dumps(pattern), "sheet"), spacing)


def _weightless(garment: Garment, fabric: Fabric, air_drag: float = 0.0) -> Scene:
    return Scene(garment=garment, fabric=fabric, gravity=(0.0, 0.0, 0.0), air_drag=air_drag)


def _stiffnesses(values: tuple[float, ...]) -> list[StabilityCase]:
    def case(k: float) -> StabilityCase:
        fabric = _fabric(structural_warp=k, structural_weft=k, shear=k / 4.0)
        return StabilityCase(
            "stiffness [N/m]", k, f"{k:g} N/m",
            lambda: measure_blow_up(_weightless(_sheet(_WIDTH, _WIDTH, 0.02), fabric)),
        )  # fmt: skip

    return [case(k) for k in values]


def _mass_ratios(values: tuple[float, ...]) -> list[StabilityCase]:
    def case(ratio: float) -> StabilityCase:
        def heavier(model: Model) -> None:
            model.mass[::2] *= ratio  # next to each other, as rows of an odd number of particles alternate
            model.inverse_mass = 1.0 / model.mass

        return StabilityCase(
            "mass ratio of neighbours", ratio, f"1 : {ratio:g}",
            lambda: measure_blow_up(_weightless(_sheet(_WIDTH, _WIDTH, 0.02), _fabric()), change=heavier),
        )  # fmt: skip

    return [case(ratio) for ratio in values]


def _damping_ratios(values: tuple[float, ...]) -> list[StabilityCase]:
    garment_spacing = 0.02

    def case(z: float) -> StabilityCase:
        def run() -> BlowUp:
            garment = _sheet(_WIDTH, _WIDTH, garment_spacing)
            plain = Model(_weightless(garment, _fabric()))
            w = plain.stable_step(garment.start, 0.0).largest_frequency
            return measure_blow_up(_weightless(garment, _fabric(damping_time=2.0 * z / w)))

        return StabilityCase("damping ratio of the stiffest mode", z, f"z = {z:g}", run)

    return [case(z) for z in values]


def _slivers(values: tuple[float, ...]) -> list[StabilityCase]:
    def case(aspect: float) -> StabilityCase:
        cell = 0.05
        fabric = _fabric(bending=1e-5)
        return StabilityCase(
            "aspect of the triangles", aspect, f"1 : {aspect:g}",
            lambda: measure_blow_up(_weightless(_sheet(4.0 * cell, cell / aspect, cell), fabric)),
        )  # fmt: skip

    return [case(aspect) for aspect in values]


def _resolutions(values: tuple[int, ...]) -> list[StabilityCase]:
    def case(n: int) -> StabilityCase:
        # Few steps are enough for a large sheet: the trials start from the limiting mode.
        return StabilityCase(
            "particles along a side", float(n), f"{n} x {n}",
            lambda: measure_blow_up(
                _weightless(_sheet(_WIDTH, _WIDTH, _WIDTH / (n - 1)), _fabric(bending=1e-6, damping_time=1e-6)),
                steps=1500 if n <= 50 else 400 if n <= 200 else 160,
            ),
        )  # fmt: skip

    return [case(n) for n in values]


def _single_terms() -> list[StabilityCase]:
    nothing = {"structural_warp": 1e-3, "structural_weft": 1e-3, "shear": 0.0}
    alone: dict[str, tuple[Fabric, float]] = {
        "structural springs": (_fabric(shear=0.0), 0.0),
        "shear of cells": (_fabric(**(nothing | {"shear": 100.0})), 0.0),
        "shear springs": (_fabric(**(nothing | {"shear_spring": 100.0})), 0.0),
        "bending springs": (_fabric(**nothing, bending_spring=50.0), 0.0),
        "true bending": (_fabric(**nothing, bending=1e-3), 0.0),
        "spring damping": (_fabric(damping_time=0.1), 0.0),
        "bending damping": (_fabric(**nothing, bending=1e-4, bending_damping_time=0.5), 0.0),
        "air drag": (_fabric(**nothing), 1e3),
    }
    cases = [
        StabilityCase(
            "one term alone", float(k), name,
            lambda fabric=fabric, drag=drag: measure_blow_up(  # type: ignore[misc]
                _weightless(_sheet(_WIDTH, _WIDTH, 0.02), fabric, drag)
            ),
        )
        for k, (name, (fabric, drag)) in enumerate(alone.items())
    ]  # fmt: skip
    cases.append(
        StabilityCase(
            "one term alone", float(len(alone)), "seams that close",
            lambda: measure_blow_up(_halves(_fabric(damping_time=1e-4))),
        )
    )  # fmt: skip
    return cases


def _drawn(count: int) -> list[StabilityCase]:
    """Sheets whose stiffness, damping, masses, cells and drag are all drawn at random, each over its whole range."""

    def case(number: int) -> StabilityCase:
        rng = np.random.default_rng(number)

        def between(low: float, high: float) -> float:
            return float(np.exp(rng.uniform(np.log(low), np.log(high))))

        cells, cell, aspect = rng.integers(1, 12, 2), between(1e-3, 0.1), between(0.1, 10.0)
        k = between(1e-3, 1e8)
        fabric = _fabric(
            area_density=between(5e-3, 2.0), structural_warp=k, structural_weft=between(max(1e-3, 0.1 * k), k),
            shear=k * between(1e-3, 1.0), bending=between(1e-8, 1e-3), bending_spring=k * between(1e-4, 1e-1),
            damping_time=between(1e-8, 1e-1), bending_damping_time=between(1e-6, 1e-1),
        )  # fmt: skip
        drag, ratio = between(1e-2, 1e3), between(1.0, 1e6)

        def uneven(model: Model) -> None:
            model.mass *= np.exp(rng.uniform(0.0, np.log(ratio), len(model.mass)))
            model.inverse_mass = 1.0 / model.mass

        garment = _sheet(float(cells[0] * cell), float(cells[1] * cell / aspect), cell)
        name = f"no. {number}: {k:.2g} N/m, tau {fabric.damping_time:.2g} s, masses 1 : {ratio:.2g}"
        return StabilityCase(
            "all drawn at random", float(number), name,
            lambda: measure_blow_up(_weightless(garment, fabric, drag), change=uneven),
        )  # fmt: skip

    return [case(number) for number in range(count)]


def _halves(fabric: Fabric) -> Scene:
    """Two sheets edge to edge, still to be sewn together: every seam spring is at its own length, nothing."""
    panels = {
        name: {
            "translation": [x, 0, 0],
            "rotation": [0, 0, 0],
            "vertices": [[-0.05, -0.06], [0.05, -0.06], [0.05, 0.06], [-0.05, 0.06]],
            "edges": [{"endpoints": [k, (k + 1) % 4]} for k in range(4)],
        }
        for name, x in (("left", -0.05), ("right", 0.05))
    }
    pattern = {
        "pattern": {
            "panels": panels,
            "stitches": [[{"panel": "left", "edge": 1}, {"panel": "right", "edge": 3}]],
            "panel_order": list(panels),
        },
        "properties": {"curvature_coords": "relative", "units_in_meter": 1},
    }
    garment = Garment.from_pattern(Pattern.from_json(json.dumps(pattern), "halves"), 0.02)
    # The seam neither closes nor is given up while the trials last.
    settings = Settings(closing_time=1e9, sewing_time=1e9)
    return Scene(garment=garment, fabric=fabric, gravity=(0.0, 0.0, 0.0), air_drag=1.0, settings=settings)


def _together() -> list[StabilityCase]:
    poplin = Fabric.preset("cotton_poplin")

    def flat(fabric: Fabric) -> BlowUp:
        return measure_blow_up(_weightless(_sheet(_WIDTH, _WIDTH, 0.02), fabric, 1.0))

    def hung() -> BlowUp:
        garment = _sheet(_WIDTH, _WIDTH, 0.02)
        corners = np.flatnonzero((np.abs(garment.rest[:, 0]) > 0.099) & (garment.rest[:, 1] > 0.099))
        scene = Scene(garment=garment, fabric=poplin, pins=corners.astype(np.int32), air_drag=8.0)
        return measure_blow_up(scene, rest_first=2.0)

    def on_a_table(friction: float) -> BlowUp:
        box = trimesh.creation.box(extents=[1.0, 1.0, 0.2])
        body = Body.from_arrays(box.vertices - [0.0, 0.0, 0.1], box.faces, "table")
        fabric = Fabric.preset("cotton_poplin", friction=friction)
        return measure_blow_up(Scene(garment=_sheet(_WIDTH, _WIDTH, 0.02, 0.003), fabric=fabric, body=body))

    def over_an_edge(friction: float) -> BlowUp:
        box = trimesh.creation.box(extents=[0.14, 0.14, 0.2])
        body = Body.from_arrays(box.vertices - [0.0, 0.0, 0.1], box.faces, "block")
        fabric = Fabric.preset("cotton_poplin", friction=friction)
        scene = Scene(garment=_sheet(0.3, 0.3, 0.025, 0.004), fabric=fabric, body=body, air_drag=8.0)
        return measure_blow_up(scene, rest_first=1.5)

    def skirt_on_a_woman() -> BlowUp:
        settings = Settings(spacing=0.05)
        scene = Scene.build(Pattern.load("skirt"), Body.load("young"), poplin, settings=settings, air_drag=8.0)
        return measure_blow_up(scene, rest_first=3.0)

    rows: tuple[tuple[str, Callable[[], BlowUp]], ...] = (
        *(
            (f"{name}, flat", lambda name=name: flat(Fabric.preset(name)))
            for name in ("silk", "cotton_poplin", "denim", "leather")
        ),  # type: ignore[misc]
        ("cotton poplin, hung at two corners", hung),
        ("cotton poplin on a table, no friction", lambda: on_a_table(0.0)),
        ("cotton poplin draped over a block", lambda: over_an_edge(0.35)),
        ("skirt sewn and draped on a woman", skirt_on_a_woman),
    )
    return [StabilityCase("all terms together", float(k), name, run) for k, (name, run) in enumerate(rows)]
