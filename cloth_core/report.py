"""What a run did: the numbers that everything else quotes."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from typing import Any

__all__ = ["Report"]


@dataclass(frozen=True)
class Report:
    """Result of a run, SI units.

    Attributes:
        garment, body, fabric: names.
        particles: of the garment as it is now (merged at closed seams).
        triangles, springs: counts.
        terms: name -> {"active", "reason", "elements", "microseconds_per_step", "share" (of a step's time), "within"
            (the term in whose time it is counted), "missed" (what the run lacks without it, if it was switched off)}.
        time_step: last one used [s]; stable_time_step: the largest stable one at the end [s].
        steps: done; simulated_time: [s]; wall_time: [s], compilation included.
        settled: whether it is at rest; rest_reason: by which criterion, or why it ended without rest.
        max_strain: largest extension of a structural spring; mean_strain: mean magnitude over all of them.
        max_shear_strain: largest extension of a shear spring.
        expected_error: promised RMS distance to the reference drape of the source [m], null where nothing is measured.
        expected_error_source: where that expectation comes from.
        strain_limit: of the fabric; a larger max_strain gives a warning.
        max_seam_gap: largest distance of two points to be sewn [m].
        open_seams: the seams above the tolerance, with their gaps [m].
        body_intersections: cloth sides that cross a body triangle.
        body_edges_through_cloth: body sides that cross a cloth triangle, as those of a tip between the particles.
        self_intersections: cloth sides that cross a cloth triangle.
        max_penetration: depth of the deepest point of the cloth inside the body [m]; 0 if none is.
        contact_searches: how often contacts were searched.
        warnings: one line each.
        state_sha256: hash of the final positions and velocities.
        time_not_stepped: part of simulated_time in which nothing moved and nothing was computed [s].
        particles_asleep: how many lie so still, after a run to rest, that they are not stepped while others move.
        gate: verdict of GarmentCode's gate (`gate.judge`), null where it was not asked for.
    """

    garment: str
    body: str | None
    fabric: str
    particles: int
    triangles: int
    springs: int
    terms: dict[str, dict[str, Any]]
    time_step: float
    stable_time_step: float
    steps: int
    simulated_time: float
    wall_time: float
    settled: bool
    rest_reason: str
    max_strain: float
    mean_strain: float
    max_shear_strain: float
    strain_limit: float
    max_seam_gap: float
    open_seams: dict[str, float]
    body_intersections: int
    body_edges_through_cloth: int
    self_intersections: int
    max_penetration: float
    contact_searches: int
    expected_error: float | None
    expected_error_source: str
    warnings: tuple[str, ...] = field(default=())
    state_sha256: str = ""
    time_not_stepped: float = 0.0
    particles_asleep: int = 0
    gate: dict[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """All values as JSON types; a number that is not finite becomes null."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    def to_json(self) -> str:
        """Indented JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value
