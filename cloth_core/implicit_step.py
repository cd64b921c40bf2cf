"""Implicit time steps: as long as the motion allows, however stiff the cloth is.

Where nothing touches, the second-order backward difference (BDF2; Choi and Ko 2002 for cloth),

    x1 = (4 x - x-)/3 + h v1,    v1 = (4 v - v-)/3 + h a(x1, v1),    h = 2 dt / 3,

else, and in the first step, implicit Euler (Baraff and Witkin 1998): x1 = x + dt v1, v1 = v + dt a(x1, v1). Both damp
what is faster than the step and are stable at any step. Newton's method solves for v1, beginning where the particles
would be without forces: where they are now (Baraff and Witkin's choice), stiff cloth that turns is held back (measured
in docs/integrators.md).

Contact acts after the solution as it does after a symplectic step: nothing can cross here either. So that cloth at rest
stays at rest, the solution is given the force that contact had to exert in the last steps, and it is taken back before
contact acts, which finds out anew how much of it is needed. What rests is then in balance with its springs, not pulled
by them into what it lies on and pushed out again in each step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.axis_layout import by_axis, by_particle
from cloth_core.contact import keep_within_travel, resolve_contacts
from cloth_core.contact_state import ContactSettings, ContactState
from cloth_core.implicit_matrix import ImplicitMatrix, assemble, limit_forces
from cloth_core.kernel import borrowing_kernel, kernel
from cloth_core.sparse_cholesky import factorise, solve
from cloth_core.step import ForceTerms, Workspace, total_force

__all__ = ["ImplicitState", "implicit_steps"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Newton's iterations of a step. A step that has not converged by then is done in halves, quarters, ... down to the
# smallest part.
_ITERATIONS = 10
_SMALLEST_PART = 256
# Newton's iterations end when the next one would leave less than this stretching energy per area [J/m^2]: an iteration
# that moves particles by a share e of the spacing leaves errors of order e^2, strains of energy k e^4.
_ENERGY_LEFT = 0.001
# And when it would change the velocity by less than this, RMS [m/s].
_SPEED_LEFT = 0.05
# Time over which the push of contact is averaged [s]: a blow does not go on as a push.
_MEMORY = 0.02


class ImplicitState(NamedTuple):
    """What implicit steps remember and work on.

    Attributes:
        matrix: of the model.
        tolerance: RMS movement [m] in Newton's last iteration that is small enough, (1,).
        before_x, before_v: state a step ago, (n, 3); last_x, last_v: what the last step left, (n, 3).
        last_step: its length [s], 0 where there is none to go on from, (1,).
        push: mean force of contact and its friction on each particle in the last steps [N], (n, 3).
        trial_x, trial_v, base_x, base_v: scratch, (n, 3).
        unknowns: scratch, (3 n,).
    """

    matrix: ImplicitMatrix
    tolerance: Floats
    before_x: Floats
    before_v: Floats
    last_x: Floats
    last_v: Floats
    last_step: Floats
    push: Floats
    trial_x: Floats
    trial_v: Floats
    base_x: Floats
    base_v: Floats
    unknowns: Floats

    @classmethod
    def of(cls, matrix: ImplicitMatrix, spacing: float) -> ImplicitState:
        """Nothing remembered yet; spacing of the particles [m]."""
        stiffest = max(float(matrix.stiffness.max(initial=0.0)), _ENERGY_LEFT)
        tolerance = spacing * (_ENERGY_LEFT / stiffest) ** 0.25
        n = len(matrix.bend_own)
        before_x, before_v, last_x, last_v, push, trial_x, trial_v, base_x, base_v = (
            np.zeros((n, 3)) for _ in range(9)
        )
        return cls(
            matrix, np.array([tolerance]), before_x, before_v, last_x, last_v, np.zeros(1), push, trial_x, trial_v,
            base_x, base_v, np.zeros(3 * n),
        )  # fmt: skip


@kernel
def implicit_steps(
    x: Floats,
    v: Floats,
    work: Workspace,
    moved: Floats,
    terms: ForceTerms,
    contact: ContactSettings,
    contacts: ContactState,
    dt: float,
    count: int,
    state: ImplicitState,
) -> int:
    """Up to `count` steps of dt [s], in place; the number done, fewer when contacts must be searched anew.

    As `cloth_core.step.run_steps`. Where Newton's method finds nothing, x becomes NaN.
    """
    if not contact.active:
        state.push[:] = 0.0
    for step in range(count):
        _advance(x, v, work, terms, dt, not contact.active, state)
        if not contact.active:
            continue
        _take_push_back(x, v, terms.inverse_mass, state.push, dt)
        state.base_v[:] = v
        by_axis(x, work.x)
        by_axis(v, work.v)
        spent = resolve_contacts(work.x, work.v, terms.inverse_mass, contacts, contact, dt, moved)
        by_particle(work.v, v)
        _remember_push(v, state.base_v, terms.mass, dt, state.push)
        # Last of all: whatever the terms wanted, no particle goes farther than it safely can.
        spent = keep_within_travel(work.x, work.v, contacts, moved) or spent
        by_particle(work.x, x)
        by_particle(work.v, v)
        if spent:
            return step + 1
    return count


@borrowing_kernel
def _take_push_back(x: Floats, v: Floats, inverse_mass: Floats, push: Floats, dt: float) -> None:
    """Take from x, v what the push of the last steps gave: contact finds out anew what is needed."""
    for i in range(x.shape[0]):
        for axis in range(3):
            change = dt * inverse_mass[i] * push[i, axis]
            v[i, axis] -= change
            x[i, axis] -= dt * change


@borrowing_kernel
def _remember_push(v: Floats, before: Floats, mass: Floats, dt: float, push: Floats) -> None:
    """Take what changed the velocity from `before` to v into the mean force of the last steps."""
    share = 1.0 - np.exp(-dt / _MEMORY)
    for i in range(v.shape[0]):
        for axis in range(3):
            push[i, axis] += share * ((v[i, axis] - before[i, axis]) * mass[i] / dt - push[i, axis])


@kernel
def _advance(
    x: Floats, v: Floats, work: Workspace, terms: ForceTerms, dt: float, free: bool,
    state: ImplicitState,
) -> None:  # fmt: skip
    """One step of dt, in parts if need be; free: whether nothing but the force terms acts."""
    parts, done = 1, 0
    while done < parts:
        second_order = free and parts == 1 and state.last_step[0] == dt and _is_as_left(x, v, terms, state)
        if _step(x, v, work, terms, dt / parts, second_order, state):
            done += 1
            state.last_step[0] = dt if free and parts == 1 else 0.0
        elif parts < _SMALLEST_PART:
            parts, done = 2 * parts, 2 * done
        else:
            x[:] = np.nan
            return


@borrowing_kernel
def _is_as_left(x: Floats, v: Floats, terms: ForceTerms, state: ImplicitState) -> bool:
    """Whether nothing from outside has changed what is free to move since the last step."""
    for i in range(x.shape[0]):
        if terms.inverse_mass[i] > 0.0:
            for axis in range(3):
                if x[i, axis] != state.last_x[i, axis] or v[i, axis] != state.last_v[i, axis]:
                    return False
    return True


@kernel
def _step(
    x: Floats, v: Floats, work: Workspace, terms: ForceTerms, dt: float, second_order: bool,
    state: ImplicitState,
) -> bool:  # fmt: skip
    """One whole step, in place; False, and nothing changed, where Newton's method does not converge."""
    base_x, base_v, trial_x, trial_v = state.base_x, state.base_v, state.trial_x, state.trial_v
    h = 2.0 / 3.0 * dt if second_order else dt
    for i in range(x.shape[0]):
        for axis in range(3):
            p, u = x[i, axis], v[i, axis]
            base_x[i, axis], base_v[i, axis] = p, u
            if terms.inverse_mass[i] == 0.0:  # it goes where it is taken
                base_x[i, axis] = p + (dt - h) * u
            elif second_order:
                base_x[i, axis] = (4.0 * p - state.before_x[i, axis]) / 3.0
                base_v[i, axis] = (4.0 * u - state.before_v[i, axis]) / 3.0
            trial_v[i, axis] = u
            trial_x[i, axis] = base_x[i, axis] + h * u
    for iteration in range(_ITERATIONS):
        moved = _newton(work, terms, h, state)
        if not moved < np.inf:
            return False
        if iteration > 0 and moved <= min(state.tolerance[0], _SPEED_LEFT * h):
            state.before_x[:], state.before_v[:] = x, v
            x[:], v[:] = trial_x, trial_v
            state.last_x[:], state.last_v[:] = x, v
            return True
    return False


@kernel
def _newton(work: Workspace, terms: ForceTerms, h: float, state: ImplicitState) -> float:
    """One iteration of Newton's method on the trial state; how far it moves the particles, RMS [m]."""
    trial_x, trial_v, base_x, base_v = state.trial_x, state.trial_v, state.base_x, state.base_v
    factors, y = state.matrix.factors, state.unknowns
    assemble(state.matrix, trial_x, terms, h)
    if not factorise(factors):
        return np.inf
    total_force(trial_x, trial_v, terms, 0.0, work)
    limit_forces(state.matrix, trial_x, work.force)
    for i in range(trial_x.shape[0]):
        held = terms.inverse_mass[i] == 0.0
        for axis in range(3):
            rest = h * (work.force[axis, i] + state.push[i, axis]) - terms.mass[i] * (
                trial_v[i, axis] - base_v[i, axis]
            )
            y[3 * factors.place[i] + axis] = 0.0 if held else rest
    solve(factors, y)
    squares = 0.0
    for i in range(trial_x.shape[0]):
        for axis in range(3):
            change = y[3 * factors.place[i] + axis]
            squares += change * change
            trial_v[i, axis] += change
            trial_x[i, axis] = base_x[i, axis] + h * trial_v[i, axis]
    return float(h * np.sqrt(squares / trial_x.shape[0]))
