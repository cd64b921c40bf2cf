"""What a step costs: `python benchmarks/step_speed.py limit | growth N | profile | drape SPACING | first`; JSON.

Processor time of the one thread that steps, the smallest of repeated blocks: it does not count what other processes
take, but is longer while they share the core's caches and units. So what is compared is measured in turn.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from peers import scenes
from peers.sheet import sheet

from cloth_core.axis_layout import by_axis
from cloth_core.bending import bending_forces
from cloth_core.body import Body
from cloth_core.contact import keep_within_travel, resolve_contacts
from cloth_core.euler import semi_implicit_euler
from cloth_core.fabric import Fabric
from cloth_core.gravity_and_air import gravity_forces
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.springs import spring_forces
from cloth_core.step import run_steps, total_force
from cloth_core.strain_limit import hold_strain
from cloth_core.trellis import trellis_forces
from cloth_core.twist import twist_forces

HERE = Path(__file__).parent
FLAGS = ["-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512", "-fopenmp"]


def hanging(n: int, **fabric: float) -> Simulation:
    """Scene A with n x n particles, a moment after the start."""
    garment = sheet(n)
    corner = (np.abs(garment.start[:, :2] - [0.0, scenes.SIDE / 2]) == [scenes.SIDE / 2, 0.0]).all(axis=1)
    cloth = Fabric("sheet", scenes.DENSITY, 1000.0, 1000.0, 50.0, 1e-5, strain_limit=0.045)
    simulation = Simulation(
        Scene(
            garment,
            Fabric(**{**cloth.__dict__, **fabric}),
            pins=np.flatnonzero(corner).astype(np.int32),
            gravity=(0.0, 0.0, -scenes.GRAVITY),
            air_drag=0.0,
            settings=Settings(spacing=scenes.SIDE / (n - 1)),
            without=("self contact",),
        )
    )
    simulation.tick()
    return simulation


def microseconds(action: Callable[[], object], least: float = 0.02, blocks: int = 9) -> float:
    """Processor time of this thread for one action [us]: the smallest mean of blocks of at least `least` [s]."""
    action()
    began = time.thread_time()
    action()
    count = max(1, round(least / max(time.thread_time() - began, 1e-7)))
    best = np.inf
    for _ in range(blocks):
        began = time.thread_time()
        for _ in range(count):
            action()
        best = min(best, (time.thread_time() - began) / count)
    return 1e6 * float(best)


def step_microseconds(simulation: Simulation, count: int = 32) -> float:
    """A step of `run_steps` as the simulation calls it, on copies of its state [us]."""
    s = simulation
    x, v = s.motion.x.copy(), s.motion.v.copy()
    run = lambda: run_steps(  # noqa: E731
        x,
        v,
        s.motion.work,
        s.motion.moved,
        s.motion.terms,
        s.motion.contact_settings,
        s.motion.contacts,
        s.time_step,
        count,
        0.0,
        0.0,
    )
    return microseconds(run) / count


def limit(n: int = 128) -> dict[str, Any]:
    """Ours and the C stencil in turn; ns per spring and step."""
    # The stencil's own springs: three families, nothing damped, no true bending.
    same = hanging(n, bending=0.0, bending_spring=1.0, damping_time=0.0)
    cloth = hanging(n)
    springs = len(same.model.springs)
    result: dict[str, Any] = {"n": n, "springs": springs, "ours": [], "ours_cloth_us": [], "c": {}}
    compiler = shutil.which("gcc")
    with tempfile.TemporaryDirectory() as directory:
        program = Path(directory) / "limit"
        if compiler:
            subprocess.run(
                [compiler, *FLAGS, str(HERE / "peers" / "stencil_limit.c"), "-o", str(program), "-lm"], check=True
            )
        for _ in range(5):
            result["ours"].append(1e3 * step_microseconds(same) / springs)
            result["ours_cloth_us"].append(step_microseconds(cloth))
            for threads in ("1", "2") if compiler else ():
                run = subprocess.run(
                    [str(program), str(n)], env={**os.environ, "OMP_NUM_THREADS": threads}, capture_output=True,
                    text=True, check=True,
                )  # fmt: skip
                result["c"].setdefault(threads, []).append([float(word) for word in run.stdout.split()[1:3]])
    return result


def growth(n: int) -> dict[str, Any]:
    """Time of a step, of an estimate of the stable step, and memory, for n x n particles."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    simulation = hanging(n)
    built = time.process_time() - began
    return {
        "n": n,
        "particles": n * n,
        "step_us": step_microseconds(simulation, 8),
        "stable_step_us": microseconds(
            lambda: simulation.motion.estimate_stable_step(simulation.stable.mode, 1e-2), blocks=3
        ),
        "build_s": built,
        "time_step": simulation.time_step,
        "mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024,
    }


def profile() -> dict[str, Any]:
    """Microseconds of each kernel in a step: scene A at 128 x 128, T-shirt at 1 cm with all its contacts."""
    shirt = Simulation(Scene.build([Pattern.load("tshirt")], Body.load("young"), settings=Settings(spacing=0.01)))
    shirt.advance(0.1)
    return {"scene A, 128 x 128": kernels(hanging(128)), "T-shirt, 1 cm, sewing": kernels(shirt)}


def kernels(simulation: Simulation) -> dict[str, float]:
    """Microseconds of each kernel on copies of the present state."""
    s, t, w = simulation, simulation.motion.terms, simulation.motion.work
    x, v, limit, dt = s.motion.x.copy(), s.motion.v.copy(), s.motion.terms.strain_limit, s.time_step
    total_force(x, v, t, 0.0, w)
    result = {
        "springs": microseconds(lambda: spring_forces(w.x, w.v, t.springs, t.spring_damping_time, w.force)),
        "shear of cells": microseconds(lambda: trellis_forces(w.x, w.v, t.trellis, t.spring_damping_time, w.force)),
        "bending": microseconds(
            lambda: bending_forces(w.ahead, t.lines, t.hinges, t.hinge_weights, t.hinge_stiffness, w.force)
        ),
        "twist": microseconds(lambda: twist_forces(w.ahead, t.twists, w.force)),
        "gravity": microseconds(lambda: gravity_forces(t.mass, t.gravity, w.force)),
        "Euler": microseconds(lambda: semi_implicit_euler(w.x, w.v, w.force, 0.0 * t.inverse_mass, dt)),
        "strain limit": microseconds(lambda: hold_strain(x, v, t.inverse_mass, limit, dt)),
    }
    if not s.motion.contact_settings.active:  # where there is contact it returns early on a copy whose way is used up
        result = {"step": step_microseconds(s), **result}
    else:
        by_axis(s.motion.x, w.x)  # Euler's steps have carried them away
        by_axis(s.motion.v, w.v)
        result["contact response"] = microseconds(
            lambda: resolve_contacts(
                w.x, w.v, t.inverse_mass, s.motion.contacts, s.motion.contact_settings, dt, s.motion.moved
            )
        )
        result["travel bound"] = microseconds(lambda: keep_within_travel(w.x, w.v, s.motion.contacts, s.motion.moved))
        assert s.model.contact is not None
        contact = s.model.contact
        result["contact search (not each step)"] = microseconds(lambda: contact.search(s.motion.x, 0.006), blocks=3)
    return result


def drape(spacing: float) -> dict[str, Any]:
    """Scene C: the T-shirt on the young woman until rest."""
    scene = Scene.build([Pattern.load("tshirt")], Body.load("young"), settings=Settings(spacing=spacing))
    warm = Simulation(scene)
    warm.tick()
    began, used = time.perf_counter(), time.process_time()
    report = Simulation(scene).settle()
    return {
        "spacing": spacing,
        "wall": time.perf_counter() - began,
        "processor": time.process_time() - used,
        "particles": report.particles,
        "steps": report.steps,
        "simulated": report.simulated_time,
        "settled": report.settled,
        "max_strain": report.max_strain,
        "body_intersections": report.body_intersections,
        "body_edges_through_cloth": report.body_edges_through_cloth,
        "self_intersections": report.self_intersections,
        "max_penetration": report.max_penetration,
        "searches": report.contact_searches,
    }


def first_use() -> dict[str, Any]:
    """Wall time [s] of an import, and until a run from the command line has done 32 steps: the first ever, the next."""
    drape = [sys.executable, "-m", "cloth_sim_ros.command_line", "drape", "tshirt", "--body", "young"]
    drape += ["--quality", "draft", "--max-time", "0.001"]

    def until(command: list[str], line: str) -> float:
        began, reached = time.perf_counter(), math.nan
        with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=quiet, text=True) as process:
            assert process.stderr is not None
            for said in process.stderr:
                if said.startswith(line) and math.isnan(reached):
                    reached = time.perf_counter() - began
        return reached if line else time.perf_counter() - began

    with tempfile.TemporaryDirectory() as cache:
        quiet = subprocess.DEVNULL
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has byte code after its first start
        return {
            "import": min(until([sys.executable, "-c", "import cloth_core"], "") for _ in range(5)),
            "first": until(drape, "sewing:"),
            "next": statistics.median(until(drape, "sewing:") for _ in range(5)),
        }


def main() -> None:
    """Measures one thing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["limit", "growth", "profile", "drape", "first"])
    parser.add_argument("value", nargs="?", type=float)
    options = parser.parse_args()
    if options.what == "limit":
        print(json.dumps(limit()))
    elif options.what == "growth":
        growth(8)  # compiles; what it needs is part of every run
        print(json.dumps(growth(int(options.value or 64))))
    elif options.what == "first":
        print(json.dumps(first_use()))
    elif options.what == "profile":
        print(json.dumps(profile()))
    else:
        print(json.dumps(drape(options.value or 0.02)))


if __name__ == "__main__":
    main()
