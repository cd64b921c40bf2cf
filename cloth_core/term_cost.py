"""What a step of each term costs, measured on the present state."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy

import numpy as np
from numpy.typing import NDArray

from cloth_core.axis_layout import by_axis
from cloth_core.bending import bending_forces
from cloth_core.contact import resolve_contacts
from cloth_core.contact_state import ContactSettings, ContactState
from cloth_core.gravity_and_air import air_drag_forces, gravity_forces
from cloth_core.sewing import seam_forces
from cloth_core.springs import spring_forces
from cloth_core.step import ForceTerms, Workspace, run_steps, total_force
from cloth_core.strain_limit import hold_strain
from cloth_core.trellis import trellis_forces
from cloth_core.twist import twist_forces

__all__ = ["term_costs"]

Floats = NDArray[np.float64]

_REPEATS = 20


def term_costs(
    x: Floats, v: Floats, terms: ForceTerms, contact: ContactSettings, contacts: ContactState, dt: float
) -> dict[str, float]:
    """Median microseconds that one step of each term takes, on copies of the state x, v (n, 3); "step": all of it.

    All springs run in one loop; its time is shared out by their number elsewhere. Shear that is resisted by cells has
    a loop of its own.
    """
    work = Workspace.of(len(x))
    total_force(x, v, terms, 0.0, work)  # fills the copies that the terms work on
    # Contacts and strain limit remember impulses; measuring must not touch those of the run.
    limit, contacts = deepcopy((terms.strain_limit, contacts))
    whole, held = terms._replace(strain_limit=deepcopy(limit)), deepcopy(contacts)
    measured: dict[str, Callable[[], object]] = {
        "gravity": lambda: gravity_forces(terms.mass, terms.gravity, work.force),
        "air drag": lambda: air_drag_forces(work.v, terms.mass, terms.air_drag, work.force),
        "structural springs": lambda: spring_forces(
            work.x, work.v, terms.springs, terms.spring_damping_time, work.force
        ),
        "bending": lambda: _bending(terms, work),
    }
    if len(terms.trellis.length) + len(terms.trellis.rest):
        measured["shear springs"] = lambda: trellis_forces(
            work.x, work.v, terms.trellis, terms.spring_damping_time, work.force
        )
    xs, vs = x.copy(), v.copy()
    measured["strain limit"] = lambda: hold_strain(xs, vs, terms.inverse_mass, limit, dt)
    if terms.seam.pairs.shape[0] > 0:
        measured["seams"] = lambda: seam_forces(work.x, work.v, terms.seam, 0.0, work.force)
    if contact.active:
        moved, touching = np.zeros(len(x)), Workspace.of(len(x))
        by_axis(x, touching.x)
        by_axis(v, touching.v)
        measured["body contact"] = lambda: resolve_contacts(
            touching.x, touching.v, terms.inverse_mass, contacts, contact, dt, moved
        )
    xw, vw, room, way = x.copy(), v.copy(), Workspace.of(len(x)), np.zeros(len(x))
    measured["step"] = lambda: run_steps(xw, vw, room, way, whole, contact, held, dt, 1, 0.0, 0.0)
    return {name: _median_microseconds(run) for name, run in measured.items()}


def _bending(terms: ForceTerms, work: Workspace) -> None:
    bending_forces(work.ahead, terms.lines, terms.hinges, terms.hinge_weights, terms.hinge_stiffness, work.force)
    twist_forces(work.ahead, terms.twists, work.force)


def _median_microseconds(run: Callable[[], object]) -> float:
    times = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return 1e6 * float(np.median(times))
