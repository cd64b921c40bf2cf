"""Each term's share of the time of a step, from what the compiled parts take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cloth_core.model import Term

__all__ = ["term_shares"]

# Families that one loop runs over, but for what has one of its own; its time is shared out by their numbers.
_ONE_LOOP = ("structural springs", "shear springs", "bending springs", "sewing smoothness")
# Terms that are a factor or a branch inside another one's loop: they take no time that could be told apart.
_WITHIN = {
    "spring damping": "structural springs",
    "friction": "body contact",
    "pins": "gravity",
}
WHOLE_STEP = "step"


def term_shares(terms: Sequence[Term], costs: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """For each term: microseconds per step, share of the step's time, and in which other term's time it is counted.

    Args:
        terms: of a model.
        costs: measured microseconds per step of each loop by the term's name, and of the whole step as "step".

    Returns:
        name -> {"microseconds_per_step", "share", "within"}. A term that is off takes 0; one that is counted within
        another has no time of its own (None).
    """
    active = {t.name: t for t in terms if t.active}
    microseconds: dict[str, float] = {name: cost for name, cost in costs.items() if name in active}
    if "self contact" in active and "body contact" not in active and "body contact" in costs:
        microseconds["self contact"] = costs["body contact"]  # one loop resolves both
    loop = costs.get(_ONE_LOOP[0])
    springs = [active[name] for name in _ONE_LOOP if name in active and (name == _ONE_LOOP[0] or name not in costs)]
    count = sum(t.elements for t in springs)
    if loop is not None and count > 0:
        microseconds.update({t.name: loop * t.elements / count for t in springs})
    whole = max(costs.get(WHOLE_STEP, 0.0), sum(microseconds.values()))
    found: dict[str, dict[str, Any]] = {}
    for t in terms:
        within = _WITHIN.get(t.name) if t.active else None
        if t.name == "self contact" and t.name not in costs and "body contact" in active:
            within = "body contact"
        # What has no loop of its own takes nothing: seams that are merged.
        own = None if within is not None else microseconds.get(t.name, 0.0) if t.active else 0.0
        share = None if own is None else (own / whole if whole > 0.0 else 0.0)
        found[t.name] = {"microseconds_per_step": own, "share": share, "within": within}
    return found
