"""Drapes garments on bodies in fabrics, through the gate, and writes the table of contact: docs/contact.md.

    python benchmarks/contact_table.py --jobs 2 --pictures close_ups my_pattern.json

Every case is one row and one file of results; cases that have one are not run again, so that a broken-off run goes on
where it was. Pattern files are run besides the built-in garments; `--only` and `--quality draft` make a quick trial.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import platform
import re
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
BODIES = ("young", "middle_aged", "elderly")
FABRICS = ("cotton_poplin", "denim", "silk")
GARMENTS = ("tshirt", "skirt", "trousers", "dress")
# A particle counts as lying on the body up to this many contact offsets.
ON_THE_BODY = 1.2


@dataclass(frozen=True)
class Case:
    """One run. `patterns` are built-in names or files, the innermost garment first."""

    patterns: tuple[str, ...]
    body: str
    fabric: str
    quality: str

    @property
    def garment(self) -> str:
        """Without the directories of files."""
        return " + ".join(Path(p).stem.removesuffix("_specification") for p in self.patterns)

    @property
    def stem(self) -> str:
        """Name of the result file."""
        text = "-".join([*self.garment.split(" + "), self.body, self.fabric, self.quality])
        return re.sub(r"[^A-Za-z0-9_-]+", "_", text)


def run_case(case: Case, pictures: str | None, wall_time: float) -> dict[str, Any]:
    """Drape, judge, measure and draw one case; whatever goes wrong becomes a row too."""
    from cloth_core.body import Body
    from cloth_core.errors import ClothError
    from cloth_core.fabric import Fabric
    from cloth_core.pattern import Pattern
    from cloth_core.scene import Scene

    began = time.monotonic()
    row: dict[str, Any] = {**asdict(case), "garment": case.garment}
    try:
        body = Body.load(case.body)
        patterns = [Pattern.load(p) for p in case.patterns]
        scene = Scene.build(patterns, body, Fabric.preset(case.fabric), quality=case.quality)
        row |= _drape(scene, began + wall_time)
    except ClothError as error:
        return {**row, "error": str(error)}
    mesh = row.pop("mesh")
    if pictures is not None:
        draw_close_ups(Path(pictures), case, mesh, (body.vertices, body.triangles))
    return row


def _drape(scene: Any, deadline: float) -> dict[str, Any]:
    from cloth_core.errors import SimulationError
    from cloth_core.gate import frame_movement, judge
    from cloth_core.simulation import Simulation

    simulation = Simulation(scene)
    failure, movement = None, None
    try:
        report = simulation.settle(lambda _: time.monotonic() > deadline)
        movement = frame_movement(simulation)
    except SimulationError as error:
        failure = str(error)
        report = simulation.report(f"failed: {failure}")
    x, triangles = simulation.sewn_mesh()
    distance = scene.body.signed_distance(x)
    costs = {name: term["microseconds_per_step"] or 0.0 for name, term in report.terms.items()}
    contact = sum(cost for name, cost in costs.items() if "contact" in name)
    return {
        "report": report.to_dict(),
        "gate": judge(report, movement, failure),
        "contacts": int((distance < ON_THE_BODY * scene.settings.contact_offset).sum()),
        "contact_share": contact / sum(costs.values()) if any(costs.values()) else 0.0,
        "mesh": (x, triangles),
    }


def draw_close_ups(folder: Path, case: Case, garment: Any, body: Any) -> None:
    """The whole and each region, `<case>-<region>.png`."""
    from cloth_core.close_ups import close_ups
    from cloth_core.picture import draw

    folder.mkdir(parents=True, exist_ok=True)
    coloured = [(*garment, (0.20, 0.42, 0.65))]
    caption = f"{case.garment} on {case.body}, {case.fabric}, {case.quality}"
    draw(folder / f"{case.stem}.png", coloured, body, size=(1200, 900), caption=caption)
    for region in close_ups(body, garment):
        draw(
            folder / f"{case.stem}-{region.name}.png", coloured, body, views=region.views, size=(1400, 760),
            focus=(region.centre, region.radius), caption=f"{region.name}: {caption}",
        )  # fmt: skip


# ---- table


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as a Markdown page."""
    good = [row for row in rows if "report" in row]
    passed = sum(row["gate"]["passed"] for row in good)
    qualities = sorted({row["quality"] for row in rows})
    lines = [
        "# Contact",
        "",
        f"{len(rows)} drapes at quality {', '.join(qualities)}; {passed} pass the gate with zero edges through the "
        "body and zero through the cloth.",
        "",
        "Made by `python benchmarks/contact_table.py` on "
        f"{_processor()} with Python {platform.python_version()}; a case that is run again gives the same drape, its "
        "time differs.",
        "",
        "*Through body*: sides of the cloth that cross the body, and of the body that cross the cloth. *On the body*: "
        "particles that lie on it at the end. *Contact*: share of a step's time that contact takes "
        "there, of all that was measured. *Moving*: particles that move more than 0.3 mm in the next 1/60 s.",
        "",
        "| garment | body | fabric | particles | wall time | simulated | through body | through cloth | deepest "
        "| on the body | searches | contact | moving | gate |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    notes = []
    for row in rows:
        start = f"| {row['garment']} | {row['body']} | {row['fabric']} |"
        if "report" not in row:
            lines.append(f"{start} | | | | | | | | | | not run |")
            notes.append(f"- {row['garment']} on {row['body']}, {row['fabric']}: {row['error']}")
            continue
        report, gate = row["report"], row["gate"]
        moving = gate["criteria"]["moving_share"]["value"]
        lines.append(
            f"{start} {report['particles']} | {report['wall_time']:.1f} s | {report['simulated_time']:.2f} s "
            f"| {report['body_intersections'] + report['body_edges_through_cloth']} | {report['self_intersections']} "
            f"| {1000 * report['max_penetration']:.2g} mm | {row['contacts']} | {report['contact_searches']} "
            f"| {100 * row['contact_share']:.0f} % | {'' if moving is None else f'{100 * moving:.1f} %'} "
            f"| {'passed' if gate['passed'] else 'FAILED'} |"
        )
        notes += [f"- {row['garment']} on {row['body']}, {row['fabric']}: {line}" for line in gate["failed"]]
    if notes:
        lines += ["", "What failed:", "", *notes]
    return "\n".join(lines) + "\n"


def _processor() -> str:
    try:
        found = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    except OSError:
        found = None
    return f"{found.group(1).strip() if found else platform.machine()}, {os.cpu_count()} threads"


# ---- command


def cases_of(options: argparse.Namespace) -> list[Case]:
    """All that is asked for, in the order of the table."""
    garments = [(name,) for name in GARMENTS] + [("trousers", "tshirt")]
    garments += [tuple(text.split("+")) for text in options.patterns]
    cases = [
        Case(garment, body, fabric, options.quality)
        for garment, body, fabric in itertools.product(garments, options.bodies, options.fabrics)
    ]
    return [case for case in cases if options.only is None or re.search(options.only, case.stem)]


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("patterns", nargs="*", help="pattern files besides the built-in ones; inner+outer for layers")
    parser.add_argument("--bodies", nargs="+", default=list(BODIES), metavar="BODY")
    parser.add_argument("--fabrics", nargs="+", default=list(FABRICS), metavar="NAME")
    parser.add_argument("--quality", default="normal", choices=["draft", "normal", "fine"])
    parser.add_argument("--only", metavar="REGEX", help="only cases whose result file is named like this")
    parser.add_argument("--results", type=Path, default=REPOSITORY / "contact_results", metavar="DIR")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="close-ups of each case")
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "contact.md", metavar="FILE")
    parser.add_argument("--jobs", type=int, default=1, help="processes; more than one blurs the times")
    parser.add_argument("--wall-time", type=float, default=600.0, metavar="SECONDS", help="after which a case is ended")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Run what has no result yet and write the table; 0 if all of it passes the gate."""
    options = parse(arguments)
    cases = cases_of(options)
    if not cases:
        print("contact_table: no case is named like that", file=sys.stderr)
        return 2
    options.results.mkdir(parents=True, exist_ok=True)
    files = {case: options.results / f"{case.stem}.json" for case in cases}
    waiting = [case for case in cases if not files[case].exists()]
    print(f"{len(cases)} cases, {len(cases) - len(waiting)} of them done before", flush=True)
    pictures = None if options.pictures is None else str(options.pictures)
    # Fresh processes: what one case compiles, allocates or breaks is no matter for the next.
    context = multiprocessing.get_context("spawn")
    with context.Pool(options.jobs, maxtasksperchild=1) as pool:
        tasks = [(case, pictures, options.wall_time) for case in waiting]
        for number, (case, row) in enumerate(pool.imap_unordered(_task, tasks), start=1):
            part = files[case].with_suffix(".part")
            part.write_text(json.dumps(row, indent=1, allow_nan=False), encoding="utf-8")
            part.replace(files[case])
            print(f"{number}/{len(waiting)} {case.stem}: {_verdict(row)}", flush=True)
    rows = [json.loads(files[case].read_text(encoding="utf-8")) for case in cases]
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(table(rows), encoding="utf-8")
    print(f"wrote {options.output}")
    return 0 if all(row.get("gate", {}).get("passed") for row in rows) else 1


def _task(task: tuple[Case, str | None, float]) -> tuple[Case, dict[str, Any]]:
    return task[0], run_case(*task)


def _verdict(row: dict[str, Any]) -> str:
    if "error" in row:
        return str(row["error"])
    return "passed" if row["gate"]["passed"] else "; ".join(row["gate"]["failed"])


if __name__ == "__main__":
    sys.exit(main())
