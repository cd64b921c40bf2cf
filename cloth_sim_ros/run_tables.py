"""Tables that the command line prints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

if TYPE_CHECKING:
    from cloth_core.report import Report

__all__ = ["print_explanation", "print_report"]


def print_report(report: Report) -> None:
    """Prints what a run did."""
    speed = report.simulated_time / report.wall_time if report.wall_time > 0.0 else 0.0
    rows = [
        ("fabric", report.fabric),
        ("particles, triangles, springs", f"{report.particles}, {report.triangles}, {report.springs}"),
        ("at rest", f"{'yes' if report.settled else 'NO'}: {report.rest_reason}"),
        ("simulated time", f"{report.simulated_time:.3f} s in {report.steps} steps of {1e6 * report.time_step:.3g} µs"),
        ("wall time", f"{report.wall_time:.1f} s ({speed:.2g} x real time)"),
        ("largest strain", f"{100 * report.max_strain:.2f} % (fabric's limit {100 * report.strain_limit:g} %)"),
        ("expected error", _expected(report.expected_error, report.expected_error_source)),
        ("largest seam gap", f"{1000 * report.max_seam_gap:.3g} mm"),
        ("edges through the body", str(report.body_intersections)),
        ("edges of the body through cloth", str(report.body_edges_through_cloth)),
        ("edges through cloth", str(report.self_intersections)),
        ("deepest penetration", f"{1000 * report.max_penetration:.3g} mm"),
    ]
    if report.gate is not None:
        rows.append(("gate", "passed" if report.gate["passed"] else f"FAILED: {'; '.join(report.gate['failed'])}"))
    _print_rows(f"{report.garment} on {report.body or 'no body'}", rows)


def print_explanation(facts: dict[str, Any]) -> None:
    """Prints what a run would consist of: `Simulation.describe` with the measured cost of a step."""
    stable = facts["stable_time_step"]
    rows = [
        ("fabric", facts["fabric"]),
        ("panels", ", ".join(facts["panels"])),
        ("seams", str(facts["seams"])),
        ("particle spacing", f"{1000 * facts['spacing']:.3g} mm"),
        ("expected error", _expected(facts["expected_error"], facts["expected_error_source"])),
        ("particles, triangles, springs", f"{facts['particles']}, {facts['triangles']}, {facts['springs']}"),
        ("area, mass", f"{facts['area']:.4g} m², {facts['mass']:.4g} kg"),
        ("stable time step", "unlimited" if stable is None else f"{1e6 * stable:.4g} µs"),
        ("time step in use", f"{1e6 * facts['time_step']:.4g} µs"),
        ("cost of a step", f"{1e6 * facts['seconds_per_step']:.3g} µs"),
        ("cost of a simulated second", f"{facts['seconds_per_simulated_second']:.3g} s"),
    ]
    _print_rows(f"{facts['garment']} on {facts['body'] or 'no body'}", rows)
    _print_terms(facts["terms"])


def _expected(error: float | None, source: str) -> str:
    return source if error is None else f"{1000 * error:.2g} mm ({source})"


def _print_rows(title: str, rows: Sequence[tuple[str, str]]) -> None:
    table = Table(title=Text(title), show_header=False, title_justify="left")
    for name, value in rows:
        table.add_row(Text(name), Text(value))
    Console().print(table)


def _print_terms(terms: dict[str, dict[str, Any]]) -> None:
    table = Table(
        Column("term", no_wrap=True),
        "on",
        "elements",
        "µs a step",
        "share",
        "reason",
        title="terms",
        title_justify="left",
    )
    for name, term in terms.items():
        cost, share, reason = "", "", term["missed"] or term["reason"]
        if term["within"] is not None:
            reason += f" (time: see {term['within']})"
        elif term["active"]:
            cost, share = f"{term['microseconds_per_step']:.1f}", f"{100 * term['share']:.1f} %"
        on = "yes" if term["active"] else "no"
        table.add_row(name, on, str(term["elements"]), cost, share, Text(reason))
    Console().print(table)
