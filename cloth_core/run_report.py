"""Measures the state of a run: the report, and the description before anything has run."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.body_crossings import BodyCrossings
from cloth_core.intersections import self_crossing_edges
from cloth_core.motion import Motion
from cloth_core.penetration import max_penetration
from cloth_core.report import Report
from cloth_core.sewing import seam_gaps
from cloth_core.springs import SpringFamily, spring_strains
from cloth_core.switched_off import missed_effects
from cloth_core.term_cost import term_costs
from cloth_core.term_shares import term_shares

__all__ = ["RunState", "description_of", "hash_of", "report_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RunState:
    """What there is to measure of a run.

    Attributes:
        motion: of the model's particles.
        positions: in the unsewn numbering, (n, 3) [m].
        phase: of the run.
    """

    motion: Motion
    positions: Floats
    phase: str


def report_of(
    state: RunState,
    *,
    wall_time: float,
    settled: bool,
    rest_reason: str,
    open_seams: Sequence[str],
    time_not_stepped: float,
    warnings: Iterable[str],
) -> Report:
    """The report on a run in that state (`Report` says what the numbers are); exact triangle tests included."""
    motion = state.motion
    scene, model, x = motion.scene, motion.model, motion.x
    strain = spring_strains(x, model.springs)
    structural = strain[model.springs.family == SpringFamily.STRUCTURAL]
    shear = strain[model.springs.family == SpringFamily.SHEAR]
    gaps = seam_gaps(scene.garment, state.positions)
    lines = [*scene.warnings, *warnings]
    max_strain = float(structural.max(initial=0.0))
    if max_strain > scene.fabric.strain_limit:
        lines.append(
            f"strain {100 * max_strain:.1f} % is above the fabric's limit of {100 * scene.fabric.strain_limit:g} "
            "%; the garment is too tight or the fabric too soft"
        )
    through_body, through_cloth, penetration = 0, 0, 0.0
    if scene.body is not None:
        body = scene.body
        crossings = BodyCrossings.of(x, model.triangles, body)
        through_body, through_cloth = crossings.cloth_sides_through_body, crossings.body_sides_through_cloth
        penetration = max_penetration(x, model.triangles, body, crossings)
    missed = _missed(state)
    lines += missed.values()
    return Report(
        garment=scene.garment.name,
        body=scene.body.name if scene.body is not None else None,
        fabric=scene.fabric.name,
        particles=model.particle_count,
        triangles=len(model.triangles),
        springs=len(model.springs),
        terms=_term_facts(state, missed),
        time_step=motion.time_step,
        stable_time_step=motion.stable.time_step,
        steps=motion.steps,
        simulated_time=motion.time,
        wall_time=wall_time,
        settled=settled,
        rest_reason=rest_reason,
        max_strain=max_strain,
        mean_strain=float(np.abs(structural).mean()) if len(structural) else 0.0,
        max_shear_strain=float(shear.max(initial=0.0)),
        strain_limit=scene.fabric.strain_limit,
        max_seam_gap=max(gaps.values(), default=0.0),
        open_seams={name: gaps[name] for name in open_seams},
        body_intersections=through_body,
        body_edges_through_cloth=through_cloth,
        self_intersections=len(self_crossing_edges(x, model.triangles)),
        max_penetration=penetration,
        contact_searches=motion.searches,
        expected_error=scene.settings.expected_error,
        expected_error_source=scene.settings.expected_error_source,
        warnings=tuple(dict.fromkeys(lines)),
        state_sha256=hash_of(motion.x, motion.v),
        time_not_stepped=time_not_stepped,
        particles_asleep=int(motion.asleep.sum()),
    )


def description_of(state: RunState) -> dict[str, Any]:
    """Terms with reasons and measured shares, counts and the stable time step, as JSON types."""
    motion = state.motion
    scene, model, stable = motion.scene, motion.model, motion.stable
    missed = _missed(state)
    return {
        "garment": scene.garment.name,
        "body": scene.body.name if scene.body is not None else None,
        "fabric": scene.fabric.name,
        "spacing": scene.settings.spacing,
        "expected_error": scene.settings.expected_error,
        "expected_error_source": scene.settings.expected_error_source,
        "particles": model.particle_count,
        "particles_asleep": int(motion.asleep.sum()),
        "triangles": len(model.triangles),
        "springs": len(model.springs),
        "panels": list(scene.garment.panel_names),
        "seams": len(scene.garment.seams),
        "area": float(scene.garment.areas.sum()),
        "mass": float(model.mass.sum()),
        "terms": _term_facts(state, missed),
        "time_step": motion.time_step,
        "stable_time_step": stable.time_step if math.isfinite(stable.time_step) else None,
        "largest_frequency": stable.largest_frequency,
        "damping_ratio": stable.damping_ratio if math.isfinite(stable.damping_ratio) else None,
        "phase": state.phase,
        "simulated_time": motion.time,
        "warnings": [*scene.warnings, *missed.values()],
    }


def hash_of(x: Floats, v: Floats) -> str:
    """SHA-256 of positions and velocities, (k, 3) each, as little-endian float64."""
    data = np.ascontiguousarray(np.concatenate([x, v]), dtype="<f8")
    return hashlib.sha256(data.tobytes()).hexdigest()


def _missed(state: RunState) -> dict[str, str]:
    motion = state.motion
    return missed_effects(motion.scene, motion.model, motion.x, motion.v, state.positions)


def _term_facts(state: RunState, missed: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Each term with why it is on or off, and what it takes at the present state."""
    m = state.motion
    costs = term_costs(m.x, m.v, m.terms, m.contact_settings, m.contacts, m.time_step)
    shares = term_shares(m.model.terms, costs)
    cloth = m.model.contact.cloth if m.model.contact is not None else None
    reasons = {t.name: t.reason for t in m.model.terms}
    if cloth is not None and cloth.smooth is not None:
        smooth = int((cloth.smooth.room_of_triangles() > 0.0).sum())
        reasons["self contact"] += f"; {smooth} triangles are too smooth now to touch what is around them"
    return {
        t.name: {
            "active": t.active,
            "reason": reasons[t.name],
            "elements": t.elements,
            **shares[t.name],
            "missed": missed.get(t.name),
        }
        for t in m.model.terms
    }
