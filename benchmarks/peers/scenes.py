"""The comparison scenes as plain NumPy data (SI units, z up), and the loop that times every simulator the same way."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CENTRE",
    "DENSITY",
    "FPS",
    "FRICTION",
    "GRAVITY",
    "HEIGHT",
    "MASS",
    "NAMES",
    "RADIUS",
    "SIDE",
    "Scene",
    "drive",
    "hinges",
    "icosphere",
    "make",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

SIDE, HEIGHT, DENSITY, GRAVITY, FPS = 1.0, 1.0, 0.2, 9.81, 60  # m, m, kg/m^2, m/s^2, 1/s
MASS = DENSITY * SIDE * SIDE
NAMES = ("hang", "sphere", "selfcontact", "fall")  # fall: neither pins nor sphere, a check of gravity and time
CENTRE, RADIUS, FRICTION = np.array([0.0, 0.0, 0.5]), 0.3, 0.4


@dataclass
class Scene:
    """A square cloth, flat at HEIGHT.

    Attributes:
        name: one of NAMES.
        n: particles per side; seconds: how long it moves.
        x: start and rest positions [m], (n*n, 3), row by row: index = row (y) * n + column (x).
        triangles: (m, 3), counter-clockwise from above, diagonals alternate.
        edges: along warp and weft, (e, 2): what strain is measured on; diagonals (d, 2).
        pins: particles that are held.
        sphere: whether there is one; self_collision: whether cloth meets cloth.
        settings: a simulator's own settings, as given on the command line.
    """

    name: str
    n: int
    seconds: float
    x: Floats
    triangles: Ints
    edges: Ints
    diagonals: Ints
    pins: list[int]
    sphere: bool
    self_collision: bool
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Number of output frames."""
        return round(self.seconds * FPS)

    @property
    def spacing(self) -> float:
        """Distance of neighbours [m]."""
        return SIDE / (self.n - 1)

    def settings_over(self, defaults: dict[str, Any]) -> dict[str, Any]:
        """The defaults with what the command line says instead."""
        unknown = set(self.settings) - set(defaults)
        if unknown:
            raise SystemExit(f"settings {sorted(unknown)}: not known; this simulator has {sorted(defaults)}")
        return {**defaults, **self.settings}


def make(name: str, n: int, seconds: float = 2.0, settings: dict[str, Any] | None = None) -> Scene:
    """One of the scenes with n x n particles."""
    if name not in NAMES:
        raise SystemExit(f"scene {name!r}: not known; use one of {', '.join(NAMES)}")
    line = np.linspace(-SIDE / 2, SIDE / 2, n)
    x = np.stack([np.tile(line, n), np.repeat(line, n), np.full(n * n, HEIGHT)], axis=1)
    i = np.arange(n * n, dtype=np.int32).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    even = (np.add.outer(np.arange(n - 1), np.arange(n - 1)) % 2 == 0).ravel()[:, None]
    lower = np.where(even, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    upper = np.where(even, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    weft = np.stack([i[:, :-1].ravel(), i[:, 1:].ravel()], 1)
    warp = np.stack([i[:-1].ravel(), i[1:].ravel()], 1)
    return Scene(
        name=name,
        n=n,
        seconds=seconds,
        x=x,
        triangles=np.concatenate([lower, upper]).astype(np.int32),
        edges=np.concatenate([weft, warp]),
        diagonals=np.where(even, np.stack([a, c], 1), np.stack([b, d], 1)),
        pins=[int(i[-1, 0]), int(i[-1, -1])] if name == "hang" else [],
        sphere=name in ("sphere", "selfcontact"),
        self_collision=name == "selfcontact",
        settings=settings or {},
    )


def icosphere(subdivisions: int = 3, centre: Floats = CENTRE, radius: float = RADIUS) -> tuple[Floats, Ints]:
    """Vertices (v, 3) [m] and outward triangles (t, 3) of the sphere, for who collides with meshes."""
    golden = (1 + 5**0.5) / 2
    corners = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    points = [np.roll(np.array(c, float), k) for k in range(3) for c in corners]
    vertices = [p / np.linalg.norm(p) for p in points]
    edge = min(np.linalg.norm(vertices[0] - v) for v in vertices[1:]) * 1.01
    near = [[j for j in range(12) if j != i and np.linalg.norm(vertices[i] - vertices[j]) < edge] for i in range(12)]
    faces = [(i, j, k) for i in range(12) for j in near[i] for k in near[i] if i < j < k and k in near[j]]
    volume = [np.linalg.det([vertices[i] for i in face]) for face in faces]
    faces = [face if v > 0 else (face[0], face[2], face[1]) for face, v in zip(faces, volume, strict=True)]
    for _ in range(subdivisions):
        middle: dict[tuple[int, int], int] = {}
        finer: list[tuple[int, int, int]] = []
        for a, b, c in faces:
            sides = []
            for p, q in ((a, b), (b, c), (c, a)):
                key = (min(p, q), max(p, q))
                if key not in middle:
                    between = vertices[p] + vertices[q]
                    middle[key] = len(vertices)
                    vertices.append(between / np.linalg.norm(between))
                sides.append(middle[key])
            ab, bc, ca = sides
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return np.array(vertices) * radius + centre, np.array(faces, np.int32)


def hinges(triangles: Ints) -> Ints:
    """(opposite a, opposite b, edge start, edge end) of every inner edge, (h, 4)."""
    seen: dict[tuple[int, int], int] = {}
    rows = []
    for corner in triangles.tolist():
        for k in range(3):
            a, b, c = corner[k], corner[(k + 1) % 3], corner[(k + 2) % 3]
            if (b, a) in seen:
                rows.append((seen[b, a], c, b, a))
            else:
                seen[a, b] = c
    return np.array(rows, np.int32)


def strain(scene: Scene, x: Floats, pairs: Ints) -> Floats:
    """Change of length over rest length of each pair."""
    rest = np.linalg.norm(scene.x[pairs[:, 0]] - scene.x[pairs[:, 1]], axis=1)
    return np.asarray(np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) / rest - 1)


def clearance(x: Floats) -> float:
    """Smallest signed distance of any particle to the sphere [m]; negative is penetration."""
    return float((np.linalg.norm(x - CENTRE, axis=1) - RADIUS).min())


def drive(scene: Scene, step_frame: Callable[[], object], positions: Callable[[], Any]) -> dict[str, Any]:
    """Run a scene and measure it.

    Args:
        step_frame: advances by 1 / FPS; nothing else is timed.
        positions: returns (n*n, 3) [m] in the scene's order.
    """
    wall, processor, frame_ms = 0.0, 0.0, []
    worst_strain, worst_depth, x = 0.0, 0.0, scene.x
    exploded = None
    for frame in range(scene.frames):
        began, used = time.perf_counter(), time.process_time()
        step_frame()
        took = time.perf_counter() - began
        processor += time.process_time() - used
        wall += took
        frame_ms.append(took * 1e3)
        x = np.array(positions(), float)
        if not np.isfinite(x).all() or np.abs(x).max() > 1e3:
            exploded = frame
            break
        worst_strain = max(worst_strain, float(strain(scene, x, scene.edges).max()))
        if scene.sphere:
            worst_depth = max(worst_depth, -clearance(x))
    done = len(frame_ms) / FPS
    measured: dict[str, Any] = {
        "wall_per_second": wall / done,
        "processor_per_second": processor / done,
        "frame_ms_max": max(frame_ms),
        "exploded_at_frame": exploded,
    }
    if exploded is None:
        lengths = strain(scene, x, scene.edges)
        measured |= {
            "strain_max": float(lengths.max()),
            "strain_mean": float(np.abs(lengths).mean()),
            "strain_any_frame": worst_strain,
            "lowest_z": float(x[:, 2].min()),
            "fallen": float(HEIGHT - x[:, 2].mean()),
        }
        if scene.sphere:
            measured |= {"depth_end": max(0.0, -clearance(x)), "depth_any_frame": worst_depth}
    return {**measured, "x": x}
