"""Terms that a user switches off by hand: the scene as if it did not have them, and what it then misses.

A term is switched off by taking its cause out of the scene (no gravity, no body, no shear stiffness ...), so that it
costs what it costs in a scene that never had it: nothing. What was asked for stays in the scene that the user made, so
that a report can say what the run went without.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.body_crossings import BodyCrossings
from cloth_core.errors import SceneError
from cloth_core.intersections import self_crossing_edges
from cloth_core.layer_distance import close_pairs
from cloth_core.penetration import max_penetration
from cloth_core.sewing import seam_gaps
from cloth_core.springs import SpringFamily, spring_strains

if TYPE_CHECKING:
    from cloth_core.model import Model, Term
    from cloth_core.scene import Scene

__all__ = ["SWITCHABLE", "check_without", "marked_off", "missed_effects", "scene_without"]

Floats = NDArray[np.float64]


def _fabric(*keys: str) -> Callable[[Scene], Scene]:
    def without(scene: Scene) -> Scene:
        changes: dict[str, Any] = dict.fromkeys(keys, 0.0)
        return replace(scene, fabric=replace(scene.fabric, **changes))

    return without


def _without_seams(scene: Scene) -> Scene:
    garment = scene.garment
    merged = np.arange(garment.particle_count, dtype=np.int32)
    return replace(scene, garment=replace(garment, seams=(), merged_indices=merged))


# How each term's cause is taken out of a scene. Strain limit and self contact have no cause to take out: the model
# asks for them by name.
SWITCHABLE: dict[str, Callable[[Scene], Scene]] = {
    "gravity": lambda scene: replace(scene, gravity=(0.0, 0.0, 0.0)),
    "air drag": lambda scene: replace(scene, air_drag=0.0),
    "shear springs": _fabric("shear", "shear_spring"),
    "bending springs": _fabric("bending_spring"),
    "bending": _fabric("bending"),
    "strain limit": lambda scene: scene,
    "spring damping": _fabric("damping_time"),
    "pins": lambda scene: replace(scene, pins=np.zeros(0, dtype=np.int32)),
    "seams": _without_seams,
    "body contact": lambda scene: replace(scene, body=None),
    "friction": _fabric("friction"),
    "self contact": lambda scene: scene,
}


def check_without(names: tuple[str, ...]) -> None:
    """Refuse what is no term, or none that cloth can do without.

    Raises:
        SceneError: says which terms can be switched off.
    """
    for name in names:
        if name not in SWITCHABLE:
            raise SceneError(f"without '{name}': no term that can be switched off; use some of {', '.join(SWITCHABLE)}")


def scene_without(scene: Scene) -> Scene:
    """The scene as it is simulated: without the causes of what `scene.without` names."""
    for name in scene.without:
        scene = SWITCHABLE[name](scene)
    return scene


def marked_off(terms: tuple[Term, ...], without: tuple[str, ...]) -> tuple[Term, ...]:
    """The terms with the true reason for those that are off by hand."""
    return tuple(
        replace(t, active=False, elements=0, reason="switched off by hand") if t.name in without else t for t in terms
    )


@dataclass(frozen=True)
class _Run:
    scene: Scene
    model: Model
    x: Floats
    v: Floats
    unsewn_x: Floats


def missed_effects(scene: Scene, model: Model, x: Floats, v: Floats, unsewn_x: Floats) -> dict[str, str]:
    """What the present state lacks for want of the terms that are off by hand: term -> one line. Only what it needs.

    Args:
        scene: as it was asked for.
        model: of the run; x, v (k, 3) [m, m/s] its state.
        unsewn_x: positions of all particles of all panels [m], shape (n, 3).
    """
    run = _Run(scene, model, x, v, unsewn_x)
    found = {name: _MISSED[name](run) for name in scene.without}
    return {
        name: f"{name} {'are' if name.endswith('s') else 'is'} off and {why}"
        for name, why in found.items()
        if why is not None
    }


def _gravity(run: _Run) -> str | None:
    pull = float(np.linalg.norm(run.scene.gravity))
    return f"{run.model.mass.sum():.3g} kg of cloth do not weigh {pull * run.model.mass.sum():.3g} N" if pull else None


def _air_drag(run: _Run) -> str | None:
    speed = float(np.sqrt((run.v**2).sum(axis=1).max()))
    slowed = run.scene.air_drag * speed
    return f"the fastest particle ({speed:.3g} m/s) is not slowed by {slowed:.3g} m/s^2" if slowed > 0.01 else None


def _stiffness(keys: tuple[str, ...], unit: str, what: str) -> Callable[[_Run], str | None]:
    def line(run: _Run) -> str | None:
        value = sum(getattr(run.scene.fabric, key) for key in keys)
        return f"the fabric's {value:.3g} {unit} against {what} are not felt" if value > 0.0 else None

    return line


def _strain_limit(run: _Run) -> str | None:
    limit = run.scene.fabric.strain_limit
    springs = run.model.springs
    strain = spring_strains(run.x, springs)[springs.family == SpringFamily.STRUCTURAL]
    over = int((strain > limit).sum())
    return f"{over} springs are stretched beyond the fabric's {100 * limit:g} %" if over else None


def _pins(run: _Run) -> str | None:
    return f"{len(run.scene.pins)} particles were to be held" if len(run.scene.pins) else None


def _seams(run: _Run) -> str | None:
    gaps = [g for g in seam_gaps(run.scene.garment, run.unsewn_x).values() if g > run.scene.settings.seam_tolerance]
    return f"{len(gaps)} seams are up to {1000 * max(gaps):.3g} mm open" if gaps else None


def _body_contact(run: _Run) -> str | None:
    body = run.scene.body
    if body is None:
        return None
    crossings = BodyCrossings.of(run.x, run.model.triangles, body)
    depth = max_penetration(run.x, run.model.triangles, body, crossings)
    if crossings.number == 0 and depth == 0.0:
        return None
    return (
        f"{crossings.cloth_sides_through_body} sides cross the body, {crossings.body_sides_through_cloth} of its sides "
        f"the cloth, up to {1000 * depth:.3g} mm deep"
    )


def _friction(run: _Run) -> str | None:
    body = run.scene.body
    if body is None or run.scene.fabric.friction == 0.0:
        return None
    touching = int((np.abs(body.signed_distance(run.x)) < 1.5 * run.scene.settings.contact_offset).sum())
    return f"{touching} particles that lie on the body slide freely" if touching else None


def _self_contact(run: _Run) -> str | None:
    distance = max(run.scene.fabric.thickness, run.scene.settings.cloth_offset)
    # Points that are still to be sewn together are meant to meet.
    identity = np.zeros(run.model.particle_count, dtype=np.int32)
    identity[run.model.number] = run.model.scene.garment.merged_indices
    close = close_pairs(run.x, run.model.triangles, distance, identity)
    crossings = len(self_crossing_edges(run.x, run.model.triangles, identity))
    if not close and not crossings:
        return None
    return f"{close} pairs of layers are closer than {1000 * distance:g} mm, {crossings} sides cross"


_MISSED: dict[str, Callable[[_Run], str | None]] = {
    "gravity": _gravity,
    "air drag": _air_drag,
    "shear springs": _stiffness(("shear", "shear_spring"), "N/m", "shearing"),
    "bending springs": _stiffness(("bending_spring",), "N/m", "folding"),
    "bending": _stiffness(("bending",), "N m", "bending"),
    "strain limit": _strain_limit,
    "spring damping": _stiffness(("damping_time",), "s", "quick stretching"),
    "pins": _pins,
    "seams": _seams,
    "body contact": _body_contact,
    "friction": _friction,
    "self contact": _self_contact,
}
