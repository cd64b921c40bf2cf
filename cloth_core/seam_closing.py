"""When seams merge: as soon as all of them have closed, or come no nearer, without making anything cross."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cloth_core.garment import Seam
from cloth_core.intersections import crossing_edges, self_crossing_edges
from cloth_core.model import Model
from cloth_core.scene import Scene
from cloth_core.sewing import seam_gaps

__all__ = ["SeamClosing", "count_crossings"]

Floats = NDArray[np.float64]

# Seams are looked at this often [s]; they no longer get narrower when this share of the widest gap is left after it.
_INTERVAL = 0.05
_STALLED = 0.9
# Limits between the distances at which points may merge that are tried at the end.
_TRIALS = 4


class SeamClosing:
    """Watches the gaps of a run's seams and says when and how they merge.

    Attributes:
        open_seams: those that stay open, with their gaps [m]; filled when the others merge.
    """

    def __init__(self) -> None:
        self.open_seams: dict[str, float] = {}
        self._widest_gap = math.inf
        self._next_look = 0.0

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
        if sewn_for < settings.closing_time or time < self._next_look:
            return None
        self._next_look = time + _INTERVAL
        gaps = seam_gaps(scene.garment, x)
        widest, before = max(gaps.values()), self._widest_gap
        self._widest_gap = widest
        late = sewn_for >= settings.sewing_time
        if not late and widest > settings.seam_tolerance and widest < _STALLED * before:
            return None
        # A tight garment or cloth in between holds the last millimetres open; merging the points closes them.
        choices = [_merged_within(scene, x, settings.merge_distance)]
        if (choices[0].number != scene.garment.merged_indices).any() and not late:
            return None
        if late:
            limits = np.geomspace(settings.merge_distance, settings.seam_tolerance, _TRIALS)
            choices += [_merged_within(scene, x, limit) for limit in limits]
        present = count_crossings(scene, model, x)
        added = [count_crossings(scene, choice, x) - present for choice in choices]
        if min(added) > 0 and not late:
            return None
        chosen = choices[int(np.argmin(added))]
        whole = {seam.name: len(seam.first) for seam in scene.garment.seams}
        closed = {seam.name for seam in chosen.closed if len(seam.first) == whole[seam.name]}
        self.open_seams = {name: gap for name, gap in gaps.items() if name not in closed}
        return chosen


def count_crossings(scene: Scene, model: Model, x: Floats) -> int:
    """Sides that pass through body or cloth when unsewn positions x (n, 3) [m] are put into a model's numbering."""
    sewn = model.gather(x, scene.garment.particle_areas)
    identity = None
    if model.sewing:  # triangles that will share a point once sewn are neighbours already
        identity = np.zeros(model.particle_count, dtype=np.int32)
        identity[model.number] = scene.garment.merged_indices
    crossings = len(self_crossing_edges(sewn, model.triangles, identity))
    body = scene.body
    if body is not None:
        crossings += len(crossing_edges(sewn, model.triangles, body.vertices, body.triangles, body.tree))
    return crossings


def _merged_within(scene: Scene, x: Floats, limit: float) -> Model:
    """The model in which all seam points nearer to each other than limit [m] are merged."""
    near = [np.linalg.norm(x[s.first] - x[s.second], axis=1) <= limit for s in scene.garment.seams]
    parts = zip(scene.garment.seams, near, strict=True)
    return Model(scene, closed=tuple(Seam(s.name, s.first[k], s.second[k]) for s, k in parts if k.any()))
