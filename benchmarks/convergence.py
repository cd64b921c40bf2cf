"""Convergence where the answer is unique: order in spacing and in time step, and what Richardson says is left.

    python benchmarks/convergence.py [--output docs]

Writes the section between the markers `unique` of docs/accuracy.md, and docs/convergence.png. Needs the extras `test`
and `plots`; takes about a minute and a half on one core.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.figure import Figure
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "core"))

import cusick
from accuracy_tables import put
from apparatus import body_of, sheet
from cantilever import MASTER_CURVE, drop_over_reach, hang

from cloth_core.convergence import Convergence, fit_convergence
from cloth_core.drape_error import Drape, drape_error
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

Floats = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
# Weight pulls with less than 0.5 N/m: a membrane of 500 N/m is as good as a stiffer one, and its steps are longer.
SOFT = {"structural_warp": 500.0, "structural_weft": 500.0}
# Of a run to rest that is to be compared to hundredths of a millimetre [m].
_STILL = 1e-5


@dataclass(frozen=True)
class Study:
    """Solutions at several steps, coarsest first.

    Attributes:
        scene, quantity: what was simulated, and what is compared.
        unit: of the steps in the table, with the factor.
        distances: (H, h) -> distance [m].
        known: true distance from the exact solution at the finest step [m], where there is one.
    """

    scene: str
    quantity: str
    unit: tuple[float, str]
    distances: Mapping[tuple[float, float], float]
    known: float | None = None

    @property
    def fit(self) -> Convergence:
        """Order and what is left."""
        return fit_convergence(self.distances)

    @property
    def steps(self) -> list[float]:
        """Coarsest first."""
        return sorted({step for pair in self.distances for step in pair}, reverse=True)


def distances_of(
    solve: Callable[[float], Floats], steps: tuple[float, ...], apart: Callable[[Floats, Floats], float]
) -> dict[tuple[float, float], float]:
    """Distances of all pairs of solutions."""
    found = {step: solve(step) for step in steps}
    return {(a, b): apart(found[a], found[b]) for a, b in combinations(steps, 2)}


def rms(a: Floats, b: Floats) -> float:
    """Of the distances of points that belong together [m]."""
    return float(np.sqrt(((a - b) ** 2).sum(axis=-1).mean()))


# ---- scenes at rest


def cantilever() -> Study:
    """Gamma = 10: drop over reach, times the strip's 0.2 m."""
    found = {h: 0.2 * drop_over_reach(hang(10.0, h)[0]) for h in (0.02, 0.01, 0.005)}
    between = {(a, b): abs(found[a] - found[b]) for a, b in combinations(found, 2)}
    exact = 0.2 * MASTER_CURVE[10.0]
    return Study(
        "cantilever, Gamma = 10", "drop over reach x 0.2 m", (1e3, "mm"), between, abs(found[0.005] - exact)
    )  # fmt: skip


def at(garment: Garment, spacing: float) -> NDArray[np.int64]:
    """Particles that lie on the coarser lattice of that spacing, in the order of their places."""
    place = (garment.rest - garment.rest.min(axis=0)) / spacing
    chosen = np.flatnonzero((np.abs(place - np.round(place)) < 1e-6).all(axis=1))
    return chosen[np.lexsort(np.round(place[chosen]).T)]


def line(garment: Garment, x: Floats, spacing: float) -> Floats:
    """Middle line of a strip at places that far apart along it [m]: places (n, 2) across and up."""
    along = garment.rest[:, 0] - garment.rest[:, 0].min()
    count = round(float(along.max()) / spacing)
    return np.array([x[np.abs(along - k * spacing) < 1e-8][:, [0, 2]].mean(axis=0) for k in range(count + 1)])


def strip_on_cylinder(spacing: float, **settings: float) -> Simulation:
    """A strip of poplin 0.48 m long and a cell wide, held in the middle on top of a cylinder of 100 mm, no friction."""
    offset, radius = 0.003, 0.05
    garment = sheet(0.48, spacing, spacing, z=radius + offset + 1e-4)
    round_body = body_of(trimesh.creation.cylinder(radius, 0.4, sections=720).apply_transform(
        trimesh.transformations.rotation_matrix(math.pi / 2, [1, 0, 0])
    ))  # fmt: skip
    middle = np.flatnonzero(np.abs(garment.rest[:, 0]) < 1e-9).astype(np.int32)
    scene = Scene(
        garment=garment, body=round_body, fabric=Fabric.preset("cotton_poplin", friction=0.0, **SOFT), pins=middle,
        settings=Settings(spacing=spacing, contact_offset=offset, **settings),
    )  # fmt: skip
    return Simulation(scene)


def over_cylinder() -> Study:
    """The strip at rest."""
    steps = (0.02, 0.01, 0.005, 0.0025)

    def solve(h: float) -> Floats:
        simulation = strip_on_cylinder(h, rest_displacement=_STILL)
        assert simulation.settle().settled, h
        return line(simulation.scene.garment, simulation.positions, steps[0])

    return Study(
        "strip over a cylinder, with contact", "RMS of positions", (1e3, "mm"), distances_of(solve, steps, rms)
    )


def hung_swag() -> Study:
    """A square of leather hung by two corners that are nearer together than it is wide: one fold, towards us."""
    steps = (0.05, 0.025, 0.0125, 0.00625)

    def solve(h: float) -> Floats:
        garment = sheet(0.3, 0.3, h)
        # Bent around an upright axis, so that the way in which it folds is given.
        bend = 2.4
        angle = bend * garment.rest[:, 0] / 0.3
        x = np.column_stack([0.3 / bend * np.sin(angle), -0.3 / bend * np.cos(angle), garment.rest[:, 1]])
        corners = np.flatnonzero((np.abs(garment.rest[:, 0]) > 0.149) & (garment.rest[:, 1] > 0.149)).astype(np.int32)
        scene = Scene(
            garment=replace(garment, start=x), fabric=Fabric.preset("leather", **SOFT), pins=corners,
            settings=Settings(spacing=h, rest_displacement=_STILL),
        )  # fmt: skip
        simulation = Simulation(scene)
        assert simulation.settle().settled, h
        return simulation.positions[at(garment, steps[0])]

    return Study("leather hung by two corners", "RMS of positions", (1e3, "mm"), distances_of(solve, steps, rms))


def disc_with_given_folds() -> Study:
    """Cusick's disc of wool whose start has four waves of 5 mm: the same folds at each spacing."""

    def solve(h: float) -> Drape:
        garment = cusick.disc(h)
        angle = np.arctan2(garment.rest[:, 1], garment.rest[:, 0])
        wave = 0.005 * np.cos(4.0 * angle) * (np.hypot(*garment.rest.T) / cusick.DISC_RADIUS) ** 2
        drape = cusick.drape(Fabric.preset("wool"), h, start=wave)
        assert drape.settled, h
        assert drape.folds == 4, (h, drape.folds)
        return Drape.of_surface(drape.x, drape.triangles)

    found = {h: solve(h) for h in (0.015, 0.0125, 0.01, 0.0075)}
    between = {(a, b): drape_error(found[a], found[b]).rms for a, b in combinations(found, 2)}
    return Study("Cusick's disc with four folds given", "RMS of surfaces", (1e3, "mm"), between)


# ---- motion


def falling_strip(contact: bool) -> Study:
    """The strip falls from level, held in the middle: positions at 0.05, 0.1 and 0.15 s, steps halved each time."""
    spacing, times = 0.02, (0.05, 0.1, 0.15)
    simulation = strip_on_cylinder(spacing)
    longest = times[0] / math.ceil(times[0] / (0.8 * simulation.stable.time_step))

    def solve(step: float) -> Floats:
        simulation = strip_on_cylinder(spacing, time_step=step)
        if not contact:
            simulation = Simulation(replace(simulation.scene, body=None))
        frames = []
        for start, end in pairwise((0.0, *times)):
            simulation.advance(end - start)
            frames.append(simulation.positions)
        return np.array(frames)

    name = "strip that falls over the cylinder" if contact else "strip that falls freely, held in the middle"
    steps = tuple(longest / 2**k for k in range(4))
    return Study(name, "RMS of positions at three times", (1e6, "us"), distances_of(solve, steps, rms))


def rest_by_step() -> str:
    """How far the strip's rest depends on the time step."""
    found = []
    for safety in (0.9, 0.225):
        simulation = strip_on_cylinder(0.02, rest_displacement=_STILL, safety=safety)
        assert simulation.settle().settled
        found.append(simulation.positions)
    return f"{1e3 * rms(*found):.2g} mm"


# ---- the page


def row(study: Study) -> str:
    """Of the table."""
    fit, (factor, unit) = study.fit, study.unit
    steps = " - ".join(f"{factor * step:.3g}" for step in (study.steps[0], study.steps[-1]))
    fine = study.distances[(study.steps[-2], study.steps[-1])]
    order = "none" if fit.order is None else f"{fit.order:.2f}"
    left = "-" if fit.left is None else f"{1e3 * fit.left:.2g}"
    known = "" if study.known is None else f"{1e3 * study.known:.2g}"
    return (
        f"| {study.scene} | {study.quantity} | {steps} {unit} | {order} | {100 * fit.misfit:.0f} % | {1e3 * fine:.2g} "
        f"| {left} | {known} | {'yes' if fit.converges else 'no'} |"
    )


def plot(studies: list[Study], path: Path) -> None:
    """What is left at each step by the fit, and the distances to the finest, over the step."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, unit, title in zip(figure.subplots(1, 2), ("mm", "us"), ("spacing [mm]", "time step [us]"), strict=True):
        for study in (s for s in studies if s.unit[1] == unit):
            finest, factor = study.steps[-1], study.unit[0]
            coarser = np.array(study.steps[:-1])
            apart = [1e3 * study.distances[(step, finest)] for step in coarser]
            (line,) = axes.loglog(factor * coarser, apart, "o", markersize=4, label=study.scene)
            fit = study.fit
            if fit.constant is not None and fit.order is not None:
                fine = np.geomspace(1.02 * finest, coarser[0], 60)
                law = 1e3 * fit.constant * (fine**fit.order - finest**fit.order)
                axes.loglog(factor * fine, law, "-", linewidth=0.8, color=line.get_color())
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("{x:g}")
        axes.tick_params(axis="x", which="both", labelsize=7)
        axes.set(xlabel=title, ylabel="distance to the finest [mm]")
        axes.grid(True, which="both", alpha=0.3)
        axes.legend(fontsize=6)
    figure.savefig(path, dpi=80, metadata={"Software": None})


def main() -> None:
    """Runs everything and writes the section and the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "docs")
    output = parser.parse_args().output
    began = time.process_time()
    studies = []
    for experiment in (
        cantilever, over_cylinder, hung_swag, disc_with_given_folds,
        lambda: falling_strip(contact=False), lambda: falling_strip(contact=True),
    ):  # fmt: skip
        studies.append(experiment())
        print(row(studies[-1]), f"{time.process_time() - began:.0f} s", flush=True)
    lines = [
        "| scene | compared | steps | order | misfit | the two finest [mm] | left at the finest [mm] | known [mm] "
        "| converges |",
        "|---|---|---|---|---|---|---|---|---|",
        *(row(study) for study in studies),
        "",
        f"The strip's shape at rest changes by {rest_by_step()} (RMS) with a quarter of the time step.",
        "",
        "![Distance to the finest over spacing and time step, with the fitted laws](convergence.png)",
    ]
    plot(studies, output / "convergence.png")
    page = output / "accuracy.md"
    page.write_text(put(page.read_text(encoding="utf-8"), "unique", lines), encoding="utf-8")
    print(f"wrote {page} and a plot in {time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()
