"""`cloth-sim stability`: the predicted stable time step against the one from which a scene really blows up."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cloth_core.errors import ClothError
from cloth_sim_ros.run_progress import Interruption, ProgressDisplay

if TYPE_CHECKING:
    from cloth_core.blow_up import BlowUp
    from cloth_core.stability_cases import StabilityCase

__all__ = ["LOWEST_RATIO", "stability", "write_results"]

LOWEST_RATIO = 0.8
"""Below this share of the measured limit a prediction wastes steps; above 1 it is unsafe."""


@click.command()
@click.option(
    "--output", "-o", type=click.Path(file_okay=False, path_type=Path), required=True, metavar="DIR",
    help="Directory for stability.json, stability.md and stability.png.",
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Every other case and sheets of up to 50 x 50 particles: under a minute.")
def stability(output: Path, quick: bool) -> None:
    """Measures over the extremes how long a time step may be, and compares it with what the model predicts.

    Stiffness from 1e-3 to 1e8 N/m, mass ratios up to 1e6, damping up to overdamped, sheets of 2 x 2 to 500 x 500
    particles, slivers, each term alone, all together with contact. Takes some minutes. Exit code 1 where a prediction
    is above the measured step or below 0.8 of it.
    """
    from cloth_core.stability_cases import stability_cases

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ClothError(f"'{output}': {error.strerror}; name a directory that can be made") from None
    cases = stability_cases(quick)
    results: list[tuple[StabilityCase, BlowUp]] = []
    with ProgressDisplay() as display, Interruption() as interruption:
        display.step("measuring (the first run after an installation compiles, which takes longer)")
        for k, case in enumerate(cases):
            if interruption.asked:
                break
            display.share(f"{{done}} of {{total}} cases: {case.group}, {case.name}".replace("%", ""), k, len(cases))
            results.append((case, case.run()))
    if not results:
        raise click.Abort
    written = write_results(results, output)
    wrong = [(case, found) for case, found in results if not LOWEST_RATIO <= found.ratio <= 1.0]
    ratios = [found.ratio for _, found in results]
    click.echo(f"{len(results)} cases: predicted / measured from {min(ratios):.3f} to {max(ratios):.3f}")
    for path in written:
        click.echo(f"wrote {path}")
    if len(results) < len(cases):
        raise click.Abort
    if wrong:
        case, found = wrong[0]
        # A failed run, told as one by the exit code.
        from cloth_core.errors import SimulationError

        raise SimulationError(
            f"{case.group}, {case.name}: predicted {found.predicted:.4g} s, measured {found.measured:.4g} s; "
            f"{len(wrong)} of {len(results)} cases lie outside {LOWEST_RATIO:g} to 1; see stability.md"
        )


def write_results(results: list[tuple[StabilityCase, BlowUp]], output: Path) -> list[Path]:
    """Writes the table, the JSON and, where matplotlib is installed, the picture; the files written."""
    from cloth_core.mesh_files import write_file

    rows = [_row(case, found) for case, found in results]
    table, data, picture = (output / f"stability.{suffix}" for suffix in ("md", "json", "png"))
    write_file(table, _table(rows).encode())
    write_file(data, (json.dumps({"cases": rows}, indent=2, allow_nan=False) + "\n").encode())
    try:
        from cloth_sim_ros.stability_picture import draw_stability
    except ModuleNotFoundError as error:
        click.echo(
            f"cloth-sim: warning: no picture, {error.name} is not installed; `pip install 'cloth_sim_ros[plots]'`",
            err=True,
        )
        return [table, data]
    draw_stability(picture, rows)
    return [table, data, picture]


def _row(case: StabilityCase, found: BlowUp) -> dict[str, Any]:
    """One case as JSON types, SI units."""
    return {"group": case.group, "value": case.value, "case": case.name, **asdict(found), "ratio": found.ratio}


def _table(rows: list[dict[str, Any]]) -> str:
    """A Markdown table."""
    lines = [
        "# Stable time step: predicted from the model, and measured by bisection",
        "",
        "| varied | case | particles | damping ratio | predicted [s] | blows up at [s] | predicted / measured |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['group']} | {row['case']} | {row['particles']} | {row['damping_ratio']:.3g} | "
        f"{row['predicted']:.4g} | {row['measured']:.4g} | {row['ratio']:.3f} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"
