"""Impulses between two layers of cloth against the same written plainly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cloth_core.contact import Contact
from cloth_core.contact_state import ContactState
from cloth_core.pair_contacts import CLOTH_VERTEX, COUNTS_FROM, PUSH_TIME, PairContacts, hold_pairs
from cloth_core.self_contact import SelfContact

Floats = NDArray[np.float64]

OFFSET, SPACING, SIDE = 0.001, 0.01, 7
DT, PUSH_SPEED, SWEEPS = 1e-4, 0.1, 4
NOTHING = np.zeros((0, 3))


def two_layers(seed: int) -> tuple[Floats, Floats, Floats, ContactState]:
    """Two uneven sheets, about the offset apart: places, velocities, inverse masses, contacts."""
    rng = np.random.default_rng(seed)
    u, w = (a.ravel() for a in np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij"))
    corner = np.flatnonzero((u < SIDE - 1) & (w < SIDE - 1))
    one = np.stack([corner, corner + SIDE, corner + SIDE + 1], axis=1)
    other = np.stack([corner, corner + SIDE + 1, corner + 1], axis=1)
    sheet = np.concatenate([one, other])
    triangles = np.concatenate([sheet, sheet + len(u)]).astype(np.int32)
    flat = SPACING * np.stack([u, w, 0.0 * u], axis=1)
    x = np.concatenate([flat, flat + np.array([0.3 * SPACING, 0.4 * SPACING, 1.1 * OFFSET])])
    x[:, 2] += 0.2 * OFFSET * rng.uniform(-1.0, 1.0, len(x))
    cloth = SelfContact(triangles, np.arange(len(x)), np.full(len(x), SPACING), OFFSET)
    state = Contact(triangles, None, cloth, radius=0.004).search(x, 0.002)
    inverse_mass = 1.0 / rng.uniform(1e-5, 2e-5, len(x))
    inverse_mass[rng.integers(0, len(x), 5)] = 0.0
    v = 0.3 * rng.normal(size=x.shape)
    v[inverse_mass == 0.0] = 0.0
    return x, v, inverse_mass, state


def plainly_held(x: Floats, v: Floats, inverse_mass: Floats, pairs: PairContacts, friction: float) -> Floats:
    """Places and velocities after the sweeps, each impulse given at once where it acts; and the impulses, (s,)."""
    impulse, rubbing = np.zeros(len(pairs.kind)), np.zeros((len(pairs.kind), 3))
    active = pairs.active[: pairs.active_count[0]]
    for _ in range(SWEEPS):
        for s in active:
            i, weight, normal = pairs.particles[s], pairs.weight[s], pairs.normal[s]
            compliance = (weight**2 * inverse_mass[i]).sum()
            if compliance == 0.0:
                continue
            relative = weight @ v[i]
            approach = relative @ normal
            now = max(impulse[s] + (-max(pairs.gap[s], 0.0) / DT - approach) / compliance, 0.0)
            across = rubbing[s] - (relative - approach * normal) / compliance
            across *= min(1.0, friction * now / max(np.linalg.norm(across), 1e-300))
            given = (now - impulse[s]) * normal + across - rubbing[s]
            impulse[s], rubbing[s] = now, across
            change = (weight * inverse_mass[i])[:, None] * given
            v[i] += change
            x[i] += DT * change
    for s in active:
        i, weight = pairs.particles[s], pairs.weight[s]
        compliance = (weight**2 * inverse_mass[i]).sum()
        if pairs.gap[s] < 0.0 and compliance > 0.0:
            way = min(PUSH_SPEED, -pairs.gap[s] / PUSH_TIME) * DT / compliance
            x[i] += way * (weight * inverse_mass[i])[:, None] * pairs.normal[s]
    return impulse


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_impulses_are_those_of_sweeping_over_the_contacts_one_by_one(seed: int, friction: float) -> None:
    x, v, inverse_mass, state = two_layers(seed)
    x += DT * v
    start_x, start_v = x.copy(), v.copy()
    moved = ((x - state.origin.T) ** 2).sum(axis=1)
    hold_pairs(x, v, inverse_mass, state.pairs, NOTHING, NOTHING, 0.0, friction, PUSH_SPEED, DT, moved)
    impulse = plainly_held(start_x, start_v, inverse_mass, state.pairs, friction)
    assert np.count_nonzero(impulse) > 10
    np.testing.assert_allclose(v, start_v, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(x, start_x, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(state.pairs.impulse, impulse, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_left_unmeasured_only_where_that_changes_nothing(seed: int) -> None:
    runs = two_layers(seed), two_layers(seed)
    left, touching = 0, set()
    for _ in range(80):
        for every, (x, v, inverse_mass, state) in enumerate(runs):
            x += DT * v
            moved = ((x - state.origin.T) ** 2).sum(axis=1)
            pairs = state.pairs
            count = pairs.listed_count[0]
            if every:
                pairs.listed_room[:] = -1.0
            else:
                assert (pairs.listed_particles[:count] >= 0).all()
                farthest = moved[pairs.listed_particles[:count]].max(axis=1)
                left += int((farthest <= pairs.listed_room[:count]).sum())
            hold_pairs(x, v, inverse_mass, pairs, NOTHING, NOTHING, 0.0, 0.4, PUSH_SPEED, DT, moved)
            touching.add(tuple(pairs.active[: pairs.active_count[0]]))
        for mine, theirs in zip(runs[0][:2], runs[1][:2], strict=True):
            np.testing.assert_array_equal(mine, theirs)
        one, other = runs[0][3].pairs, runs[1][3].pairs
        for name in ("active_count", "impulse", "friction", "gap", "stuck"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert left > 1000
    assert len(touching) > 40  # they come and go


def tip_above_a_face(height: float) -> tuple[Floats, Floats, PairContacts]:
    """A triangle that stands on its tip, `height` above one that is held: places, inverse masses, contacts."""
    x = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 0], [-0.5, 0, 1], [0.5, 0, 1]]) * SPACING
    x[3:, 2] += height
    triangles = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    cloth = SelfContact(triangles, np.arange(6), np.full(6, SPACING), OFFSET)
    state = Contact(triangles, None, cloth, radius=0.004).search(x, 0.002)
    inverse_mass = np.array([0.0, 0.0, 0.0, 1e5, 1e5, 1e5])
    return x, inverse_mass, state.pairs


def hold(x: Floats, inverse_mass: Floats, pairs: PairContacts) -> None:
    hold_pairs(x, np.zeros_like(x), inverse_mass, pairs, NOTHING, NOTHING, 0.0, 0.0, PUSH_SPEED, DT, np.full(6, 1e-4))


@pytest.mark.parametrize(("beyond", "touching"), [(1e-6, 1), (-1e-6, 0)])
def test_parts_that_meet_half_way_are_measured_in_time(beyond: float, touching: int) -> None:
    x, inverse_mass, pairs = tip_above_a_face(1.5 * OFFSET)
    inverse_mass[:] = 1e5
    hold_pairs(x, np.zeros_like(x), inverse_mass, pairs, NOTHING, NOTHING, 0.0, 0.0, PUSH_SPEED, DT, np.zeros(6))
    assert pairs.active_count[0] == 0
    tip = (pairs.kind == CLOTH_VERTEX) & (pairs.particles[:, 0] == 3)
    assert tip.sum() == 1
    way = 0.5 * (1.5 - COUNTS_FROM) * OFFSET * (1.0 + beyond)
    x[:3, 2] += way
    x[3:, 2] -= way
    moved = np.full(6, way**2)
    hold_pairs(x, np.zeros_like(x), inverse_mass, pairs, NOTHING, NOTHING, 0.0, 0.0, PUSH_SPEED, DT, moved)
    assert np.isin(np.flatnonzero(tip), pairs.active[: pairs.active_count[0]]).sum() == touching


def test_what_is_too_near_and_free_comes_out_exponentially() -> None:
    x, inverse_mass, pairs = tip_above_a_face(0.4 * OFFSET)
    for _ in range(200):
        hold(x, inverse_mass, pairs)
    # Explicit steps of the decay, all of the way taken by the tip.
    assert OFFSET - x[3, 2] == pytest.approx(0.6 * OFFSET * (1.0 - DT / PUSH_TIME) ** 200, rel=1e-6)
    assert (pairs.stuck == 0.0).all()


def test_what_is_too_near_and_gets_nowhere_pushes_less_and_less_and_recovers() -> None:
    x, inverse_mass, pairs = tip_above_a_face(0.4 * OFFSET)
    start, ways = x.copy(), []
    for _ in range(2000):
        hold(x, inverse_mass, pairs)
        ways.append(x[3, 2] - start[3, 2])
        x[:] = start  # something else holds it where it was
    assert ways[0] == pytest.approx(0.6 * OFFSET * DT / PUSH_TIME, rel=1e-6)
    assert (np.diff(ways[1:]) <= 0.0).all()
    # 0.2 s, each of which counts four times.
    assert ways[-1] == pytest.approx(0.6 * OFFSET * DT / (PUSH_TIME + 4.0 * 2000 * DT), rel=1e-2)
    # Let go, it is as quick as ever after a while.
    for _ in range(60_000):
        hold(x, inverse_mass, pairs)
    assert x[3, 2] == pytest.approx(OFFSET, abs=1e-3 * OFFSET)
    assert pairs.stuck.max() == 0.0
