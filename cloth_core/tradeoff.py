"""Cost against error for a scene: which runs are needed, what they say, and the cheapest setting that is good enough.

Error is the distance to the drape at the finest spacing (`drape_error`); what that one itself is estimated to lack
(`convergence`) and how far drapes differ that are equally right (spread) stand beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

from cloth_core.convergence import Convergence, fit_convergence
from cloth_core.drape_error import drape_error, motion_error
from cloth_core.errors import ClothError, SimulationError
from cloth_core.measured_run import MeasuredRun, RunRequest
from cloth_core.quality import INTEGRATORS, Settings
from cloth_core.scene_recipe import SceneRecipe

__all__ = ["DIALS", "Dial", "Plan", "SettingResult", "Tradeoff", "evaluate", "front", "plan_tradeoff"]


@dataclass(frozen=True)
class Dial:
    """A numerical setting that a trade-off varies.

    Attributes:
        name: on the command line.
        field: of `Settings`.
        values: tried instead of the setting's own value.
        unit: of the values as `Settings` has them, with the factor and the unit in which they are shown.
    """

    name: str
    field: str
    values: tuple[Any, ...]
    unit: tuple[float, str] = (1.0, "")

    def shown(self, value: Any) -> str:
        """The value as tables have it."""
        factor, unit = self.unit
        return f"{factor * value:g} {unit}".strip() if isinstance(value, (int, float)) else str(value)


# One line for each setting worth varying: its field, its values.
DIALS: tuple[Dial, ...] = (
    Dial("safety", "safety", (0.5,)),
    Dial("contact", "contact_offset", (0.002, 0.005), (1000.0, "mm")),
    Dial("push", "push_speed", (0.25, 1.0), (1.0, "m/s")),
    Dial("rest", "rest_displacement", (0.002, 0.0002), (1000.0, "mm")),
    Dial("drag", "settle_drag", (0.5, 8.0), (1.0, "1/s")),
    Dial("integrator", "integrator", tuple(name for name in INTEGRATORS if name != Settings().integrator)),
)

SPACINGS = (0.04, 0.03, 0.025, 0.02, 0.015, 0.0125, 0.01)
_SEEDS = (1, 2, 3)
# Spacings that are as good as the one between them, but make another grid.
_NEIGHBOURS = (0.98, 1.02)
# Shares of the stable time step at which the motion is compared, and the times [s].
_STEP_SHARES = (0.8, 0.4, 0.2)
_MOTION_TIMES = (0.1, 0.2, 0.3, 0.4)
# Costs nearer to each other than this are the same: so much do processor times of one and the same run differ.
_SAME_COST = 0.15


@dataclass(frozen=True)
class Plan:
    """The runs that a trade-off needs, by what they are for.

    Attributes:
        base: settings that each run but for what it varies has.
        drapes: the spacings at the base settings, coarsest first; the last is the reference.
        varied: (dial, value, request): one setting changed at a time.
        starts: the start disturbed, at `spread_spacing`.
        neighbours: spacings next to `spread_spacing`.
        motions: shares of the stable step at the coarsest spacing, with times; longest step first.
    """

    base: Settings
    drapes: tuple[RunRequest, ...]
    varied: tuple[tuple[Dial, Any, RunRequest], ...]
    starts: tuple[RunRequest, ...]
    neighbours: tuple[RunRequest, ...]
    motions: tuple[RunRequest, ...]

    @property
    def requests(self) -> tuple[RunRequest, ...]:
        """All of them."""
        return (*self.drapes, *(r for _, _, r in self.varied), *self.starts, *self.neighbours, *self.motions)


@dataclass(frozen=True)
class SettingResult:
    """A setting with its cost and its error.

    Attributes:
        name: what sets it apart.
        plain: whether nothing but the spacing was chosen.
        settings: the fields that differ from the default ones.
        cpu_seconds, wall_seconds, load: of the run; load of the machine when it began.
        particles, steps: counts.
        error, largest: distance to the reference, RMS and largest [m]; None for a run that came to no rest.
        on_front: whether nothing that is cheaper states as small an error.
        failed: why there is no error.
    """

    name: str
    plain: bool
    settings: dict[str, Any]
    cpu_seconds: float
    wall_seconds: float
    load: float
    particles: int | None
    steps: int | None
    error: float | None
    largest: float | None
    on_front: bool
    failed: str | None


@dataclass(frozen=True)
class Tradeoff:
    """What the runs of a plan say.

    Attributes:
        scene: its name.
        reference_spacing: of the drape that errors are held against [m].
        spacing_convergence, time_step_convergence: orders and what is left.
        spread_of_starts, spread_of_spacings: RMS distance of drapes whose start was moved by 0.1 mm, and of spacings
            2 % apart [m].
        spread: the larger of both: no smaller error can be told apart or promised.
        results: all settings, the cheapest first, those without an error last; the reference is not among them.
        reference_cpu_seconds: what the reference cost.
    """

    scene: str
    reference_spacing: float
    spacing_convergence: Convergence | None
    time_step_convergence: Convergence | None
    spread_spacing: float
    spread_of_starts: float
    spread_of_spacings: float
    results: tuple[SettingResult, ...]
    reference_cpu_seconds: float

    @property
    def spread(self) -> float:
        """The larger of both spreads [m]."""
        return max(self.spread_of_starts, self.spread_of_spacings)

    @property
    def reference_left(self) -> float:
        """Richardson's estimate of what the reference lacks [m]; 0 where refinement shows no order."""
        found = self.spacing_convergence
        return found.left if found is not None and found.converges and found.left is not None else 0.0

    def bound(self, result: SettingResult) -> float:
        """Error that can be stated for a setting [m]: measured and what the reference lacks, at least the spread.

        One drape is nearer than another by chance, too. So a coarser spacing is not said to be nearer than a finer one
        was found to be, nor a dial to bring a drape nearer by less than the spread.
        """
        if result.error is None:
            return math.inf
        spacing = result.settings["spacing"]
        as_fine = [r for r in self.results if r.plain and r.error is not None and r.settings["spacing"] <= spacing]
        error = max([result.error, *(r.error or 0.0 for r in as_fine)])
        same = next((r.error for r in as_fine if r.settings["spacing"] == spacing), None)
        if not result.plain and same is not None and result.error < same - self.spread:
            error = result.error
        return max(error + self.reference_left, self.spread)

    def cheapest(self, tolerance: float) -> SettingResult | None:
        """The cheapest setting whose stated error is within the tolerance [m]; at the same cost the plainest."""
        good = [r for r in self.results if r.error is not None and self.bound(r) <= tolerance]
        least = min((r.cpu_seconds for r in good), default=0.0)
        same = [r for r in good if r.cpu_seconds <= (1.0 + _SAME_COST) * least]
        return min(same, key=lambda r: (len(r.settings), r.cpu_seconds), default=None)

    def is_within_spread(self, result: SettingResult) -> bool:
        """Whether a setting's drape is no farther from the reference than equally right drapes are from each other."""
        return result.error is not None and 0.0 < self.bound(result) <= self.spread

    def advice(self, tolerance: float | None) -> str:
        """One line."""
        if tolerance is None:
            best = [r for r in self.results if r.on_front and r.error is not None]
            if not best:
                return "no setting came to rest; see the reasons in the table"
            # Where the front bends: more cost buys no more than the spread.
            enough = next((r for r in best if self.bound(r) <= 1.2 * self.bound(best[-1])), best[-1])
            return f"without a tolerance: {self._facts(enough)}"
        if tolerance < self.spread:
            return (
                f"tolerance {_mm(tolerance)}: drapes of this scene that are equally right differ by "
                f"{_mm(self.spread)}; no setting can promise less than that"
            )
        chosen = self.cheapest(tolerance)
        if chosen is None:
            return (
                f"tolerance {_mm(tolerance)}: none of the settings tried meets it; add a finer spacing than the finest"
            )
        return f"tolerance {_mm(tolerance)}: the cheapest setting is {self._facts(chosen)}"

    def _facts(self, result: SettingResult) -> str:
        chance = ""
        if self.is_within_spread(result):
            chance = " (as far as equally right drapes are apart: nothing dearer is measurably nearer)"
        arguments = ", ".join(f"{key}={value!r}" for key, value in result.settings.items())
        return (
            f"{result.name}, error {_mm(self.bound(result))}{chance}, {_seconds(result.cpu_seconds)}; "
            f"in Python Settings({arguments})"
        )


def plan_tradeoff(
    recipe: SceneRecipe,
    base: Settings | None = None,
    spacings: Sequence[float] = SPACINGS,
    dials: Sequence[Dial] = DIALS,
) -> Plan:
    """The runs for spacings [m], the finest of which is the reference, and for one dial changed at a time.

    Each dial is varied at the coarsest spacing and at the middle one: what is good at both is likely to be so between
    and beyond them, at a small part of the cost of all combinations.

    Raises:
        ClothError: fewer than three spacings.
    """
    base = base if base is not None else Settings()
    ordered = sorted(set(spacings), reverse=True)
    if len(ordered) < 3:
        raise ClothError("tradeoff: convergence needs at least three spacings; give more")
    middle = ordered[len(ordered) // 2]
    at = {h: replace(base, spacing=h) for h in ordered}

    def request(settings: Settings, seed: int = 0, times: tuple[float, ...] = ()) -> RunRequest:
        return RunRequest(recipe, settings, seed, times)

    return Plan(
        base=base,
        drapes=tuple(request(at[h]) for h in ordered),
        varied=tuple(
            (dial, value, request(replace(at[h], **{dial.field: value})))
            for dial in dials
            for value in dial.values
            for h in (ordered[0], middle)
            if value != getattr(base, dial.field)
        ),
        starts=tuple(request(at[middle], seed) for seed in _SEEDS),
        neighbours=tuple(request(replace(base, spacing=f * middle)) for f in _NEIGHBOURS),
        motions=tuple(request(replace(at[ordered[0]], safety=s), times=_MOTION_TIMES) for s in _STEP_SHARES),
    )


def evaluate(plan: Plan, runs: Sequence[MeasuredRun]) -> Tradeoff:
    """What the runs of a plan say; `runs` in the order of `plan.requests`.

    Raises:
        SimulationError: the reference did not come to rest, so that there is nothing to hold the others against.
    """
    waiting = iter(runs)
    drapes = [next(waiting) for _ in plan.drapes]
    varied = [(dial, value, next(waiting)) for dial, value, _ in plan.varied]
    starts = [next(waiting) for _ in plan.starts]
    neighbours = [next(waiting) for _ in plan.neighbours]
    motions = [next(waiting) for _ in plan.motions]
    reference = drapes[-1]
    if reference.failed is not None:
        raise SimulationError(
            f"the reference at {1000 * reference.spacing:g} mm spacing: {reference.failed}; without a drape at rest "
            "there is nothing to compare with: give the scene a support, a longer --max-time or other spacings"
        )
    middle = next(run for run in drapes if run.spacing == plan.starts[0].settings.spacing)
    spread_of_starts = _rms_distance([middle, *starts])
    spread_of_spacings = _rms_distance([middle, *neighbours])
    spread = max(spread_of_starts, spread_of_spacings)
    resting = [run for run in drapes if run.failed is None]
    between = {(a.spacing, b.spacing): drape_error(a.drape, b.drape).rms for a, b in combinations(resting, 2)}
    moving = [run for run in motions if run.failed is None]
    steps = {
        (float(a.facts["settings"]["safety"]), float(b.facts["settings"]["safety"])): motion_error(a.frames, b.frames)[
            1
        ]
        for a, b in combinations(moving, 2)
    }
    results = [_result("", run, reference) for run in drapes[:-1]]
    results += [_result(f"{dial.name} {dial.shown(value)}", run, reference) for dial, value, run in varied]
    found = Tradeoff(
        scene=str(reference.facts["scene_name"]),
        reference_spacing=reference.spacing,
        spacing_convergence=fit_convergence(between, spread) if len(resting) >= 3 else None,
        time_step_convergence=fit_convergence(steps) if len(moving) >= 3 else None,
        spread_spacing=middle.spacing,
        spread_of_starts=spread_of_starts,
        spread_of_spacings=spread_of_spacings,
        results=tuple(sorted(results, key=lambda r: (r.error is None, r.cpu_seconds))),
        reference_cpu_seconds=reference.cpu_seconds,
    )
    best = front([(r.cpu_seconds, found.bound(r), len(r.settings)) for r in found.results])
    return replace(found, results=tuple(replace(r, on_front=k in best) for k, r in enumerate(found.results)))


def front(points: Sequence[tuple[float, float, int]]) -> set[int]:
    """Indices of the (cost, stated error, number of settings changed) that nothing cheaper equals in error.

    Of those whose cost cannot be told apart the nearest is taken, and of equally near ones the plainest: neither a
    difference within the spread nor one within the noise of processor time is a reason to turn a dial.
    """
    left = {k for k, (_, error, _) in enumerate(points) if error < math.inf}
    chosen = set()
    while left:
        least = min(points[k][0] for k in left)
        same = [k for k in left if points[k][0] <= (1.0 + _SAME_COST) * least]
        best = min(same, key=lambda k: (points[k][1], points[k][2], points[k][0], k))
        chosen.add(best)
        left = {k for k in left if points[k][1] < points[best][1]}
    return chosen


def _result(dial: str, run: MeasuredRun, reference: MeasuredRun) -> SettingResult:
    error = drape_error(run.drape, reference.drape) if run.failed is None else None
    default = Settings()
    changed = {
        key: value
        for key, value in run.facts["settings"].items()
        if key == "spacing" or (value != getattr(default, key, None) and not key.startswith("expected"))
    }
    return SettingResult(
        name=f"spacing {1000 * run.spacing:g} mm" + (f", {dial}" if dial else ""),
        plain=not dial,
        settings=changed,
        cpu_seconds=run.cpu_seconds,
        wall_seconds=float(run.facts["wall_seconds"]),
        load=float(run.facts["load"]),
        particles=run.facts.get("particles"),
        steps=run.facts.get("steps"),
        error=None if error is None else error.rms,
        largest=None if error is None else error.largest,
        on_front=False,
        failed=run.failed,
    )


def _rms_distance(runs: Sequence[MeasuredRun]) -> float:
    """RMS of the distances of all pairs of those that are at rest."""
    good = [run for run in runs if run.failed is None]
    squares = [drape_error(a.drape, b.drape).rms ** 2 for a, b in combinations(good, 2)]
    return math.sqrt(sum(squares) / len(squares)) if squares else 0.0


def _mm(length: float) -> str:
    return f"{1000 * length:.2g} mm"


def _seconds(seconds: float) -> str:
    return f"{seconds:.2g} s of processor time"
