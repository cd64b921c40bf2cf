"""One run, measured: what it cost and what drape or motion came out; kept as a file by what it depends on."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from cloth_core.drape_error import Drape
from cloth_core.errors import ClothError
from cloth_core.kernel import cache_directory
from cloth_core.quality import Settings
from cloth_core.scene_recipe import SceneRecipe
from cloth_core.simulation import Simulation

__all__ = ["MeasuredRun", "RunRequest", "core_version", "machine_class", "measure", "stored_run"]


@dataclass(frozen=True)
class RunRequest:
    """What is to be run.

    Attributes:
        recipe: the scene.
        settings: numerical settings.
        seed: of the disturbance of the start; 0: none.
        times: empty: run to rest; else the motion at these times [s], increasing.
    """

    recipe: SceneRecipe
    settings: Settings
    seed: int = 0
    times: tuple[float, ...] = ()

    def key(self) -> str:
        """Hash of everything that the result depends on, the version of the simulator included."""
        settings = asdict(self.settings)
        # What a report quotes has no bearing on the run.
        for quoted in ("tolerance", "expected_error", "expected_error_source"):
            settings.pop(quoted, None)
        contents = {
            "scene": _digest(self.recipe),
            "settings": settings,
            "seed": self.seed,
            "times": self.times,
            "core": core_version(),
        }
        return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()[:24]

    @property
    def expected_work(self) -> float:
        """Cost in proportion to that of other requests: particles times steps."""
        spacing, safety = self.settings.spacing, self.settings.safety
        return spacing**-3 / safety * (0.3 if self.times else 1.0)


@dataclass(frozen=True)
class MeasuredRun:
    """Result of a run.

    Attributes:
        facts: JSON types: request, cost, rest, counts; "failed" holds the error of a run that could not be done.
        frames: the drape at rest, or at each of the times asked for.
    """

    facts: dict[str, Any]
    frames: tuple[Drape, ...]

    @property
    def failed(self) -> str | None:
        """Why there is no drape, or one that is not at rest."""
        reason: str | None = self.facts["failed"]
        return reason

    @property
    def drape(self) -> Drape:
        """At rest, or at the last of the times."""
        return self.frames[-1]

    @property
    def spacing(self) -> float:
        """Particle spacing [m]."""
        return float(self.facts["settings"]["spacing"])

    @property
    def cpu_seconds(self) -> float:
        """Of the process, without compilation."""
        return float(self.facts["cpu_seconds"])


def core_version() -> str:
    """Hash of the sources that a run depends on: results of another version are not taken for this one's."""
    return cache_directory("cloth_core.simulation").name


@cache
def machine_class() -> str:
    """Processor and number of cores, as far as the system tells."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{model}, {os.cpu_count()} cores"


def stored_run(request: RunRequest, folder: Path) -> MeasuredRun | None:
    """What an earlier `measure` kept in the folder, or None. A file that is cut off or foreign counts as none."""
    place = folder / f"{request.key()}.json"
    try:
        facts = json.loads(place.read_text(encoding="utf-8"))
        if facts["failed"] is not None and not facts["has_drape"]:
            return MeasuredRun(facts, ())
        with np.load(place.with_suffix(".npz")) as arrays:
            triangles, panels = arrays["triangles"], arrays["panels"]
            names = tuple(facts["panel_names"])
            frames = tuple(Drape(x, triangles, panels, names) for x in arrays["frames"])
    except (OSError, ValueError, KeyError, TypeError, BadZipFile):
        return None
    return MeasuredRun(facts, frames)


def measure(request: RunRequest, folder: Path) -> MeasuredRun:
    """Run, unless the folder has the result already; the result is kept there.

    A run that ends in an error of the simulator or without rest is a result as well: it is kept with the reason.
    """
    kept = stored_run(request, folder)
    if kept is not None:
        return kept
    load = os.getloadavg()[0]
    frames: list[np.ndarray[Any, Any]] = []
    failed, numbers, scene = None, {}, None
    cpu, wall = time.process_time(), time.perf_counter()
    try:
        scene = request.recipe.build(request.settings, request.seed)
        # The first step of a process loads or compiles code, which no later one does.
        Simulation(scene).tick()
        cpu, wall = time.process_time(), time.perf_counter()
        simulation = Simulation(scene)
        if request.times:
            for moment in request.times:
                simulation.advance(moment - simulation.time)
                frames.append(simulation.positions.copy())
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            numbers = {"steps": simulation.steps, "time_step": simulation.time_step}
        else:
            spent = [cpu, wall]

            def watch(_: Simulation) -> bool:
                spent[:] = time.process_time(), time.perf_counter()
                return False

            report = simulation.settle(watch)
            frames.append(simulation.positions.copy())
            failed = None if report.settled else report.rest_reason
            numbers = {
                key: getattr(report, key)
                for key in (
                    "particles", "steps", "time_step", "simulated_time", "settled", "rest_reason", "max_strain",
                    "max_seam_gap", "body_intersections", "self_intersections", "max_penetration",
                )
            }  # fmt: skip
            # Up to the last tick: the exact tests of the report are no part of the run.
            cpu, wall = spent[0] - cpu, spent[1] - wall
    except ClothError as error:
        failed, frames = str(error), []
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    facts = {
        "scene": json.loads(json.dumps(request.recipe.to_dict())),  # as it comes back from the file
        "scene_name": request.recipe.name,
        "settings": asdict(request.settings),
        "seed": request.seed,
        "times": list(request.times),
        "cpu_seconds": cpu,
        "wall_seconds": wall,
        "load": load,
        "machine": machine_class(),
        "core": core_version(),
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "failed": failed,
        "has_drape": bool(frames),
        "panel_names": list(scene.garment.panel_names) if scene is not None else [],
        "area": float(scene.garment.areas.sum()) if scene is not None else None,
        **numbers,
    }
    place = folder / f"{request.key()}.json"
    if scene is None or not frames:
        _replace(place, (json.dumps(facts, indent=2) + "\n").encode())
        return MeasuredRun(facts, ())
    garment = scene.garment
    arrays = place.with_suffix(".npz")
    partial = arrays.with_name(f".{arrays.stem}.{os.getpid()}.npz")
    np.savez_compressed(partial, frames=np.array(frames), triangles=garment.triangles, panels=garment.panel_of_triangle)
    partial.replace(arrays)
    # Last of all: where the JSON lies, the run is complete.
    _replace(place, (json.dumps(facts, indent=2) + "\n").encode())
    drapes = tuple(Drape(x, garment.triangles, garment.panel_of_triangle, garment.panel_names) for x in frames)
    return MeasuredRun(facts, drapes)


def _replace(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    partial.write_bytes(content)
    partial.replace(path)


@cache
def _digest(recipe: SceneRecipe) -> str:
    return recipe.digest()
