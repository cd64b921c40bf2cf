"""One time step: forces of the terms that the scene has, equation 6, contact; many steps in one compiled loop.

Outside, the state has a row for each particle, (n, 3). Forces run along the rows of the lattice and want a row for
each axis, (3, n), as does all that is done to each particle alike: the steps work on a copy in that layout, on which
contact, which looks at particles here and there, has a view with a row for each of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.axis_layout import by_axis, by_particle, particle_rows
from cloth_core.bending import bending_forces
from cloth_core.contact import carry_body, keep_within_travel, resolve_contacts
from cloth_core.contact_state import ContactSettings, ContactState
from cloth_core.euler import semi_implicit_euler
from cloth_core.gravity_and_air import air_drag_forces, gravity_forces
from cloth_core.kernel import borrowing_kernel
from cloth_core.runs import Runs
from cloth_core.sewing import SeamPull, seam_forces
from cloth_core.springs import spring_forces
from cloth_core.strain_limit import StrainLimit, hold_strain, repeat_strain_impulses, watch_strain
from cloth_core.travel_renewal import renew_spent
from cloth_core.trellis import trellis_forces
from cloth_core.twist import twist_forces

__all__ = ["ForceTerms", "Workspace", "run_steps", "total_force"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# In float64: 4 kB, and by how much the start of a row of the workspace is shifted against that of the row before.
_CACHE_WAY = 512
_ROW_SHIFT = 32


class ForceTerms(NamedTuple):
    """Arrays of all force terms; a term that the scene does not need has none and its loop does not run.

    Attributes:
        mass, inverse_mass: [kg, 1/kg], (n,); the inverse is 0 for a particle that is held.
        gravity: [m/s^2], (3,).
        air_drag: k_a [1/s].
        springs: all springs, with the values (L0 [m], k [N/m]); spring_damping_time: [s].
        trellis: cells that resist shear, with the value k [N/m].
        lines, twists, hinges (h, 4), hinge_weights (h, 4), hinge_stiffness (h,) [N/m]: bending elements.
        bending_damping_time: [s].
        seam: pull of the open seams.
        strain_limit: longest lengths of springs.
    """

    mass: Floats
    inverse_mass: Floats
    gravity: Floats
    air_drag: float
    springs: Runs
    spring_damping_time: float
    trellis: Runs
    lines: Runs
    twists: Runs
    hinges: Ints
    hinge_weights: Floats
    hinge_stiffness: Floats
    bending_damping_time: float
    seam: SeamPull
    strain_limit: StrainLimit


class Workspace(NamedTuple):
    """The state and the forces with a row for each axis, (3, at least n) each; nothing in it outlives `run_steps`.

    Attributes:
        x, v, force: [m, m/s, N].
        ahead: x + tau v, with the damping time of bending [m].
    """

    x: Floats
    v: Floats
    force: Floats
    ahead: Floats

    @classmethod
    def of(cls, particles: int) -> Workspace:
        """Room for a number of particles."""
        arrays = len(cls._fields)
        # Places a multiple of 4 kB apart share a set of the first-level cache, which holds 8 of them; loops here run
        # over 9 rows at once. So a row is that much longer that all 12 of them start at different sets.
        row = particles + (_ROW_SHIFT - particles) % _CACHE_WAY
        room = np.zeros(arrays * 3 * row)
        return cls(*room.reshape(arrays, 3, row))


@borrowing_kernel
def total_force(x: Floats, v: Floats, terms: ForceTerms, openness: float, work: Workspace) -> None:
    """Sum of all forces on each particle at x, v (n, 3) (paper, equation 1), written to work.force [N]."""
    by_axis(x, work.x)
    by_axis(v, work.v)
    _forces(terms, openness, work)


@borrowing_kernel
def _forces(terms: ForceTerms, openness: float, work: Workspace) -> None:
    """Sum of all forces at work.x, work.v, written to work.force."""
    gravity_forces(terms.mass, terms.gravity, work.force)
    if terms.air_drag != 0.0:
        air_drag_forces(work.v, terms.mass, terms.air_drag, work.force)
    spring_forces(work.x, work.v, terms.springs, terms.spring_damping_time, work.force)
    if terms.trellis.length.shape[0] + terms.trellis.rest.shape[0] > 0:
        trellis_forces(work.x, work.v, terms.trellis, terms.spring_damping_time, work.force)
    if terms.lines.length.shape[0] + terms.lines.rest.shape[0] + terms.hinges.shape[0] > 0:
        tau = terms.bending_damping_time
        for axis in range(3):
            px, pv, ahead = work.x[axis], work.v[axis], work.ahead[axis]
            for i in range(terms.mass.shape[0]):
                ahead[i] = px[i] + tau * pv[i]
        bending_forces(work.ahead, terms.lines, terms.hinges, terms.hinge_weights, terms.hinge_stiffness, work.force)
        twist_forces(work.ahead, terms.twists, work.force)
    if terms.seam.pairs.shape[0] > 0:
        seam_forces(work.x, work.v, terms.seam, openness, work.force)


@borrowing_kernel
def run_steps(
    x: Floats,
    v: Floats,
    work: Workspace,
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

    x, v (n, 3) [m, m/s]; moved (n,) scratch; openness as for `seam_forces`, falls by openness_rate * dt
    each step, not below 0.
    """
    by_axis(x, work.x)
    by_axis(v, work.v)
    rows_x, rows_v = particle_rows(work.x, x.shape[0]), particle_rows(work.v, x.shape[0])
    watch_strain(rows_x, terms.strain_limit)
    done = 0
    spent = False
    while done < count and not spent:
        openness = max(openness - openness_rate * dt, 0.0)
        _forces(terms, openness, work)
        semi_implicit_euler(work.x, work.v, work.force, terms.inverse_mass, dt)
        repeat_strain_impulses(rows_x, rows_v, terms.inverse_mass, terms.strain_limit, dt)
        if contact.active:
            spent = resolve_contacts(work.x, work.v, terms.inverse_mass, contacts, contact, dt, moved)
        hold_strain(rows_x, rows_v, terms.inverse_mass, terms.strain_limit, dt)
        if contact.active:
            # Last of all: whatever the terms wanted, no particle goes farther than it safely can.
            spent = keep_within_travel(work.x, work.v, contacts, moved) or spent
            spent = spent and not renew_spent(
                rows_x, rows_v, contacts, contact.body_vertices, contact.body_triangles, moved, dt
            )
        done += 1
        if contact.body_way > 0.0 and done < count and not spent:
            carry_body(contacts, contact, dt)
    by_particle(work.x, x)
    by_particle(work.v, v)
    return done
