"""When seams merge: as soon as all of them have closed, or come no nearer, without making anything cross."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cloth_core.body_crossings import BodyCrossings
from cloth_core.garment import Seam, merged_numbers
from cloth_core.intersections import crossing_pairs, self_crossing_edges, self_crossing_pairs
from cloth_core.model import Model
from cloth_core.nudging import nudged_apart
from cloth_core.scene import Scene
from cloth_core.seam_gaps import seam_gap_triangles
from cloth_core.seam_hope import SeamHope, far_points, stretch_beside
from cloth_core.sewing import seam_gaps
from cloth_core.tightness import times_the_limit

__all__ = ["SeamClosing", "count_crossings"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

# Seams are looked at this often [s]; they no longer get narrower when this share of the widest gap is left after it.
_INTERVAL = 0.05
_STALLED = 0.9
# Points that had to stay two hold on to each other for so long [s]; then they are let go, so that the cloth comes to
# rest. Meanwhile they are looked at again this often [s], and so many by themselves.
_HELD, _LATER, _SINGLY = 1.5, 0.2, 12
# The largest force of the pull is multiplied by this at each look at which nothing has got narrower, up to this in all.
_FIRMER, _FIRMEST = 1.25, 8.0
# Times that points around what would cross are left out, before a limit is given up; and limits that are tried, from
# the distance at which points may merge down to where seams count as closed.
_ROUNDS = 12
_LIMITS = 4
# Times that what would cross is nudged apart before the seams are given up: it takes a moment.
_NUDGES = 3
# What is near enough but would cross waits so long for cloth to get out of the way [s] before stitches are left out.
_WAIT = 0.3
# Cloth that is stretched by this share of the fabric's limit is tight.
_TIGHT = 0.8
# Points of which other places are tried when they merge.
_PLACES = 40


class SeamClosing:
    """Watches the gaps of a run's seams and says when and how they merge.

    Attributes:
        open_seams: those that stay open, with their gaps [m]; filled when the others merge.
        positions: in which what merges lies at one place [m], unsewn numbering, (n, 3); filled at the same time.
    """

    def __init__(self) -> None:
        self.open_seams: dict[str, float] = {}
        self.positions = np.zeros((0, 3))
        self._widest_gap = math.inf
        self._firmness = 1.0
        self._next_look = 0.0
        self._nudges = 0
        self._crossed_since = math.inf
        self._held: list[Bools] = []
        self._held_until = math.inf
        self._reasons: dict[str, str] = {}
        self._hope = SeamHope()

    def merged(self, scene: Scene, model: Model, x: Floats, time: float, sewn_for: float) -> Model | None:
        """The model in which the seams are merged, point by point; None as long as they shall go on closing.

        Args:
            scene: of the run.
            model: the present one, with open seams.
            x: positions in the unsewn numbering [m], (n, 3).
            time: simulated [s].
            sewn_for: how long the seams have been pulled [s].
        """
        settings = scene.settings
        if sewn_for < scene.closing_time or time < self._next_look:
            return None
        self._next_look = time + _INTERVAL
        gaps = seam_gaps(scene.garment, x)
        widest, before = max(gaps.values()), self._widest_gap
        self._widest_gap = widest
        if model.contact is not None and model.contact.cloth is not None:
            model.contact.cloth.gaps_may_leave = widest >= _STALLED * before
        late = sewn_for >= scene.sewing_time or self._given_up(scene, x, time)
        if not late and widest > settings.seam_tolerance and widest < _STALLED * before:
            return None
        # A tight garment or cloth in between holds the last millimetres open; merging the points closes them.
        near = within = _within(scene, x, settings.merge_distance)
        if not late and not all(points.all() for points in near):
            self._pull_harder(model)
            return None
        present = count_crossings(scene, model, x)
        self.positions, crossings = _placed(scene, x, near, present)
        if crossings > present and (late or self._nudges < _NUDGES):
            self._nudges += 1
            self.positions, crossings = _nudged(scene, self.positions, near, present)
        if crossings > present:
            self._crossed_since = min(self._crossed_since, time)
            if not late and time < self._crossed_since + _WAIT:
                return None
            near = _without_crossing(scene, x, _points_that_count(scene, model, x), present)
            self.positions, crossings = _placed(scene, x, near, present)
            if crossings > present:
                self.positions, crossings = _nudged(scene, self.positions, near, present)
            if crossings > present:
                if not late:
                    self._next_look = time + _WAIT
                    return None
                # Open seams can be mended, cloth that has passed through cloth cannot.
                near, self.positions = [np.zeros_like(points) for points in near], x
        # What was near enough but would have crossed is held where it is; what a limb holds apart is not: it would pull
        # the cloth about for ever.
        self._held = [close & ~merges for close, merges in zip(within, near, strict=True)]
        self._held_until = time + _HELD
        chosen = self._chosen(scene, near, gaps)
        self._reasons = {s.name: _reason(scene, s, x) for s in scene.garment.seams if s.name in self.open_seams}
        return chosen

    @property
    def may_close(self) -> bool:
        """Whether points of open seams still hold on to each other, to merge later."""
        return any(bool(points.any()) for points in self._held)

    def why_open(self, scene: Scene, x: Floats) -> dict[str, str]:
        """One line for each seam that is open at x (n, 3) [m]: its gap, and what lay in it when the others merged."""
        gaps = seam_gaps(scene.garment, x)
        return {
            name: f"seam {name}: still {1000 * gaps[name]:.1f} mm open, it stays open; {self._reasons[name]}"
            for name in self.open_seams
            if gaps[name] > scene.settings.seam_tolerance
        }

    def merged_later(self, scene: Scene, model: Model, x: Floats, time: float) -> Model | None:
        """The model in which points that had to stay two have merged as well, as soon as some of them can; else None.

        Cloth that lay in the way has moved once gravity acts. What still cannot after a while is let go.
        Arguments as in `merged`; `model` is that of the drape.
        """
        if time < self._next_look or not any(points.any() for points in self._held):
            return None
        self._next_look = time + _LATER
        merged = [model.number[s.first] == model.number[s.second] for s in scene.garment.seams]
        if time > self._held_until:
            self._held, self.positions = [np.zeros_like(points) for points in self._held], x
            return self._chosen(scene, merged, seam_gaps(scene.garment, x))
        near = _within(scene, x, scene.settings.merge_distance)
        wanted = [points & close for points, close in zip(self._held, near, strict=True)]
        present = count_crossings(scene, model, x)
        for more in (wanted, *islice(_one_by_one(wanted), _SINGLY)):
            which = [points | also for points, also in zip(merged, more, strict=True)]
            if not any((points & ~already).any() for points, already in zip(which, merged, strict=True)):
                continue
            number = merged_numbers(len(x), _parts(scene, which))
            if _crossing_points(scene, x, number)[0] <= present:
                self.positions = _gathered(scene, x, number)[number]
                self._held = [points & ~done for points, done in zip(self._held, which, strict=True)]
                return self._chosen(scene, which, seam_gaps(scene.garment, x))
        return None

    def _chosen(self, scene: Scene, which: list[Bools], gaps: dict[str, float]) -> Model:
        chosen = Model(scene, closed=_parts(scene, which), held=_parts(scene, self._held))
        self.open_seams = {
            seam.name: gaps[seam.name]
            for seam, points in zip(scene.garment.seams, which, strict=True)
            if not points.all()
        }
        return chosen

    def _given_up(self, scene: Scene, x: Floats, time: float) -> bool:
        """Whether what is too far apart to merge will not get any nearer."""
        points, still_open = far_points(scene.garment.seams, x, scene.settings.merge_distance)
        limit = math.inf if "strain limit" in scene.without else scene.fabric.strain_limit
        stretch = times_the_limit(stretch_beside(scene.garment, points, x), limit)
        length = 0.5 * len(points) * scene.garment.spacing
        return self._hope.lost(still_open, length, stretch, self._firmness, self._firmness >= _FIRMEST, time)

    def _pull_harder(self, model: Model) -> None:
        """What no longer gets nearer is pulled with a little more force from one look to the next."""
        if model.seam_pull is None or model.softness < 1.0 or self._firmness >= _FIRMEST:
            return
        self._firmness *= _FIRMER
        model.seam_pull = model.seam_pull._replace(largest_force=_FIRMER * model.seam_pull.largest_force)


def count_crossings(scene: Scene, model: Model, x: Floats) -> int:
    """Sides that pass through body or cloth when unsewn positions x (n, 3) [m] are put into a model's numbering."""
    sewn = model.gather(x, scene.garment.particle_areas)
    # Points of a seam that have met are neighbours already.
    identity = _points_that_count(scene, model, sewn) if model.sewing else None
    crossings = len(self_crossing_edges(sewn, model.triangles, identity))
    body = scene.body
    if body is not None:
        crossings += BodyCrossings.of(sewn, model.triangles, body).number
    return crossings


def _reason(scene: Scene, seam: Seam, x: Floats) -> str:
    """What holds a seam open at x (n, 3) [m], unsewn numbering, and where, as the end of a message."""
    far = np.linalg.norm(x[seam.first] - x[seam.second], axis=1) > scene.settings.seam_tolerance
    points = np.concatenate([seam.first[far], seam.second[far]])
    gaps = seam_gap_triangles((seam,))
    gaps = gaps[np.isin(gaps, points).any(axis=1)]
    body = scene.body
    if body is not None and len(gaps):
        edges, pairs = crossing_pairs(body.vertices, body.triangles, x, gaps)
        ends = body.vertices[edges[np.unique(pairs[:, 0])]].mean(axis=1)
        _, pairs = crossing_pairs(x, gaps, body.vertices, body.triangles, body.tree)
        crossed = body.vertices[body.triangles[np.unique(pairs[:, 1])]].mean(axis=1)
        places = np.concatenate([ends, crossed])
        if len(places):
            nearest = places[np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1))]
            return (
                f"the body lies in it at {_place(nearest)}: too tight there, or its two sides start on different sides "
                "of a limb"
            )
    if not len(points):
        return "cloth lies in it"
    widest = seam.first[np.argmax(np.linalg.norm(x[seam.first] - x[seam.second], axis=1))]
    stretch = stretch_beside(scene.garment, points, x)
    if stretch >= _TIGHT * scene.fabric.strain_limit:
        return (
            f"the cloth beside it at {_place(x[widest])} is stretched by {100 * stretch:.0f} %: too tight there, or "
            "cloth lies in it"
        )
    return f"cloth lies in it at {_place(x[widest])}, or what is sewn there pulls it apart"


def _place(point: Floats) -> str:
    return f"({', '.join(f'{value:.2f}' for value in point)}) m"


def _within(scene: Scene, x: Floats, limit: float) -> list[Bools]:
    """For each seam which of its points are no farther from each other than limit [m]."""
    return [np.linalg.norm(x[s.first] - x[s.second], axis=1) <= limit for s in scene.garment.seams]


def _parts(scene: Scene, which: list[Bools]) -> tuple[Seam, ...]:
    seams = zip(scene.garment.seams, which, strict=True)
    return tuple(Seam(s.name, s.first[k], s.second[k]) for s, k in seams if k.any())


def _placed(scene: Scene, x: Floats, which: list[Bools], present: int) -> tuple[Floats, int]:
    """Positions [m], (n, 3), in which the points of each seam that merge lie at one place, and how many sides cross.

    Normally that is their mean. Where it would bring more crossings than the present ones, as when cloth lies close
    beside one of the points, those at what crosses are tried at the place of each of them instead.
    """
    number = merged_numbers(len(x), _parts(scene, which))
    placed = _gathered(scene, x, number)[number]
    count, crossing = _crossing_points(scene, placed, number)
    tried: set[int] = set()
    while count > present:
        points, members = np.unique(number[crossing], return_counts=True)
        left = [p for p in points[members > 1].tolist() if p not in tried]
        if not left or len(tried) >= _PLACES:
            break
        tried.add(left[0])
        own = np.flatnonzero(number == left[0])
        for place in x[own]:
            trial = placed.copy()
            trial[own] = place
            fewer, there = _crossing_points(scene, trial, number)
            if fewer < count:
                placed, count, crossing = trial, fewer, there
    return placed, count


def _nudged(scene: Scene, placed: Floats, which: list[Bools], present: int) -> tuple[Floats, int]:
    """Positions [m], (n, 3), of what merges, with the points moved a little that keep something from crossing."""
    number = merged_numbers(len(placed), _parts(scene, which))
    triangles = np.asarray(number[scene.garment.triangles], dtype=np.int32)
    sewn, crossings = nudged_apart(_gathered(scene, placed, number), triangles, scene.body, present)
    return np.asarray(sewn[number]), crossings


def _one_by_one(which: list[Bools]) -> Iterator[list[Bools]]:
    """The points of each seam, one at a time."""
    for k, points in enumerate(which):
        for point in np.flatnonzero(points).tolist():
            single = [np.zeros_like(other) for other in which]
            single[k][point] = True
            yield single


def _points_that_count(scene: Scene, model: Model, x: Floats) -> Ints:
    """Number of the point that each particle of a model with open seams counts as at x (n, 3) [m], (n,)."""
    if model.contact is None or model.contact.cloth is None:
        return scene.garment.merged_indices
    return model.contact.cloth.one_point(x)


def _without_crossing(scene: Scene, x: Floats, number: Ints, present: int) -> list[Bools]:
    """Points of each seam that can be merged without more crossings than the present ones; as many as are found.

    Of all that are near enough those are left out, round by round, that belong to what crosses once they are merged:
    both sides of the seam are moved there, by half of its gap. Points that count as one by now (equal `number`, (n,))
    are left out only if that is not enough: their surroundings may cross as long as they are two.
    """
    seams = scene.garment.seams
    met = [number[s.first] == number[s.second] for s in seams]
    limits = np.geomspace(scene.settings.merge_distance, scene.settings.seam_tolerance, _LIMITS)
    fewest, best = -1, [np.zeros(len(s.first), dtype=np.bool_) for s in seams]
    for kept in (met, [np.zeros_like(points) for points in met]):
        for limit in limits:
            which = [near | keep for near, keep in zip(_within(scene, x, limit), kept, strict=True)]
            for _ in range(_ROUNDS):
                count, crossing = _crossing_points(scene, x, merged_numbers(len(x), _parts(scene, which)))
                if fewest < 0 or count < fewest:
                    fewest, best = count, [points.copy() for points in which]
                if count <= present:
                    return best
                drops = [
                    points & ~keep & (crossing[s.first] | crossing[s.second])
                    for s, points, keep in zip(seams, which, kept, strict=True)
                ]
                if not any(drop.any() for drop in drops):
                    break
                which = [points & ~drop for points, drop in zip(which, drops, strict=True)]
    return best


def _crossing_points(scene: Scene, x: Floats, number: Ints) -> tuple[int, Bools]:
    """How many sides cross when particles are merged to `number` (n,), and which of them (n,) are at what crosses."""
    sewn = _gathered(scene, x, number)
    triangles = np.asarray(number[scene.garment.triangles], dtype=np.int32)
    at = np.zeros(len(sewn), dtype=np.bool_)
    edges, pairs = self_crossing_pairs(sewn, triangles)
    crossings = len(np.unique(pairs[:, 0]))
    at[edges[pairs[:, 0]]] = True
    at[triangles[pairs[:, 1]]] = True
    if scene.body is not None:
        found = BodyCrossings.of(sewn, triangles, scene.body)
        crossings += found.number
        at[found.cloth_sides[found.through_body[:, 0]]] = True
        at[triangles[found.through_cloth[:, 1]]] = True
    return crossings, np.asarray(at[number])


def _gathered(scene: Scene, x: Floats, number: Ints) -> Floats:
    """Mean of x (n, 3) [m] over the particles that are merged to each number, weighted with their areas, (k, 3)."""
    weights = scene.garment.particle_areas
    total = np.bincount(number, weights=weights)
    return np.stack([np.bincount(number, weights=weights * x[:, k]) / total for k in range(3)], axis=1)
