"""What a step of each term costs, measured on the present state."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy

import numpy as np
from numpy.typing import NDArray

from cloth_core.bending import bending_forces
from cloth_core.contact import ContactSettings, ContactState, resolve_contacts
from cloth_core.gravity_and_air import air_drag_forces, gravity_forces
from cloth_core.sewing import seam_forces
from cloth_core.springs import spring_forces
from cloth_core.step import ForceTerms, run_steps
from cloth_core.strain_limit import hold_strain

__all__ = ["term_costs"]

Floats = NDArray[np.float64]

_REPEATS = 20


def term_costs(
    x: Floats, v: Floats, terms: ForceTerms, contact: ContactSettings, contacts: ContactState, dt: float
) -> dict[str, float]:
    """Median microseconds that one step of each term takes, on copies of the state x, v (n, 3); "step": all of it.

    The structural, shear and bending springs run in one loop; its time is shared out by their number elsewhere.
    """
    force = np.zeros_like(x)
    # Contacts and strain limit remember impulses; measuring must not touch those of the run.
    limit, contacts = deepcopy((terms.strain_limit, contacts))
    whole, held = deepcopy((terms, contacts))
    measured: dict[str, Callable[[], object]] = {
        "gravity": lambda: gravity_forces(terms.mass, terms.gravity, force),
        "air drag": lambda: air_drag_forces(v, terms.mass, terms.air_drag, force),
        "structural springs": lambda: spring_forces(
            x, v, terms.spring_pairs, terms.spring_rest_length, terms.spring_stiffness, terms.spring_damping_time, force
        ),
        "bending": lambda: bending_forces(
            x, v, terms.lines, terms.line_stiffness, terms.hinges, terms.hinge_weights, terms.hinge_stiffness,
            terms.bending_damping_time, force,
        ),
    }  # fmt: skip
    xs, vs = x.copy(), v.copy()
    measured["strain limit"] = lambda: hold_strain(xs, vs, terms.inverse_mass, terms.spring_pairs, limit, dt)
    if terms.seam.pairs.shape[0] > 0:
        measured["seams"] = lambda: seam_forces(x, v, terms.seam, 0.0, force)
    if contact.active:
        moved, xc, vc = np.zeros(len(x)), x.copy(), v.copy()
        measured["body contact"] = lambda: resolve_contacts(xc, vc, terms.inverse_mass, contacts, contact, dt, moved)
    xw, vw, forces, way = x.copy(), v.copy(), np.zeros_like(x), np.zeros(len(x))
    measured["step"] = lambda: run_steps(xw, vw, forces, way, whole, contact, held, dt, 1, 0.0, 0.0)
    return {name: _median_microseconds(run) for name, run in measured.items()}


def _median_microseconds(run: Callable[[], object]) -> float:
    times = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return 1e6 * float(np.median(times))
