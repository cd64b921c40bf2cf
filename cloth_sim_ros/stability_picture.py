"""The map of `cloth-sim stability`: one panel for each thing varied. Needs matplotlib (extra `plots`)."""

from __future__ import annotations

import math
from itertools import groupby
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

__all__ = ["draw_stability"]

_COLUMNS = 4
_PREDICTED, _MEASURED = "#1f5fa8", "#c8501e"


def draw_stability(path: Path, rows: list[dict[str, Any]]) -> None:
    """Draws both steps over what is varied, with the ratio of each case beside its point.

    Args:
        path: the PNG to write.
        rows: as in stability.json, those of one group next to each other.
    """
    groups = [(name, list(members)) for name, members in groupby(rows, key=lambda row: str(row["group"]))]
    height = math.ceil(len(groups) / _COLUMNS)
    figure = Figure(figsize=(4.0 * _COLUMNS, 3.6 * height), layout="constrained")
    for k, (name, members) in enumerate(groups):
        axes = figure.add_subplot(height, _COLUMNS, k + 1)
        named = name in ("one term alone", "all terms together")
        values = [row["value"] for row in members]
        x = values if not any(v <= 0.0 for v in values) and not named else list(range(len(members)))
        axes.plot(x, [row["measured"] for row in members], "o", color=_MEASURED, markersize=7, label="measured")
        axes.plot(x, [row["predicted"] for row in members], ".", color=_PREDICTED, markersize=6, label="predicted")
        axes.set_yscale("log")
        if x is values and max(values) > 20.0 * min(values):
            axes.set_xscale("log")
        elif named:
            axes.set_xticks(x, [row["case"] for row in members], rotation=35, ha="right", fontsize=7)
        elif x is not values:
            wanted = range(0, len(members), max(len(members) // 8, 1))
            axes.set_xticks([x[k] for k in wanted], [f"{values[k]:g}" for k in wanted])
        ratios = [row["ratio"] for row in members]
        axes.set_title(f"{name}\npredicted / measured {min(ratios):.3f} to {max(ratios):.3f}", fontsize=9)
        axes.set_ylabel("time step [s]", fontsize=8)
        axes.tick_params(which="both", labelsize=7)
        axes.grid(alpha=0.3)
        if k == 0:
            axes.legend(fontsize=8)
    figure.savefig(path, dpi=80)
