"""What the paper's bending springs cost in accuracy: drapes with them and without, at several spacings.

    python benchmarks/bending_springs.py [--spacings 40,20,10] [--stiffness 5]

Prints a table of RMS distances [mm] between the drapes at each two spacings, for docs/accuracy.md.
"""

from __future__ import annotations

import argparse
from itertools import combinations

from cloth_core.body import Body
from cloth_core.drape_error import Drape, drape_error
from cloth_core.fabric import Fabric
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

SCENES = (("tshirt", "young"), ("skirt", "middle_aged"), ("dress", "elderly"))
FABRIC = "cotton_poplin"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--spacings", default="40,20,10", help="[mm]")
    parser.add_argument("--stiffness", type=float, default=5.0, help="of the springs [N/m]")
    options = parser.parse_args()
    spacings = [float(h) / 1000.0 for h in options.spacings.split(",")]
    pairs = list(combinations(range(len(spacings)), 2))
    print(
        "| scene | bending springs | "
        + " | ".join(f"{1e3 * spacings[a]:g}-{1e3 * spacings[b]:g}" for a, b in pairs)
        + " |"
    )
    print("|---" * (len(pairs) + 2) + "|")
    for pattern, body in SCENES:
        for stiffness in (options.stiffness, 0.0):
            drapes = [draped(pattern, body, stiffness, h) for h in spacings]
            distances = [f"{1e3 * drape_error(drapes[a], drapes[b]).rms:.1f}" for a, b in pairs]
            print(f"| {pattern} on {body} | {stiffness:g} N/m | " + " | ".join(distances) + " |", flush=True)


def draped(pattern: str, body: str, stiffness: float, spacing: float) -> Drape:
    """The drape with bending springs of a stiffness [N/m] at a spacing [m]."""
    fabric = Fabric.preset(FABRIC, bending_spring=stiffness)
    scene = Scene.build(Pattern.load(pattern), Body.load(body), fabric, settings=Settings(spacing=spacing))
    simulation = Simulation(scene)
    simulation.settle()
    garment = scene.garment
    return Drape(simulation.positions, garment.triangles, garment.panel_of_triangle, garment.panel_names)


if __name__ == "__main__":
    main()
