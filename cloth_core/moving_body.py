"""A body whose vertices move: linearly to where they shall be, never through the cloth, dragging what rests on them.

Within a step the body stands still for distances and moves for velocities: contacts remove the cloth's velocity
*relative* to the body. After each step its vertices are taken on. So that their way cannot cross the cloth, the time
between two searches is bounded: cloth may use one half of a gap (`BodyMotion.found`), the body the other half. Where
cloth is pinched, so that not even one time step is safe, the body waits: it comes late rather than through the cloth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.closest_points import point_triangle
from cloth_core.contact_state import ContactState
from cloth_core.errors import BodyError
from cloth_core.kernel import borrowing_kernel
from cloth_core.pair_contacts import PairContacts, measure_pair

__all__ = ["BodyMotion"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Share of a gap that the body may use between two searches; the cloth's is below one half too.
_BODY_SHARE = 0.45
# Farthest that it goes between two searches, as a share of the offset.
_WAY_SHARE = 0.25
# The body comes no nearer to cloth than this [m].
_LEAST_GAP = 0.0005
# No search is made for more than this much of the motion at once, so that it looks smooth [s].
_LONGEST_TIME = 1.0 / 240.0
# Shortest distance whose direction is more than rounding [m], and the largest share of a speed that is rounding.
_NO_DIRECTION = 1e-9
_ROUNDING = 1e-7


class BodyMotion:
    """A body on its way from where it is to `goal`.

    Args:
        body: where it is now.
        goal: vertices at the end [m], shape (n, 3), one for each of the body's.
        duration: simulated time that the way takes [s]; longer if cloth is in the way or max_speed asks for it.
        max_speed: no vertex moves faster than this [m/s].

    Raises:
        BodyError: another number of vertices, or something that is not a finite position, duration or speed.

    Attributes:
        body: where it is at present.
        velocity: of its vertices [m/s], shape (n, 3).
        done: whether it has arrived.
    """

    def __init__(self, body: Body, goal: Floats, duration: float, max_speed: float = math.inf) -> None:
        goal = np.array(goal, dtype=np.float64)
        if goal.shape != body.vertices.shape:
            raise BodyError(
                f"body '{body.name}': it has {len(body.vertices)} vertices and cannot move to {len(goal)}; "
                "send the same mesh, moved"
            )
        if not np.isfinite(goal).all():
            bad = int(np.flatnonzero(~np.isfinite(goal).all(axis=1))[0])
            raise BodyError(f"body '{body.name}', vertex {bad}: {goal[bad].tolist()} is not finite; mend the mesh")
        if not (math.isfinite(duration) and duration > 0.0):
            raise BodyError(f"body '{body.name}': it cannot move within {duration!r} s; give a time above 0")
        if not max_speed > 0.0:
            raise BodyError(f"body '{body.name}': it cannot move at {max_speed!r} m/s; give a speed above 0")
        self.body = body
        self._start, self._way = body.vertices, goal - body.vertices
        longest = float(np.sqrt((self._way**2).sum(axis=1).max()))
        self.duration = max(duration, longest / max_speed)
        self._goal = goal
        self._elapsed = 0.0
        self._safe_time = 0.0
        self.velocity = self._way / self.duration
        self._full_velocity = self.velocity
        self._speed = np.sqrt((self.velocity**2).sum(axis=1))
        self._highest_speed = float(self._speed.max())
        self.done = longest == 0.0

    def steps(self, step: float, offset: float) -> tuple[int, float]:
        """How many steps [s] may be done before the next search, at least one; how far a vertex goes in them [m].

        As long as all of it is safe and the body goes no farther than a share of the offset [m]: whatever it has not
        been near at the search is held off from then on at the next one.
        """
        time = min(self._safe_time, self.duration - self._elapsed)
        if self._highest_speed > 0.0:
            time = min(time, _WAY_SHARE * offset / self._highest_speed)
        count = max(int(time / step), 1)
        return count, count * step * self._highest_speed if count > 1 else 0.0

    def advance(self, time: float) -> Body:
        """Takes the body on by `time` [s], or by what is safe if that is less."""
        safe = min(time, self._safe_time)
        self._elapsed = min(self._elapsed + safe, self.duration)
        # Where it waits for cloth it must not go on pushing.
        self.velocity = safe / time * self._way / self.duration
        if self._elapsed >= self.duration:
            self.done = True
            self.velocity = np.zeros_like(self.velocity)
        vertices = self._goal if self.done else self._start + self._elapsed / self.duration * self._way
        self.body = self.body.moved(vertices)
        return self.body

    def found(self, x: Floats, contacts: ContactState, offset: float) -> ContactState:
        """Notes how long the body may move after a search; returns its contacts with half of the travel.

        Args:
            x: positions at the search [m], shape (n, 3).
            contacts: what it found; its contact planes are those of where the body was, and are computed anew.
            offset: distance at which cloth is held from the body [m].
        """
        planes, pairs = contacts.planes, contacts.pairs
        planes.plane_count[:] = -1
        planes.arm_all()
        safe = _safe_time(
            x, planes.start, planes.body_triangle, pairs, self.body.vertices, self.body.triangles, self._speed,
            self._full_velocity, np.zeros(3),
        )  # fmt: skip
        if self._highest_speed > 0.0:
            # What is not listed is farther apart than half the offset beyond the reach of the cloth.
            clear = 0.5 * offset + 0.5 * float(contacts.travel.min())
            safe = min(safe, clear / self._highest_speed)
        self._safe_time = min(_BODY_SHARE * safe, _LONGEST_TIME)
        near = contacts.near._replace(room=0.5 * contacts.near.room)
        return contacts._replace(travel=0.5 * contacts.travel, near=near)


@borrowing_kernel
def _safe_time(
    x: Floats,
    start: Ints,
    body_triangle: Ints,
    pairs: PairContacts,
    body_x: Floats,
    body_triangles: Ints,
    speed: Floats,
    velocity: Floats,
    closest: Floats,
) -> float:
    """Shortest time [s] in which a body moving at `velocity` (b, 3) [m/s] could reach cloth that the search found.

    Parts of body and cloth are convex: what does not move towards the plane between them never meets the cloth, so that
    a body can always withdraw from what it has pinched. speed (b,): length of the velocities; closest (3,) is scratch.
    """
    shortest = np.inf
    for i in range(x.shape[0]):
        for entry in range(start[i], start[i + 1]):
            t = body_triangle[entry]
            a, b, c = body_triangles[t, 0], body_triangles[t, 1], body_triangles[t, 2]
            fastest = max(speed[a], max(speed[b], speed[c]))
            if fastest > 0.0:
                squared, k, m, n = point_triangle(x[i], body_x[a], body_x[b], body_x[c])
                gap = max(np.sqrt(squared) - _LEAST_GAP, 0.0)
                if gap < shortest * fastest:
                    for axis in range(3):
                        closest[axis] = x[i, axis] - k * body_x[a, axis] - m * body_x[b, axis] - n * body_x[c, axis]
                    approach = max(_approach(a, velocity, closest), _approach(b, velocity, closest))
                    approach = max(approach, _approach(c, velocity, closest))
                    shortest = min(shortest, _time_to_close(gap, approach, fastest))
    for entry in range(pairs.listed_count[0]):
        s = pairs.listed[entry]
        a, b = pairs.body[s, 0], pairs.body[s, 1]
        if a < 0:
            continue
        fastest = max(speed[a], speed[b]) if b >= 0 else speed[a]
        if fastest > 0.0:
            gap = max(pairs.listed_distance[entry] - _LEAST_GAP, 0.0)
            if gap < shortest * fastest:
                measure_pair(x, pairs, s, body_x, closest)
                approach = _approach(a, velocity, closest)
                if b >= 0:
                    approach = max(approach, _approach(b, velocity, closest))
                shortest = min(shortest, _time_to_close(gap, approach, fastest))
    return shortest


@borrowing_kernel
def _approach(i: int, velocity: Floats, closest: Floats) -> float:
    """Speed of body vertex i along the vector between closest points (3,) [m/s]; inf where that has no direction."""
    length = np.sqrt(closest[0] * closest[0] + closest[1] * closest[1] + closest[2] * closest[2])
    if length < _NO_DIRECTION:
        return np.inf
    return float((velocity[i, 0] * closest[0] + velocity[i, 1] * closest[1] + velocity[i, 2] * closest[2]) / length)


@borrowing_kernel
def _time_to_close(gap: float, approach: float, fastest: float) -> float:
    """Time [s] for a gap [m]; approach at most `fastest` [m/s], and none that is only rounding."""
    approach = min(approach, fastest)
    return gap / approach if approach > _ROUNDING * fastest else np.inf
