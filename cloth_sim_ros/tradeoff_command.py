"""What `cloth-sim tradeoff` does: plans the runs, does what is missing, writes the files, prints the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click

from cloth_core.errors import ClothError
from cloth_core.quality import Settings
from cloth_core.run_series import run_series
from cloth_core.scene_recipe import SceneRecipe
from cloth_core.tradeoff import DIALS, SPACINGS, Dial, Tradeoff, evaluate, plan_tradeoff
from cloth_core.tradeoff_files import check_plots, write_tradeoff
from cloth_sim_ros.run_progress import Interruption, ProgressDisplay

__all__ = ["run_tradeoff"]


def run_tradeoff(
    patterns: Sequence[str],
    *,
    body: str | None,
    fabric: str,
    quality: str | None,
    tolerance: float | None,
    gravity: float,
    air_drag: float,
    max_time: float | None,
    without: tuple[str, ...],
    output: str,
    spacings: str | None,
    vary: str | None,
    processes: int | None,
) -> None:
    """Runs the command with its options as they come from the command line; tolerance in mm.

    Raises:
        ClothError: an option makes no sense, or the runs cannot be done.
    """
    if quality is not None:
        raise ClothError("--quality: a trade-off tries all of them; leave it out")
    recipe = SceneRecipe(tuple(patterns), body, fabric, gravity, air_drag, without=without)
    base = Settings() if max_time is None else replace(Settings(), max_time=max_time)
    chosen, dials = _spacings(spacings), _dials(vary)
    plan = plan_tradeoff(recipe, base, chosen, dials)
    folder = Path(output)
    limit = None if tolerance is None else tolerance / 1000.0
    with ProgressDisplay() as display, Interruption() as interruption:
        display.step(f"reading {recipe.name}")
        scene = recipe.build(plan.drapes[0].settings)  # what is wrong with the scene is said before anything runs
        if vary is None and scene.garment.seams:  # implicit steps sew none
            plan = plan_tradeoff(recipe, base, chosen, [dial for dial in dials if dial.field != "integrator"])

        def show(done: float, whole: float, runs: int, all_runs: int) -> None:
            display.share(f"{runs} of {all_runs} runs, {{done}} % of the work", 100.0 * done / whole, 100.0)

        runs = run_series(
            plan.requests,
            folder / "runs",
            processes=processes,
            on_progress=show,
            should_stop=lambda: interruption.asked,
        )
        display.step("comparing the drapes")
        found = evaluate(plan, runs)
        paths = write_tradeoff(found, folder, limit)
    _print(found)
    missing = check_plots()
    if missing is not None:
        click.echo(f"cloth-sim: warning: {missing}", err=True)
    for path in paths:
        click.echo(f"wrote {path}")
    click.echo(found.advice(limit))


def _spacings(text: str | None) -> tuple[float, ...]:
    if text is None:
        return SPACINGS
    try:
        values = tuple(float(part) / 1000.0 for part in text.split(","))
    except ValueError:
        raise ClothError(f"--spacings '{text}': not a list of numbers; write it like 40,25,15") from None
    if not all(math.isfinite(v) and v > 0.0 for v in values):
        raise ClothError(f"--spacings '{text}': each must be a positive number of millimetres")
    return values


def _dials(text: str | None) -> tuple[Dial, ...]:
    if text is None:
        return DIALS
    names = [] if text == "none" else text.split(",")
    known = {dial.name: dial for dial in DIALS}
    for name in names:
        if name not in known:
            raise ClothError(f"--vary '{name}': not known; use some of {', '.join(known)}, or none")
    return tuple(known[name] for name in names)


def _print(found: Tradeoff) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"{found.scene}: the front of cost and error"), title_justify="left")
    for heading in ("setting", "CPU s", "wall s", "error RMS mm", "largest mm", "stated mm"):
        table.add_column(heading, justify="left" if heading == "setting" else "right")
    for r in found.results:
        if r.on_front and r.error is not None and r.largest is not None:
            numbers = (r.cpu_seconds, r.wall_seconds, 1000 * r.error, 1000 * r.largest, 1000 * found.bound(r))
            table.add_row(Text(r.name), *(f"{n:.2f}" for n in numbers))
    Console().print(table)
    click.echo(f"spread of drapes that are equally right: {1000 * found.spread:.2f} mm")
