"""The arrays and the terms that a scene needs, and no others; and the time step that they allow."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cloth_core.bending import Bending, build_bending
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.contact_state import ContactSettings
from cloth_core.errors import SceneError
from cloth_core.garment import Seam, merged_numbers, renumbered
from cloth_core.runs import find_runs
from cloth_core.scene import Scene
from cloth_core.self_contact import SelfContact
from cloth_core.sewing import SeamPull, build_seam_pull, renumbered_pull
from cloth_core.springs import SpringFamily, Springs, build_springs
from cloth_core.stability import StableStep, stable_time_step
from cloth_core.step import ForceTerms
from cloth_core.stiffness_product import StiffnessProduct, StiffnessTerms, spring_rows
from cloth_core.strain_limit import build_strain_limit, no_strain_limit
from cloth_core.switched_off import marked_off, scene_without
from cloth_core.trellis import trellis_rows, trellis_stiffness

__all__ = ["Model", "Term"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Longest step where nothing stiff limits it [s]: gravity and contact are still sampled often enough.
_LONGEST_STEP = 1.0 / 480.0
# Structural stiffness that stands for none [N/m].
_NEXT_TO_NONE = 1e-3
# How far particles may move between two broad phases of contact [m]: with the body alone, and with cloth too, where it
# is also at most this share of the particle spacing, so that flat cloth has no candidates against itself.
_BODY_SEARCH_RADIUS = 0.03
_SEARCH_RADIUS = 0.008
_SEARCH_RADIUS_SHARE = 0.4


@dataclass(frozen=True)
class Term:
    """One physical effect of a model.

    Attributes:
        name: for reports.
        active: whether the model has it.
        reason: why it is there or not.
        elements: how many springs, seams, triangles, ... it runs over.
    """

    name: str
    active: bool
    reason: str
    elements: int


class Model:
    """A scene made ready to run.

    Args:
        scene: what is simulated; the model's own `scene` is without what is switched off.
        closed: the seams that are merged; the others stay open (and are pulled together while `sewing`).
        sewing: whether open seams pull, and gravity waits until they have closed.
        held: seams, or parts of them, whose points stay two but pull at each other all the same.

    Attributes:
        closed: the seams that are merged.
        number: model particle of each unsewn particle, shape (n,).
        mass, inverse_mass: [kg, 1/kg], shape (k,); the inverse is 0 for what is held.
        triangles: in model particles, shape (m, 3).
        softness: what the structural springs' stiffness is multiplied by, 1 unless a run looks for rest.
        springs, seam_pull, contact: the terms' arrays; None or empty where the scene does not need them.
        trellis, trellis_stiffness: cells that resist shear as such, shape (q, 4), and how much [N/m], shape (q,).
        terms: all terms, with the reason why each is there or not.
    """

    def __init__(
        self, scene: Scene, closed: tuple[Seam, ...] = (), sewing: bool = False, held: tuple[Seam, ...] = ()
    ) -> None:
        without, scene = scene.without, scene_without(scene)
        garment, fabric = scene.garment, scene.fabric
        self.scene = scene
        self.closed = closed
        self.sewing = sewing
        self.number = merged_numbers(garment.particle_count, closed)
        self.particle_count = int(self.number.max()) + 1
        self.triangles = renumbered(garment.triangles, self.number)
        self.mass = np.bincount(
            self.number, weights=garment.particle_areas * fabric.area_density, minlength=self.particle_count
        ).astype(np.float64)
        if (self.mass <= 0.0).any():
            bad = int(np.flatnonzero(self.number == np.flatnonzero(self.mass <= 0.0)[0])[0])
            where = garment.panel_names[garment.panel_of_particle[bad]]
            raise SceneError(f"panel '{where}', particle {bad}: has no cloth around it and no mass; mend the pattern")
        self.inverse_mass = 1.0 / self.mass
        self.inverse_mass[self.number[scene.pins]] = 0.0
        if sewing:
            fabric = fabric.smoothed
        self._fabric = fabric
        self.springs: Springs = build_springs(garment, fabric).renumbered(self.number)
        cells = slice(None) if fabric.shear > 0.0 else slice(0)
        self.trellis: Ints = renumbered(garment.quads[cells], self.number)
        self.trellis_stiffness: Floats = trellis_stiffness(garment, fabric.shear)[cells]
        self._trellis_runs = find_runs(self.trellis, self.trellis_stiffness[:, None])
        self.softness = 1.0
        self._stiffness = self.springs.stiffness
        self._soft_stiffness: Floats | None = None
        self._runs = self.springs.runs(self._stiffness)
        self._spring_runs = self._runs.mixed(1.0)
        bending = self.bending
        self._bending_count = len(bending)
        self._line_runs, self._twist_runs = bending.line_runs(), bending.twist_runs()
        self._hinges = (bending.hinges, bending.hinge_weights, bending.hinge_stiffness)
        self._pulled = garment.seams if sewing else held
        self.seam_pull: SeamPull | None = self._pull(1.0) if self._pulled else None
        self.strain_limit = (
            no_strain_limit() if "strain limit" in without else build_strain_limit(self.springs, fabric.strain_limit)
        )
        offset = scene.settings.contact_offset
        body = BodyContact(scene.body, offset) if scene.body is not None else None
        cloth = (
            SelfContact.of(garment, self.number, self.triangles, scene.settings.cloth_offset, sewing)
            if "self contact" not in without
            else None
        )
        self.contact: Contact | None = None
        if body is not None or cloth is not None:
            radius = min(_SEARCH_RADIUS, _SEARCH_RADIUS_SHARE * garment.spacing)
            radius = _BODY_SEARCH_RADIUS if cloth is None else radius
            farthest = _BODY_SEARCH_RADIUS if body is not None else math.inf
            self.contact = Contact(self.triangles, body, cloth, radius, farthest)
        self.terms = marked_off(self._terms(closed), without)

    @property
    def bending(self) -> Bending:
        """The bending elements, made anew: steps take them as runs."""
        if self._fabric.bending == 0.0:
            return _NO_BENDING
        return build_bending(self.scene.garment, self._fabric, self.number)

    def soften(self, softness: float) -> None:
        """Multiply the structural stiffness by softness (0 to 1), but not to below twice that of the shear springs.

        The largest frequency is that of the structural springs, which hardly stretch in a drape: a run that only looks
        for the resting shape gets most of the way with soft ones and long steps. The strain limit is not softened.
        """
        garment, fabric = self.scene.garment, self._fabric
        weakest = min(fabric.structural_warp, fabric.structural_weft)
        self.softness = softness = min(max(softness, 2.0 * (fabric.shear + fabric.shear_spring) / weakest), 1.0)
        if softness < 1.0 and self._soft_stiffness is None:
            # Stiffness is linear in the fabric's: between none and all of the structural one everything is a mixture.
            soft = replace(fabric, structural_warp=_NEXT_TO_NONE, structural_weft=_NEXT_TO_NONE)
            self._soft_stiffness = build_springs(garment, soft).renumbered(self.number).stiffness
            self._runs = self.springs.runs(self._soft_stiffness)
        stiffness = self.springs.stiffness
        if self._soft_stiffness is not None:
            stiffness = self._soft_stiffness + softness * (stiffness - self._soft_stiffness)
        self._stiffness = stiffness
        self._spring_runs = self._runs.mixed(softness)
        if self.seam_pull is not None:
            self.seam_pull = self._pull(softness)

    def _pull(self, softness: float) -> SeamPull:
        garment = self.scene.garment
        return renumbered_pull(
            build_seam_pull(garment, self._fabric, garment.start, softness, self._pulled), self.number
        )

    # -- arrays for the compiled loop --

    def force_terms(self, air_drag: float) -> ForceTerms:
        """The force terms' arrays; air_drag k_a [1/s] is the scene's, or more while a run only looks for rest."""
        gravity = np.zeros(3) if self.sewing else np.array(self.scene.gravity)
        return ForceTerms(
            mass=self.mass,
            inverse_mass=self.inverse_mass,
            gravity=gravity,
            air_drag=float(air_drag),
            springs=self._spring_runs,
            spring_damping_time=self.scene.fabric.damping_time,
            trellis=self._trellis_runs,
            lines=self._line_runs,
            twists=self._twist_runs,
            hinges=self._hinges[0],
            hinge_weights=self._hinges[1],
            hinge_stiffness=self._hinges[2],
            bending_damping_time=self.scene.fabric.bending_damping_time,
            seam=self.seam_pull if self.seam_pull is not None else _NO_SEAMS,
            strain_limit=self.strain_limit,
        )

    def contact_settings(self) -> ContactSettings:
        """The contact term's constants; cloth slides freely while it is sewn."""
        body = self.scene.body
        settings = self.scene.settings
        return ContactSettings(
            active=self.contact is not None,
            body_vertices=body.vertices if body is not None else np.zeros((0, 3)),
            body_velocity=np.zeros_like(body.vertices) if body is not None else np.zeros((0, 3)),
            body_triangles=body.triangles if body is not None else np.zeros((0, 3), dtype=np.int32),
            body_way=0.0,
            offset=settings.contact_offset,
            friction=0.0 if self.sewing else self.scene.fabric.friction,
            push_speed=settings.push_speed,
        )

    # -- states --

    def gather(self, unsewn: Floats, weights: Floats) -> Floats:
        """Weighted mean over the unsewn particles that each model particle stands for; (n, 3), (n,) -> (k, 3)."""
        total = np.bincount(self.number, weights=weights, minlength=self.particle_count)
        return np.stack(
            [
                np.bincount(self.number, weights=weights * unsewn[:, axis], minlength=self.particle_count) / total
                for axis in range(3)
            ],
            axis=1,
        )

    # -- stability --

    def stable_step(
        self, x: Floats, air_drag: float, mode: Floats | None = None, tolerance: float = 5e-4
    ) -> StableStep:
        """Largest stable time step at positions x (k, 3) [m]; mode: that of the last estimate, to start from."""
        acts = self._stiffness > 0.0
        pairs = self.springs.pairs[acts]
        terms = StiffnessTerms(
            pairs=pairs,
            spring_rows=spring_rows(x, pairs, self.springs.rest_length[acts], self._stiffness[acts]),
            cells=self.trellis,
            cell_rows=trellis_rows(x, self.trellis, self.trellis_stiffness),
            forces=self.force_terms(air_drag),
        )
        return stable_time_step(StiffnessProduct(terms, len(x)), self.inverse_mass, mode, tolerance)

    def longest_step(self, stable: StableStep) -> float:
        """Time step [s] to use: the settings' share of the stable one, and no longer than is sensible without one."""
        return min(self.scene.settings.safety * stable.time_step, _LONGEST_STEP)

    # -- what is modelled, and why --

    def _terms(self, closed: tuple[Seam, ...]) -> tuple[Term, ...]:
        scene, fabric = self.scene, self.scene.fabric
        smoothing = self._fabric.bending_spring > fabric.bending_spring
        shear = fabric.shear + fabric.shear_spring
        count = {family: int((self.springs.family == family).sum()) for family in SpringFamily}
        heavy = any(scene.gravity)
        seams = scene.garment.seams
        open_seams = len(seams) - len(closed)
        free = self.particle_count - len(np.unique(self.number[scene.pins]))
        body = len(scene.body.triangles) if scene.body is not None else 0

        layers = len(self.triangles) if self.contact is not None and self.contact.cloth is not None else 0

        def term(name: str, active: bool, elements: int, why: str, why_not: str) -> Term:
            return Term(name, active, why if active else why_not, elements if active else 0)

        return (
            term("gravity", heavy, free, f"{-scene.gravity[2]:g} m/s^2, once the seams are closed", "gravity is 0"),
            term("air drag", scene.air_drag > 0.0, free, f"k_a = {scene.air_drag:g} 1/s", "k_a is 0: nothing to drag"),
            term(
                "structural springs", True, count[SpringFamily.STRUCTURAL],
                f"{fabric.structural_warp:g} N/m along warp, {fabric.structural_weft:g} N/m along weft", "",
            ),
            term(
                "shear springs", shear > 0.0, count[SpringFamily.SHEAR],
                f"{shear:g} N/m, " + ("by" if fabric.shear_spring > 0.0 else "by the difference of")
                + " the two diagonals of a cell", "the fabric has no shear stiffness",
            ),
            term(
                "bending springs", fabric.bending_spring > 0.0, 0 if smoothing else count[SpringFamily.BENDING],
                f"{fabric.bending_spring:g} N/m, the paper's third family", "the fabric has none",
            ),
            term(
                "sewing smoothness", smoothing, count[SpringFamily.BENDING],
                f"bending springs of {self._fabric.bending_spring:g} N/m until the seams are closed",
                "no seam is open",
            ),
            term(
                "bending", fabric.bending > 0.0, self._bending_count,
                f"{fabric.bending:g} N m", "the fabric has no bending stiffness",
            ),
            term(
                "strain limit", True, count[SpringFamily.STRUCTURAL],
                f"structural springs stretch by at most {100 * fabric.strain_limit:g} %", "",
            ),
            term(
                "spring damping", fabric.damping_time > 0.0, len(self.springs),
                f"{fabric.damping_time:g} s", "the fabric has none",
            ),
            term("pins", len(scene.pins) > 0, len(scene.pins), "held where they start", "no particle is pinned"),
            term(
                "seams", bool(seams), len(seams),
                f"{open_seams} to close, {len(closed)} merged", "the pattern has no stitches",
            ),
            term(
                "body contact", body > 0, body,
                f"offset {1000 * scene.settings.contact_offset:g} mm, no pass-through", "there is no body",
            ),
            term(
                "friction", self.contact is not None and fabric.friction > 0.0, body + layers,
                f"Coulomb, {fabric.friction:g}, once the seams are closed", "nothing can touch, or no friction",
            ),
            term(
                "self contact", layers > 0, layers,
                f"offset {1000 * scene.settings.cloth_offset:g} mm, no pass-through", "",
            ),
        )  # fmt: skip


_NO_BENDING = Bending(
    np.zeros((0, 3), dtype=np.int32), np.zeros(0), np.zeros((0, 4), dtype=np.int32), np.zeros((0, 4)), np.zeros(0)
)
_NO_SEAMS = SeamPull(np.zeros((0, 2), dtype=np.int32), np.zeros(0), np.zeros(0), np.zeros(0), 0.0, 0.0)
