"""What the paper's bending springs cost in accuracy: the same scene with them and without, at several spacings.

    python benchmarks/bending_springs.py --runs runs [--spacings 40,30,20,15]

Prints a Markdown table of the distances between drapes, with the spread of drapes that are equally right.
"""

from __future__ import annotations

import argparse
import math
import sys
from itertools import combinations
from pathlib import Path

from cloth_core.convergence import fit_convergence
from cloth_core.drape_error import drape_error
from cloth_core.measured_run import RunRequest
from cloth_core.quality import Settings
from cloth_core.run_series import run_series
from cloth_core.scene_recipe import SceneRecipe

SEEDS = (1, 2, 3)


def main() -> int:
    """Run the command; the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--runs", type=Path, required=True, help="directory of the finished runs")
    parser.add_argument("--pattern", default="tshirt")
    parser.add_argument("--body", default="young")
    parser.add_argument("--fabric", default="cotton_poplin")
    parser.add_argument("--spacings", default="40,30,20,15", help="coarsest first [mm]")
    parser.add_argument("--processes", type=int)
    options = parser.parse_args()
    spacings = [float(part) / 1000.0 for part in options.spacings.split(",")]
    seeded = spacings[-2]
    print("| bending springs | " + " | ".join(f"{1e3 * a:g}-{1e3 * b:g}" for a, b in combinations(spacings, 2)), end="")
    print(" | spread | order | left | converges |")
    print("|" + "---|" * (len(spacings) * (len(spacings) - 1) // 2 + 5))
    for without in ((), ("bending springs",)):
        recipe = SceneRecipe((options.pattern,), options.body, options.fabric, without=without)
        requests = [RunRequest(recipe, Settings(spacing=h)) for h in spacings]
        requests += [RunRequest(recipe, Settings(spacing=seeded), seed) for seed in SEEDS]
        runs = run_series(requests, options.runs, processes=options.processes)
        drapes, same = runs[: len(spacings)], [runs[-2 - len(SEEDS)], *runs[len(spacings) :]]
        between = {(a.spacing, b.spacing): drape_error(a.drape, b.drape).rms for a, b in combinations(drapes, 2)}
        squares = [drape_error(a.drape, b.drape).rms ** 2 for a, b in combinations(same, 2)]
        spread = math.sqrt(sum(squares) / len(squares))
        found = fit_convergence(between, spread)
        cells = [f"{1000 * d:.1f}" for d in between.values()] + [f"{1000 * spread:.1f}"]
        cells += ["-", "-"] if found.order is None else [f"{found.order:.2f}", f"{1000 * (found.left or 0.0):.1f}"]
        print(
            f"| {'off' if without else 'on'} | {' | '.join(cells)} | {'yes' if found.converges else 'no'} |", flush=True
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
