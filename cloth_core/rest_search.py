"""The way of a run to rest: braking, whether it has arrived, and whether it ever will."""

from __future__ import annotations

import math

import numpy as np

from cloth_core.calming import Calming, limit_speed
from cloth_core.motion import Motion
from cloth_core.rest import RestWatch, StallWatch, slowest_swing, why_restless
from cloth_core.resting_regions import RestingRegions
from cloth_core.seam_closing import SeamClosing
from cloth_core.support import PATIENCE_WITH_FALLEN, why_fallen, why_unsupported
from cloth_core.tightness import Tightness, TightnessWatch

__all__ = ["RestSearch"]

# A run that has come to rest is no longer stepped when nothing moves farther than this in a window [m].
_NOTHING = 1e-7


class RestSearch:
    """Looks at a motion window after window.

    Attributes:
        seeking: whether rest is what the run is for; its way there need not be physical then.
        settled: whether the cloth is at rest by the settings' criterion.
        asleep: whether it lies so still that it need not be stepped.
        calming: what brakes it.
    """

    def __init__(self) -> None:
        self.seeking = self.settled = self.asleep = False
        self.calming = Calming()
        self._has_settled = False
        self._hopeless = ""
        self._stall_watch, self._tightness_watch = StallWatch(), TightnessWatch()

    def begin(self) -> None:
        """Look for rest from now on."""
        self.seeking = True
        self._stall_watch, self._tightness_watch, self._hopeless = StallWatch(), TightnessWatch(), ""
        self.calming.active = True

    def calm(self, motion: Motion) -> None:
        """Slow the motion down after a tick, where it is only to end; what is sewn is not braked."""
        if not self.seeking:
            return
        limit_speed(motion.v)
        if not motion.model.sewing and self.calming.active:
            self.calming.brake(motion.v, motion.time_step * motion.tick_steps)

    def wake(self, motion: Motion) -> None:
        """Something acts from outside."""
        self.settled = self.asleep = False
        self.open_window(motion)
        self.rest_regions(motion)

    def open_window(self, motion: Motion) -> None:
        """Look from here on."""
        settings = motion.scene.settings
        slowest = _slowest_swing(motion)
        self._watch = RestWatch(settings.rest_displacement, settings.rest_window, slowest, motion.air_drag)
        self._watch.open(motion.time, motion.x)

    def rest_regions(self, motion: Motion) -> None:
        """After a run to rest, let regions that lie still sleep, as long as the body does not move."""
        if not self._has_settled or self.seeking or motion.body_motion is not None or motion.implicit is not None:
            if motion.regions is not None:
                motion.let_sleep(None)
        elif motion.regions is None or self.asleep:
            slowest, drag = _slowest_swing(motion), motion.air_drag
            motion.let_sleep(RestingRegions(motion.model, motion.time, motion.x, slowest, drag, self.asleep))
        else:
            motion.look_at_regions()

    def look(self, motion: Motion, seams: SeamClosing) -> bool:
        """End a window if it is time to; whether it was. The seams are merged, but for those that stay open."""
        if not self._watch.due(motion.time):
            return False
        at_rest = self._watch.at_rest(motion.time, motion.x)
        movement = self._watch.movement or 0.0
        allowed = motion.scene.settings.rest_displacement
        if self.seeking and not at_rest:
            self._hopeless = self._why_hopeless(motion, seams, movement)
        if self.seeking and self.calming.active:
            if self.calming.ended(movement, allowed):
                self.open_window(motion)
            return True
        if not at_rest:
            self.calming.resume(movement, allowed)
        self.settled = at_rest
        if self.settled:
            acted_on = motion.body_motion is not None or bool(motion.grasps)
            self.asleep = self._has_settled and not acted_on and movement <= _NOTHING
            self._has_settled = self._has_settled or self.seeking
        return True

    def why_ended(self, motion: Motion) -> str:
        """Why a run to rest is over; empty if it is not."""
        settings = motion.scene.settings
        if self.settled:
            allowed, window = 1000 * settings.rest_displacement, settings.rest_window
            return f"no particle moved by more than {allowed:g} mm in {window:g} s"
        if motion.time >= settings.max_time:
            return f"not at rest after {motion.time:.3g} s, the longest time that the settings allow"
        if not self._hopeless and not motion.model.sewing and not motion.grasps:
            return why_unsupported(motion.model.scene, motion.x) or ""
        return self._hopeless

    def rest_time(self, time: float) -> float | None:
        """When rest is expected [s] if the movement per window goes on shrinking at the present rate; time is now."""
        movement, ratio = self._watch.movement, self._watch.ratio
        if self.settled:
            return time
        if movement is None or ratio is None or not 0.0 < ratio < 0.99:
            return None
        windows = math.log(max(self._watch.displacement / movement, 1e-9)) / math.log(ratio)
        return time + max(windows, 1.0) * self._watch.window

    def _why_hopeless(self, motion: Motion, seams: SeamClosing, movement: float) -> str:
        """Why a run whose last window moved something by that much [m] will not get there; empty if it may."""
        scene, number, x = motion.scene, motion.model.number, motion.x
        tightness, still_open = Tightness.of(motion.model, x), bool(seams.open_seams)
        self._tightness_watch.look(tightness)
        fallen = why_fallen(scene, number, x, self._watch.farthest)
        patience = self._tightness_watch.patience(still_open, seams.may_close)
        if not self._stall_watch.stalls(motion.time, movement, PATIENCE_WITH_FALLEN if fallen else patience):
            return ""
        since = self._stall_watch.since
        if fallen or self._tightness_watch.is_tight(still_open):
            return fallen or tightness.line
        return why_restless(scene.garment, number, x, self._watch, motion.time - since)


def _slowest_swing(motion: Motion) -> float:
    """Frequency of the slowest swing of a garment as high as it is now [rad/s]."""
    gravity = motion.scene.gravity
    height = float(np.ptp(motion.x @ np.array(gravity))) / max(float(np.linalg.norm(gravity)), 1e-12)
    return slowest_swing(gravity, height)
