"""Particles held by grippers: their positions and velocities are prescribed, as if their mass were infinite.

A gripper is a frame that follows a goal pose smoothly and within a speed limit, and carries its particles rigidly. It
prescribes velocities only; the time step moves the particles like all others, and contact stops them at their travel
bounds, so that nothing that is held can be pulled through a body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cloth_core.errors import SimulationError
from cloth_core.model import Model

__all__ = ["Grasps", "Pose"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Time in which a gripper makes up its distance to the goal, to 1/e [s]: shorter than one frame of a 30 Hz stream.
_FOLLOW_TIME = 0.02
# Nearer than this to its goal [m, rad] a gripper stands still, so that cloth can come to rest.
_ARRIVED = 1e-6
# A held particle that may travel less than this is about to touch something [m]; it uses half of it per tick.
_TOUCHING = 0.0009
# A gripper draws no spring farther than to this share of its longest length: if two grippers pulled beyond it, no
# impulse of the strain limit could ever bring the cloth back, and impulses would add up.
_TAUT = 0.99
_SHARES = (1.0, 0.5, 0.25, 0.125)
# Steps after which the velocities of the held particles are prescribed anew.
_STEPS_AT_ONCE = 8


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame in the world.

    Attributes:
        position: [m], shape (3,).
        orientation: unit quaternion x, y, z, w, shape (4,).
    """

    position: Floats
    orientation: Floats

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pose) and bool(
            (self.position == other.position).all() and (self.orientation == other.orientation).all()
        )

    @classmethod
    def of(cls, position: ArrayLike, orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> Pose:
        """Check and normalise.

        Raises:
            SimulationError: not finite, or a quaternion without a length.
        """
        p, q = np.array(position, dtype=np.float64), np.array(orientation, dtype=np.float64)
        if p.shape != (3,) or q.shape != (4,) or not (np.isfinite(p).all() and np.isfinite(q).all()):
            raise SimulationError(f"pose: {p.tolist()}, {q.tolist()} is not a finite position [m] and quaternion")
        length = float(np.linalg.norm(q))
        if not 1e-6 < length < 1e6:
            raise SimulationError(f"pose: the quaternion {q.tolist()} has no direction; give one of length 1")
        return cls(p, q / length)


@dataclass
class _Gripper:
    particles: Ints
    """Held ones, unsewn numbering, (p,)."""
    local: Floats
    """Where they are in the gripper's frame [m], (p, 3)."""
    pose: Pose
    goal: Pose
    blocked: bool = False
    """Whether it stands still because its cloth is stretched."""
    step: tuple[Floats, Floats] | None = None
    """Way [m] and turn [rad] of the frame in the steps that are being done."""
    lag: float = 0.0
    """How far its cloth is from where it shall be, as when a body is in the way [m]."""


class Grasps:
    """All grippers of a simulation, by name.

    Attributes:
        max_speed: no held particle is moved faster than this [m/s].
    """

    def __init__(self) -> None:
        self.max_speed = 1.0
        self._grippers: dict[str, _Gripper] = {}

    def __bool__(self) -> bool:
        return bool(self._grippers)

    def __contains__(self, name: str) -> bool:
        return name in self._grippers

    def steps(self, count: int) -> int:
        """How many of `count` steps may be done before velocities are prescribed anew."""
        moving = any(gripper.pose is not gripper.goal for gripper in self._grippers.values())
        return min(count, _STEPS_AT_ONCE) if moving else count

    def describe(self) -> dict[str, dict[str, object]]:
        """What each gripper holds and where it is, as JSON types."""
        return {
            name: {
                "particles": len(gripper.particles),
                "position": gripper.pose.position.tolist(),
                "orientation": gripper.pose.orientation.tolist(),
                "arrived": gripper.pose is gripper.goal,
                "blocked": gripper.blocked,
                "lag": gripper.lag,
            }
            for name, gripper in list(self._grippers.items())
        }

    def take(self, name: str, particles: ArrayLike, pose: Pose, model: Model, x: Floats) -> int:
        """Hold particles (unsewn numbering) at a frame from now on; returns how many.

        Args:
            name: of the gripper; must be empty.
            particles: what it holds; those that another one holds stay there.
            pose: of the gripper's frame now.
            model, x: present model and its positions [m], (k, 3).

        Raises:
            SimulationError: the gripper holds something already, there is nothing to hold, or no such particle.
        """
        if name in self._grippers:
            raise SimulationError(
                f"{name}: it holds {len(self._grippers[name].particles)} particles; release them first"
            )
        chosen = np.unique(np.asarray(particles, dtype=np.int32))
        wrong = chosen[(chosen < 0) | (chosen >= len(model.number))]
        if len(wrong):
            raise SimulationError(
                f"{name}: particle {wrong[0]} does not exist, there are {len(model.number)}; number them from 0"
            )
        taken = [model.number[g.particles] for g in self._grippers.values()]
        if taken:
            chosen = chosen[~np.isin(model.number[chosen], np.concatenate(taken))]
        if len(chosen) == 0:
            raise SimulationError(f"{name}: there is nothing to hold; move the gripper to the cloth")
        self._grippers[name] = _Gripper(chosen, np.zeros((len(chosen), 3)), pose, pose)
        self.hold(model, x)
        return len(chosen)

    def move(self, name: str, goal: Pose) -> bool:
        """Let a gripper follow to a new pose; false if that changes nothing, as when it holds nothing."""
        gripper = self._grippers.get(name)
        if gripper is None or gripper.goal == goal:
            return False
        gripper.goal = goal
        return True

    def release(self, name: str, model: Model) -> int:
        """Let go; returns how many particles are free again.

        Raises:
            SimulationError: the gripper holds nothing.
        """
        if name not in self._grippers:
            raise SimulationError(f"{name}: it holds nothing; grasp first")
        count = len(self._grippers.pop(name).particles)
        self._pin(model)
        return count

    def hold(self, model: Model, x: Floats) -> None:
        """Keep hold of the same particles in a model whose positions are x [m], (k, 3), as after sewing."""
        for gripper in self._grippers.values():
            rotation = Rotation.from_quat(gripper.pose.orientation)
            gripper.local = rotation.inv().apply(x[model.number[gripper.particles]] - gripper.pose.position)
        self._pin(model)

    def _pin(self, model: Model) -> None:
        model.inverse_mass[:] = 1.0 / model.mass
        model.inverse_mass[model.number[model.scene.pins]] = 0.0
        for gripper in self._grippers.values():
            model.inverse_mass[model.number[gripper.particles]] = 0.0

    def prescribe(self, model: Model, x: Floats, v: Floats, travel: Floats, span: float) -> None:
        """Set the velocities v (k, 3) [m/s] with which the held particles get where they shall be within span [s].

        Args:
            model, x: present model and its positions [m], (k, 3).
            v: changed in place.
            travel: how far each may move before the next search [m], (k,); empty where nothing can be hit.
            span: simulated time of the coming tick [s].
        """
        for gripper in self._grippers.values():
            held = model.number[gripper.particles]
            self._follow(gripper, model, x, v, held, span)
            next_pose = _moved(gripper.pose, gripper.step, 1.0)
            goal = Rotation.from_quat(next_pose.orientation).apply(gripper.local) + next_pose.position
            behind = goal - x[held]
            gripper.lag = float(np.sqrt((behind**2).sum(axis=1).max()))
            velocity = behind / span
            limit = np.full(len(held), self.max_speed)
            if len(travel):
                near = travel[held] < _TOUCHING
                limit[near] = np.minimum(limit[near], 0.5 * travel[held][near] / span)
            speed = np.sqrt((velocity**2).sum(axis=1))
            velocity *= np.minimum(1.0, limit / np.maximum(speed, 1e-300))[:, None]
            v[held] = velocity

    def advance(self, share: float) -> None:
        """Take the frames on by what was prescribed, or by a share of it if not all of the span has been simulated."""
        for gripper in self._grippers.values():
            gripper.pose = _moved(gripper.pose, gripper.step, share)
            gripper.step = None

    def _follow(self, gripper: _Gripper, model: Model, x: Floats, v: Floats, held: Ints, span: float) -> None:
        """Choose a gripper's way towards its goal within a span [s], as far as speed limit and cloth allow."""
        here, goal = gripper.pose, gripper.goal
        gripper.step = None
        if here is goal:
            return
        way = goal.position - here.position
        turn = (Rotation.from_quat(goal.orientation) * Rotation.from_quat(here.orientation).inv()).as_rotvec()
        length, angle = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
        gripper.blocked = False
        if length < _ARRIVED and angle < _ARRIVED:
            gripper.pose = goal
            return
        radius = float(np.sqrt((gripper.local**2).sum(axis=1).max()))
        most = min(1.0 - math.exp(-span / _FOLLOW_TIME), self.max_speed * span / (length + radius * angle))
        springs = _springs_at(model, held)
        for share in _SHARES:
            step = most * share * way, most * share * turn
            pose = _moved(here, step, 1.0)
            if springs.allow(x, v, Rotation.from_quat(pose.orientation).apply(gripper.local) + pose.position, span):
                gripper.step = step
                return
        gripper.blocked = True


def _moved(pose: Pose, step: tuple[Floats, Floats] | None, share: float) -> Pose:
    """A pose after a share of a step of way [m] and turn [rad]."""
    if step is None:
        return pose
    turn = Rotation.from_rotvec(share * step[1]) * Rotation.from_quat(pose.orientation)
    return Pose(pose.position + share * step[0], turn.as_quat())


@dataclass(frozen=True)
class _Springs:
    """Structural springs of which a gripper holds one end; t springs."""

    held: Ints
    """Model particle that is held, (t,)."""
    place: Ints
    """Which of the gripper's particles that is, (t,)."""
    free: Ints
    """Model particle at the other end, (t,)."""
    longest: Floats
    """[m], (t,)."""

    def allow(self, x: Floats, v: Floats, moved: Floats, span: float) -> bool:
        """Whether the gripper's particles may be at `moved` (p, 3) [m] after a span [s]; x, v (k, 3) [m, m/s]."""
        now = np.linalg.norm(x[self.held] - x[self.free], axis=1)
        then = np.linalg.norm(moved[self.place] - x[self.free] - span * v[self.free], axis=1)
        return bool((then <= np.maximum(_TAUT * self.longest, now)).all())


def _springs_at(model: Model, held: Ints) -> _Springs:
    # None if the limit is switched off: nothing holds a gripper back then.
    pairs, longest = model.strain_limit.pairs, model.strain_limit.longest
    place = np.full(model.particle_count, -1, dtype=np.int32)
    place[held] = np.arange(len(held))
    ends = place[pairs] >= 0
    chosen = np.flatnonzero(ends[:, 0] != ends[:, 1])
    own = np.where(ends[chosen, 0], pairs[chosen, 0], pairs[chosen, 1])
    other = np.where(ends[chosen, 0], pairs[chosen, 1], pairs[chosen, 0])
    return _Springs(own, place[own], other, longest[chosen])
