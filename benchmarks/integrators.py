"""Cost against error of the integrators: hung sheets of several stiffnesses, in motion and to rest; on a ball, too.

    python benchmarks/integrators.py [--quick] [--only hung|ball]

prints the tables of docs/integrators.md: about 15 minutes, with --quick 2.

Error is the RMS distance of the particles to a symplectic run with half of its largest step. Cost is the time of the
thread, the median of the runs. Moving folds are chaotic: from about a second on, what two symplectic runs differ by is
the least error that can be told.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np
import trimesh
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.quality import INTEGRATORS, Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

Floats = NDArray[np.float64]

_TIMES = (0.5, 1.0, 2.0)
_REPEATS = 3
_HUNG_STEPS = (1 / 60, 1 / 120, 1 / 240)
_BALL_STEPS = (1 / 500, 1 / 1000)


def _sheet(n: int) -> Garment:
    """A level sheet of 1 m with n x n particles."""
    panel = {
        "translation": [0, 0, 0],
        "rotation": [-90, 0, 0],
        "vertices": [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]],
        "edges": [{"endpoints": [i, (i + 1) % 4]} for i in range(4)],
    }
    return Garment.from_pattern(
        Pattern.from_json(
            json.dumps(
                {
                    "pattern": {"panels": {"sheet": panel}, "stitches": [], "panel_order": ["sheet"]},
                    "properties": {"curvature_coords": "relative", "units_in_meter": 1},
                }
            ),
            "sheet",
        ),
        1.0 / (n - 1),
    )


def _fabric(stiffness: float) -> Fabric:
    return Fabric("sheet", 0.2, stiffness, stiffness, 50.0, 1e-5, damping_time=1e-5)


def hung(n: int, stiffness: float, **settings: object) -> Scene:
    """A sheet that swings down from two corners; nothing can touch."""
    garment = _sheet(n)
    corners = np.lexsort((-garment.start[:, 0], -garment.start[:, 1]))[[0, n - 1]]
    return Scene(
        garment, _fabric(stiffness), pins=corners.astype(np.int32), without=("self contact",),
        settings=Settings(spacing=1.0 / (n - 1), **settings),  # type: ignore[arg-type]
    )  # fmt: skip


def on_ball(n: int, stiffness: float, **settings: object) -> Scene:
    """A sheet that falls on a ball, with friction and contact of cloth with cloth."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.3)
    body = Body.from_arrays(np.asarray(ball.vertices) - [0.0, 0.0, 0.31], np.asarray(ball.faces), "ball")
    return Scene(
        _sheet(n), _fabric(stiffness), body=body,
        settings=Settings(spacing=1.0 / (n - 1), max_time=5.0, **settings),  # type: ignore[arg-type]
    )  # fmt: skip


def motion(scene: Scene, repeats: int) -> tuple[list[Floats], float, Simulation]:
    """Positions at the times, median CPU seconds, and the last run."""
    costs = []
    for _ in range(repeats):
        simulation = Simulation(scene)
        began = time.thread_time()
        seen = []
        for at in _TIMES:
            simulation.advance(at - simulation.time)
            seen.append(simulation.positions)
        costs.append(time.thread_time() - began)
    return seen, median(costs), simulation


def _distance(a: Floats, b: Floats) -> float:
    return 1000.0 * float(np.sqrt(((a - b) ** 2).sum(axis=1).mean()))


def motion_table(make: Callable[..., Scene], n: int, stiffness: float, repeats: int, steps: Sequence[float]) -> None:
    """Prints rows: integrator and implicit time step [s], number of steps, CPU, errors at the times."""
    reference, _, _ = motion(make(n, stiffness, safety=0.45), 1)
    runs = [("symplectic", make(n, stiffness))]
    runs += [
        (f"implicit, 1/{round(1 / dt)} s", make(n, stiffness, integrator="implicit", time_step=dt)) for dt in steps
    ]
    for name, scene in runs:
        seen, cost, simulation = motion(scene, 1 if stiffness > 2e6 and name == "symplectic" else repeats)
        errors = " / ".join(f"{_distance(a, b):.1f}" for a, b in zip(seen, reference, strict=True))
        report = simulation.report()
        print(
            f"| {n} | {stiffness:g} | {name} | {simulation.steps} | {cost:.2f} | {errors} "
            f"| {report.body_intersections + report.body_edges_through_cloth + report.self_intersections} |",
            flush=True,
        )


def rest_table(make: Callable[..., Scene], n: int, stiffness: float, repeats: int, steps: Sequence[float]) -> None:
    """Prints rows: integrator and implicit time step [s], CPU to rest, distance to the drape of the symplectic run."""
    reference = None
    runs: list[tuple[str, dict[str, object]]] = [("symplectic", {})]
    runs += [(f"implicit, 1/{round(1 / dt)} s", {"integrator": "implicit", "time_step": dt}) for dt in steps]
    for name, settings in runs:
        costs = []
        for _ in range(repeats):
            simulation = Simulation(make(n, stiffness, **settings))
            began = time.thread_time()
            report = simulation.settle()
            costs.append(time.thread_time() - began)
        reference = simulation.positions if reference is None else reference
        end = f"{_distance(simulation.positions, reference):.2f}" if report.settled else "no rest"
        print(f"| {n} | {stiffness:g} | {name} | {simulation.steps} | {median(costs):.2f} | {end} |", flush=True)


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="16 x 16 particles up to 1e6 N/m, one run each")
    parser.add_argument("--only", choices=("hung", "ball"), help="half of the tables")
    options = parser.parse_args()
    quick, repeats = options.quick, 1 if options.quick else _REPEATS
    for integrator in INTEGRATORS:
        Simulation(on_ball(11, 1e3, integrator=integrator)).advance(0.05)  # compiles everything
    moving = (
        "| side | N/m | integrator | steps | CPU s | mm at 0.5 / 1 / 2 s | crossings |\n|---|---|---|---|---|---|---|"
    )
    resting = "| side | N/m | integrator | steps | CPU s | mm to symplectic |\n|---|---|---|---|---|---|"
    if options.only != "ball":
        print(f"hung, 2 s of motion\n\n{moving}", flush=True)
        for n, stiffness in ((16, 200.0), (16, 1e4), (16, 1e6), *(() if quick else ((32, 1e4), (32, 1e6), (16, 1e8)))):
            motion_table(hung, n, stiffness, repeats, _HUNG_STEPS)
        print(f"\nhung, to rest\n\n{resting}", flush=True)
        for n, stiffness in ((16, 2e3), (16, 1e4), (16, 1e6), *(() if quick else ((32, 2e3), (32, 1e6)))):
            rest_table(hung, n, stiffness, repeats, (1 / 120, 1 / 30))
    if options.only != "hung":
        print(f"\non a ball, 2 s of motion\n\n{moving}", flush=True)
        for stiffness in (1e4, 1e6):
            motion_table(on_ball, 16, stiffness, repeats, _BALL_STEPS)
        print(f"\non a ball, to rest\n\n{resting}", flush=True)
        for n, stiffness in ((16, 2e3), (16, 1e4), (16, 1e6), *(() if quick else ((32, 1e4),))):
            rest_table(on_ball, n, stiffness, repeats, _BALL_STEPS)


if __name__ == "__main__":
    main()
