"""Puts the measured tables into docs/accuracy.md, between its markers: from the calibration and from its check.

python benchmarks/accuracy_tables.py
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "cloth_core" / "data" / "calibration.json"
CHECK = ROOT / "benchmarks" / "calibration_check.json"
PAGE = ROOT / "docs" / "accuracy.md"


def main() -> int:
    """Rewrite the page; the exit code."""
    text = PAGE.read_text(encoding="utf-8")
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    text = put(text, "measured", measured(table) + promises(table))
    if CHECK.exists():
        text = put(text, "check", checked(json.loads(CHECK.read_text(encoding="utf-8"))))
    PAGE.write_text(text, encoding="utf-8")
    return 0


def put(text: str, name: str, lines: list[str]) -> str:
    """Replace what stands between the markers of a name."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    body = "\n".join([begin, *lines, end])
    return re.sub(f"{re.escape(begin)}.*?{re.escape(end)}", lambda _: body, text, flags=re.DOTALL)


def measured(table: dict[str, Any]) -> list[str]:
    """Errors, spread and order of each calibrated scene."""
    source = table["provenance"]
    scenes = source["measured"]
    spacings = sorted({float(h) for scene in scenes for h in scene["errors"]}, reverse=True)
    shown = " | ".join(f"{1000 * h:g} mm" for h in spacings)
    lines = [
        f"RMS distance [mm] to the drape at {1000 * source['reference_spacing']:g} mm spacing, and CPU seconds to rest",
        f"({source['date'][:10]}, {source['machine']}):",
        "",
        f"| scene | {shown} | spread | order in spacing |",
        "|" + "---|" * (len(spacings) + 3),
    ]
    for scene in scenes:
        cells = []
        for h in spacings:
            error, cpu = scene["errors"].get(f"{h:g}"), scene["cpu_seconds"].get(f"{h:g}")
            cells.append("no rest" if error is None else f"{1000 * error:.1f} ({cpu:.1f} s)")
        found = scene["convergence"]
        if found is None or found["order"] is None:
            order = "none"
        else:
            order = f"{found['order']:.2f}" + ("" if found["converges"] else ", not convergence")
        # There is none where fewer than two of the starts came to rest.
        spread = f"{1000 * scene['spread']:.1f}" if scene["spread"] > 0.0 else "-"
        lines.append(f"| {scene['scene']} | {' | '.join(cells)} | {spread} | {order} |")
    return [*lines, ""]


def promises(table: dict[str, Any]) -> list[str]:
    """What is promised, from the table."""
    shown = " | ".join(f"{1000 * h:g} mm" for h in table["spacings"])
    lines = [
        f"Promise [mm]: typical error times {table['factor']:.2f}, and at least the largest spread, "
        f"{1000 * table['spread']:.1f} mm:",
        "",
        f"| fabric, area of the garment | {shown} |",
        "|" + "---|" * (len(table["spacings"]) + 1),
    ]
    for name, rows in table["typical_error"].items():
        for area, row in zip(table["areas"], rows, strict=True):
            promised, most = [], 0.0
            for error in row:
                most = max(most, error)
                promised.append(max(most * table["factor"], table["spread"]))
            lines.append(f"| {name}, {area:.2g} m² | {' | '.join(f'{1000 * p:.1f}' for p in promised)} |")
    return lines


def checked(check: dict[str, Any]) -> list[str]:
    """The held-back cases."""
    known = [case for case in check["cases"] if case["kept"] is not None]
    kept = sum(case["kept"] for case in known)
    lost = len(check["cases"]) - len(known)
    lines = [
        f"{kept} of {len(known)} promises to held-back scenes were kept ({check['date'][:10]}, against "
        f"{1000 * check['reference_spacing']:g} mm); {lost} more runs came to no rest and count neither way:",
        "",
        "| scene | spacing mm | promised mm | found mm | kept |",
        "|---|---|---|---|---|",
    ]
    for case in check["cases"]:
        found = case["failed"] if case["error"] is None else f"{1000 * case['error']:.1f}"
        kept_word = {True: "yes", False: "no", None: ""}[case["kept"]]
        lines.append(
            f"| {case['scene']} | {1000 * case['spacing']:.1f} | {1000 * case['promise']:.1f} | {found} | {kept_word} |"
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
