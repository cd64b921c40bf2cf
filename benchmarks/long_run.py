"""Runs a draped garment on and on: does it drift, does its energy grow, does memory?

    python benchmarks/long_run.py [--seconds 1000] [--spacing 0.06] [--garment skirt] [--body young] [--fabric wool]

Drapes, lets the cloth calm down for 10 s, and then advances in the scene's own air. Prints a line for each tenth and at
the end the figures as JSON: largest movement after that rest [m], largest growth of the energy over its value then [J],
growth of the memory [bytes]. A skirt at 60 mm takes some minutes.
"""

from __future__ import annotations

import argparse
import json
import resource
import time

import numpy as np

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation


def energy(simulation: Simulation) -> float:
    """Kinetic and potential energy and that of the springs [J]; bending, the least part, is left out."""
    model, (x, _) = simulation.model, simulation.sewn_mesh()
    v, springs = simulation.motion.v, model.springs
    length = np.linalg.norm(x[springs.pairs[:, 1]] - x[springs.pairs[:, 0]], axis=1)
    kinetic = 0.5 * float((model.mass[:, None] * v**2).sum())
    lifted = -float((model.mass * (x @ np.array(simulation.scene.gravity))).sum())
    return kinetic + lifted + 0.5 * float((springs.stiffness * (length - springs.rest_length) ** 2).sum())


def long_run(simulation: Simulation, seconds: float, tenths: int = 10) -> dict[str, float]:
    """Advance a calm simulation; the figures."""
    start, first = simulation.positions, energy(simulation)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    movement, growth, began = 0.0, 0.0, time.perf_counter()
    for k in range(tenths):
        simulation.advance(seconds / tenths)
        movement = max(movement, float(np.linalg.norm(simulation.positions - start, axis=1).max()))
        growth = max(growth, energy(simulation) - first)
        print(f"{(k + 1) * seconds / tenths:g} s: moved {1e3 * movement:.4f} mm, energy {growth:+.2e} J", flush=True)
    return {
        "seconds": seconds,
        "largest_movement": movement,
        "energy": first,
        "energy_growth": growth,
        "memory_growth": 1024.0 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory),
        "wall_time": time.perf_counter() - began,
    }


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1000.0)
    parser.add_argument("--spacing", type=float, default=0.06, help="[m]")
    parser.add_argument("--garment", default="skirt")
    parser.add_argument("--body", default="young")
    parser.add_argument("--fabric", default="wool")
    arguments = parser.parse_args()
    scene = Scene.build(
        Pattern.load(arguments.garment),
        Body.load(arguments.body),
        Fabric.preset(arguments.fabric),
        settings=Settings(spacing=arguments.spacing),
    )
    simulation = Simulation(scene)
    print(simulation.settle().rest_reason, flush=True)
    simulation.advance(10.0)
    print(json.dumps(long_run(simulation, arguments.seconds), indent=2))


if __name__ == "__main__":
    main()
