"""A trade-off as files: JSON for programs, a table in Markdown, a plot of the front."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from cloth_core.convergence import Convergence
from cloth_core.errors import ClothError
from cloth_core.measured_run import core_version, machine_class
from cloth_core.tradeoff import SettingResult, Tradeoff

__all__ = ["as_dict", "as_markdown", "check_plots", "write_plot", "write_tradeoff"]

NO_PLOTS = "the plot needs matplotlib, which is not installed; `pip install 'cloth_sim_ros[plots]'` adds it"


def as_dict(tradeoff: Tradeoff, tolerance: float | None = None) -> dict[str, Any]:
    """As JSON types, SI units."""
    chosen = tradeoff.cheapest(tolerance) if tolerance is not None else None
    return {
        "scene": tradeoff.scene,
        "machine": machine_class(),
        "core": core_version(),
        "reference_spacing": tradeoff.reference_spacing,
        "reference_cpu_seconds": tradeoff.reference_cpu_seconds,
        "reference_left": tradeoff.reference_left,
        "convergence": {
            "spacing": None if tradeoff.spacing_convergence is None else tradeoff.spacing_convergence.to_dict(),
            "time_step": None if tradeoff.time_step_convergence is None else tradeoff.time_step_convergence.to_dict(),
        },
        "spread": {
            "at_spacing": tradeoff.spread_spacing,
            "start_moved_by_0.1_mm": tradeoff.spread_of_starts,
            "spacing_changed_by_2_percent": tradeoff.spread_of_spacings,
        },
        "settings": [{**asdict(r), "stated_error": _finite(tradeoff.bound(r))} for r in tradeoff.results],
        "tolerance": tolerance,
        "cheapest": None if chosen is None else chosen.settings,
        "advice": tradeoff.advice(tolerance),
    }


def as_markdown(tradeoff: Tradeoff, tolerance: float | None = None) -> str:
    """Tables for people."""
    lines = [
        f"# {tradeoff.scene}: cost against error",
        "",
        f"**{tradeoff.advice(tolerance)}**",
        "",
        f"Error: distance to the drape at {1000 * tradeoff.reference_spacing:g} mm spacing, panel against panel, both "
        f"ways; that one took {tradeoff.reference_cpu_seconds:.1f} s of processor time. Measured on {machine_class()}.",
        "",
        "| setting | particles | CPU s | wall s | load | error RMS mm | largest mm | stated mm | on the front |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_row(tradeoff, result) for result in tradeoff.results),
        "",
        f"- Spread of drapes that are equally right, at {1000 * tradeoff.spread_spacing:g} mm: "
        f"{1000 * tradeoff.spread_of_starts:.2f} mm (start moved by 0.1 mm), "
        f"{1000 * tradeoff.spread_of_spacings:.2f} mm (spacing changed by 2 %). No smaller error can be promised.",
        f"- Spacing: {_order(tradeoff.spacing_convergence)}",
        f"- Time step, of the motion: {_order(tradeoff.time_step_convergence)}",
        "",
        "Stated: error RMS and what the reference itself is estimated to lack, at least the spread. Each setting is "
        "one drape, near or far by chance, too: a coarser spacing is not said to be nearer than a finer one was found "
        "to be, nor a dial to gain less than the spread. Processor times differ by up to 15 % from run to run. On the "
        "front: what nothing cheaper equals in stated error.",
    ]
    return "\n".join(lines) + "\n"


def write_tradeoff(tradeoff: Tradeoff, folder: Path, tolerance: float | None = None) -> list[Path]:
    """Write tradeoff.json, tradeoff.md and, with matplotlib, tradeoff.png; the paths.

    Raises:
        ClothError: the folder cannot be written.
    """
    paths = [folder / "tradeoff.json", folder / "tradeoff.md"]
    try:
        paths[0].write_text(
            json.dumps(as_dict(tradeoff, tolerance), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        paths[1].write_text(as_markdown(tradeoff, tolerance), encoding="utf-8")
        if find_spec("matplotlib") is not None:
            paths.append(folder / "tradeoff.png")
            write_plot(tradeoff, paths[-1], tolerance)
    except OSError as error:
        raise ClothError(f"'{error.filename or folder}': {error.strerror}; choose another directory") from None
    return paths


def check_plots() -> str | None:
    """Why there will be no plot, or None."""
    return None if find_spec("matplotlib") is not None else NO_PLOTS


def write_plot(tradeoff: Tradeoff, path: Path, tolerance: float | None = None) -> None:
    """Error over cost; the front by stated errors, which are nowhere below the spread.

    Raises:
        ClothError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ClothError(f"tradeoff: {NO_PLOTS}") from None
    figure = Figure(figsize=(8, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    good = [r for r in tradeoff.results if r.error is not None]
    best = [r for r in good if r.on_front]
    axes.loglog([r.cpu_seconds for r in good], [1000 * (r.error or 0.0) for r in good], "o", color="0.6", label="tried")
    stated = [1000 * tradeoff.bound(r) for r in best]
    axes.loglog([r.cpu_seconds for r in best], stated, "o-", color="C0", label="on the front, as stated")
    for r, y in zip(best, stated, strict=True):
        axes.annotate(r.name, (r.cpu_seconds, y), xytext=(4, 4), textcoords="offset points", fontsize=8)
    label = "within the spread of equally right drapes:\nwhat is lower here is not better"
    if tradeoff.spread > 0.0:
        axes.axhline(1000 * tradeoff.spread, color="C3", linestyle=":")
    if tolerance is not None:
        axes.axhline(1000 * tolerance, color="C2", linestyle="--", label="tolerance")
    axes.margins(0.12)
    low, high = axes.get_ylim()
    if tradeoff.spread > low / 1000:
        axes.axhspan(low, 1000 * tradeoff.spread, color="C3", alpha=0.12, zorder=0, label=label)
        axes.set_ylim(low, high)
    axes.set_xlabel("processor time of a drape [s]")
    axes.set_ylabel(f"RMS distance to {1000 * tradeoff.reference_spacing:g} mm spacing [mm]")
    axes.set_title(tradeoff.scene, fontsize=10)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _row(tradeoff: Tradeoff, r: SettingResult) -> str:
    if r.error is None or r.largest is None:
        shown = f"| | | {' '.join((r.failed or '').split())} |"
    else:
        shown = f"| {1000 * r.error:.2f} | {1000 * r.largest:.1f} | {1000 * tradeoff.bound(r):.2f} |"
    return (
        f"| {r.name} | {'' if r.particles is None else r.particles} | {r.cpu_seconds:.2f} | {r.wall_seconds:.2f} "
        f"| {r.load:.1f} {shown} {'yes' if r.on_front else ''} |"
    )


def _order(found: Convergence | None) -> str:
    if found is None:
        return "not enough runs came to rest to tell an order."
    if found.order is None:
        return "the distances follow no power of it; there is no order."
    if found.within_spread:
        return "no order can be told: the finest two differ no more than equally right drapes do."
    told = f"order {found.order:.2f}, misfit of the power law {100 * found.misfit:.0f} %"
    if not found.converges:
        return f"{told}: too uneven to count as convergence."
    return f"{told}; {1000 * (found.left or 0.0):.2g} mm is estimated to be left at the finest."


def _finite(value: float) -> float | None:
    return value if value < float("inf") else None
