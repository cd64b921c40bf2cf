"""Sides and triangles of the cloth against sides and vertices of a body: impulses that only push.

Such contacts share particles, so that one pass over them does not settle them. They are swept a few times a step, and
each step starts from the impulses of the last one: resting contacts need the same impulse in every step, so they settle
from step to step, and cloth at rest stays at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.closest_points import point_triangle, segment_segment
from cloth_core.kernel import kernel

__all__ = ["BODY_SIDE", "BODY_VERTEX", "PUSH_TIME", "PairContacts", "hold_pairs", "repeat_impulses"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Kinds of pairs.
BODY_SIDE = 0  # particles: two of a cloth side; body: two vertices of a body side
BODY_VERTEX = 1  # particles: three corners of a cloth triangle; body: one vertex

# A pair counts from this many offsets on: one that rests at the offset must not come and go with rounding.
_REACH = 1.02
_SWEEPS = 4
# Time in which cloth that is too near comes out, to 1/e [s].
PUSH_TIME = 0.01


class PairContacts(NamedTuple):
    """Pairs within reach, and the state of those in contact; s pairs.

    Attributes:
        kind: one of the kinds above, (s,).
        particles: cloth particles, -1 where there is none, (s, 3).
        body: body vertices, -1 where there is none, (s, 2).
        offset: distance at which the two are held apart [m], (s,).
        distance: at the search [m], (s,).
        weight: where the closest point lies between the particles, (s, 3).
        normal: unit vector from body to cloth, (s, 3).
        velocity: of the body at the closest point [m/s], (s, 3).
        gap: distance to the offset before the step [m], (s,).
        impulse: what the contact gave in the last step along the normal [N s], (s,).
        friction: the same across the normal [N s], (s, 3).
        active: which pairs are in contact; the first active_count[0] entries count, (s,).
    """

    kind: Ints
    particles: Ints
    body: Ints
    offset: Floats
    distance: Floats
    weight: Floats
    normal: Floats
    velocity: Floats
    gap: Floats
    impulse: Floats
    friction: Floats
    active: Ints
    active_count: Ints

    @classmethod
    def of(cls, kind: Ints, particles: Ints, body: Ints, offset: Floats, distance: Floats) -> PairContacts:
        """Pairs that a search has found, none of them in contact yet."""
        count = len(kind)
        return cls(
            kind, particles, body, offset, distance,
            weight=np.zeros((count, 3)),
            normal=np.zeros((count, 3)),
            velocity=np.zeros((count, 3)),
            gap=np.zeros(count),
            impulse=np.zeros(count),
            friction=np.zeros((count, 3)),
            active=np.zeros(count, dtype=np.int32),
            active_count=np.zeros(1, dtype=np.int32),
        )  # fmt: skip

    @classmethod
    def none(cls) -> PairContacts:
        """No pairs."""
        return cls.of(
            np.zeros(0, dtype=np.int32), np.zeros((0, 3), dtype=np.int32), np.zeros((0, 2), dtype=np.int32),
            np.zeros(0), np.zeros(0),
        )  # fmt: skip


@kernel
def repeat_impulses(x: Floats, v: Floats, inverse_mass: Floats, pairs: PairContacts, dt: float) -> None:
    """Give each contact what it needed in the last step; x, v (n, 3), inverse_mass (n,), dt [s]."""
    impulse = np.zeros(3)
    for entry in range(pairs.active_count[0]):
        s = pairs.active[entry]
        for axis in range(3):
            impulse[axis] = pairs.impulse[s] * pairs.normal[s, axis] + pairs.friction[s, axis]
        _apply(x, v, inverse_mass, pairs, s, impulse, dt)


@kernel
def hold_pairs(
    x: Floats,
    v: Floats,
    inverse_mass: Floats,
    pairs: PairContacts,
    body_x: Floats,
    body_v: Floats,
    friction: float,
    push_speed: float,
    dt: float,
    moved: Floats,
) -> None:
    """Hold all pairs apart after a step, in place.

    Shapes: x, v (n, 3) [m, m/s]; inverse_mass (n,); body_x, body_v (b, 3) [m, m/s]; moved (n,), way of each particle
    since the search [m]; friction is Coulomb's coefficient; push_speed [m/s] bounds how fast what is too near leaves.
    """
    count = _find_active(x, v, pairs, body_x, body_v, dt, moved)
    velocity = np.zeros(3)
    impulse = np.zeros(3)
    for _ in range(_SWEEPS if count > 0 else 0):
        for entry in range(count):
            s = pairs.active[entry]
            compliance = _compliance(inverse_mass, pairs, s)
            if compliance <= 0.0:
                continue
            approach = _relative_velocity(v, pairs, s, velocity)
            # A gap that was still open may close within the step, no more.
            wanted = -max(pairs.gap[s], 0.0) / dt
            before = pairs.impulse[s]
            pairs.impulse[s] = max(before + (wanted - approach) / compliance, 0.0)
            size = 0.0
            for axis in range(3):
                across = velocity[axis] - approach * pairs.normal[s, axis]
                impulse[axis] = pairs.friction[s, axis] - across / compliance
                size += impulse[axis] * impulse[axis]
            size = np.sqrt(size)
            limit = friction * pairs.impulse[s]
            share = limit / size if size > limit else 1.0
            for axis in range(3):
                held = share * impulse[axis]
                change = held - pairs.friction[s, axis]
                pairs.friction[s, axis] = held
                impulse[axis] = change + (pairs.impulse[s] - before) * pairs.normal[s, axis]
            _apply(x, v, inverse_mass, pairs, s, impulse, dt)
    for entry in range(count):
        s = pairs.active[entry]
        if pairs.gap[s] >= 0.0:
            continue
        push = min(push_speed, -pairs.gap[s] / PUSH_TIME) * dt
        compliance = _compliance(inverse_mass, pairs, s)
        if compliance <= 0.0:
            continue
        for k in range(3):
            i = pairs.particles[s, k]
            if i >= 0:
                share = pairs.weight[s, k] * inverse_mass[i] / compliance
                for axis in range(3):
                    x[i, axis] += share * push * pairs.normal[s, axis]


@kernel
def _find_active(
    x: Floats, v: Floats, pairs: PairContacts, body_x: Floats, body_v: Floats, dt: float, moved: Floats
) -> int:
    """Measure the pairs that can have come near; list those in contact, with weights, normal and gap."""
    count = 0
    closest = np.zeros(3)
    velocity = np.zeros(3)
    for s in range(pairs.kind.shape[0]):
        # Nothing can have come nearer than by the way that its particles went since the search.
        reach = _REACH * pairs.offset[s]
        squared = np.inf
        if pairs.distance[s] - reach <= _way(pairs, s, moved):
            squared = _measure(x, pairs, s, body_x, body_v, closest)
        if squared >= reach * reach or squared < 1e-24:
            pairs.impulse[s] = 0.0
            for axis in range(3):
                pairs.friction[s, axis] = 0.0
            continue
        distance = np.sqrt(squared)
        for axis in range(3):
            pairs.normal[s, axis] = closest[axis] / distance
        pairs.gap[s] = distance - pairs.offset[s] - dt * _relative_velocity(v, pairs, s, velocity)
        pairs.active[count] = s
        count += 1
    pairs.active_count[0] = count
    return count


@kernel
def _way(pairs: PairContacts, s: int, moved: Floats) -> float:
    """How much nearer the cloth of pair s can have come, from the way of each particle (n,) [m]."""
    p, q, r = pairs.particles[s, 0], pairs.particles[s, 1], pairs.particles[s, 2]
    farthest = max(moved[p], moved[q])
    return float(max(farthest, moved[r]) if r >= 0 else farthest)


@kernel
def _measure(x: Floats, pairs: PairContacts, s: int, body_x: Floats, body_v: Floats, closest: Floats) -> float:
    """Squared distance of pair s [m^2]; sets its weights, the body's velocity there and the vector between its closest
    points, closest (3,).
    """
    p, q, r = pairs.particles[s, 0], pairs.particles[s, 1], pairs.particles[s, 2]
    a, b = pairs.body[s, 0], pairs.body[s, 1]
    along = 0.0
    if pairs.kind[s] == BODY_SIDE:
        squared, w0, along = segment_segment(x[p], x[q], body_x[a], body_x[b])
        pairs.weight[s, 0], pairs.weight[s, 1] = 1.0 - w0, w0
    else:
        squared, w0, w1, w2 = point_triangle(body_x[a], x[p], x[q], x[r])
        pairs.weight[s, 0], pairs.weight[s, 1], pairs.weight[s, 2] = w0, w1, w2
    for axis in range(3):
        value = -body_x[a, axis]
        for k in range(3):
            if pairs.particles[s, k] >= 0:
                value += pairs.weight[s, k] * x[pairs.particles[s, k], axis]
        if b >= 0:
            value -= along * (body_x[b, axis] - body_x[a, axis])
        closest[axis] = value
        pairs.velocity[s, axis] = body_v[a, axis] + (along * (body_v[b, axis] - body_v[a, axis]) if b >= 0 else 0.0)
    return float(squared)


@kernel
def _compliance(inverse_mass: Floats, pairs: PairContacts, s: int) -> float:
    """Relative velocity that a unit impulse gives [1/kg]."""
    compliance = 0.0
    for k in range(3):
        if pairs.particles[s, k] >= 0:
            compliance += pairs.weight[s, k] * pairs.weight[s, k] * inverse_mass[pairs.particles[s, k]]
    return compliance


@kernel
def _relative_velocity(v: Floats, pairs: PairContacts, s: int, velocity: Floats) -> float:
    """Velocity of cloth relative to body at the closest point, velocity (3,); returns its normal part [m/s]."""
    normal = 0.0
    for axis in range(3):
        velocity[axis] = -pairs.velocity[s, axis]
        for k in range(3):
            if pairs.particles[s, k] >= 0:
                velocity[axis] += pairs.weight[s, k] * v[pairs.particles[s, k], axis]
        normal += velocity[axis] * pairs.normal[s, axis]
    return normal


@kernel
def _apply(x: Floats, v: Floats, inverse_mass: Floats, pairs: PairContacts, s: int, impulse: Floats, dt: float) -> None:
    """Apply an impulse (3,) [N s] at the closest point of pair s."""
    for k in range(3):
        i = pairs.particles[s, k]
        if i < 0:
            continue
        share = pairs.weight[s, k] * inverse_mass[i]
        for axis in range(3):
            v[i, axis] += share * impulse[axis]
            x[i, axis] += share * impulse[axis] * dt
