"""One time step: forces of the terms that the scene has, equation 6, contact; many steps in one compiled loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.bending import bending_forces
from cloth_core.contact import ContactSettings, ContactState, keep_within_travel, resolve_contacts
from cloth_core.euler import semi_implicit_euler
from cloth_core.gravity_and_air import air_drag_forces, gravity_forces
from cloth_core.kernel import kernel
from cloth_core.sewing import SeamPull, seam_forces
from cloth_core.springs import spring_forces
from cloth_core.strain_limit import StrainLimit, hold_strain, repeat_strain_impulses, watch_strain

__all__ = ["ForceTerms", "run_steps", "total_force"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class ForceTerms(NamedTuple):
    """Arrays of all force terms; a term that the scene does not need has none and its loop does not run.

    Attributes:
        mass, inverse_mass: [kg, 1/kg], (n,); the inverse is 0 for a particle that is held.
        gravity: [m/s^2], (3,).
        air_drag: k_a [1/s].
        spring_pairs (s, 2), spring_rest_length (s,) [m], spring_stiffness (s,) [N/m], spring_damping_time [s].
        lines (l, 3), line_stiffness (l,), hinges (h, 4), hinge_weights (h, 4), hinge_stiffness (h,) [N/m].
        bending_damping_time: [s].
        seam: pull of the open seams.
        strain_limit: longest lengths of the structural springs.
    """

    mass: Floats
    inverse_mass: Floats
    gravity: Floats
    air_drag: float
    spring_pairs: Ints
    spring_rest_length: Floats
    spring_stiffness: Floats
    spring_damping_time: float
    lines: Ints
    line_stiffness: Floats
    hinges: Ints
    hinge_weights: Floats
    hinge_stiffness: Floats
    bending_damping_time: float
    seam: SeamPull
    strain_limit: StrainLimit


@kernel
def total_force(x: Floats, v: Floats, terms: ForceTerms, openness: float, force: Floats) -> None:
    """Sum of all forces on each particle (paper, equation 1), written to force (n, 3) [N]."""
    gravity_forces(terms.mass, terms.gravity, force)
    if terms.air_drag != 0.0:
        air_drag_forces(v, terms.mass, terms.air_drag, force)
    spring_forces(
        x, v, terms.spring_pairs, terms.spring_rest_length, terms.spring_stiffness, terms.spring_damping_time, force
    )
    bending_forces(
        x, v, terms.lines, terms.line_stiffness, terms.hinges, terms.hinge_weights, terms.hinge_stiffness,
        terms.bending_damping_time, force,
    )  # fmt: skip
    if terms.seam.pairs.shape[0] > 0:
        seam_forces(x, v, terms.seam, openness, force)


@kernel
def run_steps(
    x: Floats,
    v: Floats,
    force: Floats,
    moved: Floats,
    terms: ForceTerms,
    contact: ContactSettings,
    contacts: ContactState,
    dt: float,
    count: int,
    openness: float,
    openness_rate: float,
) -> int:
    """Up to `count` steps of dt [s], in place; the number done, fewer when contacts must be searched anew.

    x, v, force (n, 3) [m, m/s, N]; moved (n,) scratch; openness falls by openness_rate * dt each step, not below 0.
    """
    watch_strain(x, terms.spring_pairs, terms.strain_limit)
    for step in range(count):
        openness = max(openness - openness_rate * dt, 0.0)
        total_force(x, v, terms, openness, force)
        semi_implicit_euler(x, v, force, terms.inverse_mass, dt)
        repeat_strain_impulses(x, v, terms.inverse_mass, terms.spring_pairs, terms.strain_limit, dt)
        spent = False
        if contact.active:
            spent = resolve_contacts(x, v, terms.inverse_mass, contacts, contact, dt, moved)
        hold_strain(x, v, terms.inverse_mass, terms.spring_pairs, terms.strain_limit, dt)
        # Last of all: whatever the terms wanted, no particle goes farther than it safely can.
        if contact.active and (keep_within_travel(x, v, contacts, moved) or spent):
            return step + 1
    return count
