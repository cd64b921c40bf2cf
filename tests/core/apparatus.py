"""What the experiments of these tests are set up with: patterns, sheets, chains, bodies, and a loop of bare steps."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike, NDArray

from cloth_core import contact
from cloth_core.bending import Bending, bending_forces
from cloth_core.body import Body
from cloth_core.contact_state import ContactSettings, ContactState
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.pattern import Pattern
from cloth_core.runs import find_runs
from cloth_core.sewing import SeamPull
from cloth_core.simulation import Simulation
from cloth_core.springs import spring_forces
from cloth_core.step import ForceTerms, Workspace, run_steps
from cloth_core.strain_limit import no_strain_limit
from cloth_core.twist import twist_forces

__all__ = [
    "GRAVITY",
    "bending_force",
    "body_of",
    "by_axis",
    "chain",
    "crossings",
    "do_steps",
    "force_terms",
    "keep_within_travel",
    "no_contact",
    "panel",
    "pattern",
    "placed",
    "plain_fabric",
    "rectangle",
    "sheet",
    "sides_through",
    "spring_force",
    "throw",
]

Floats = NDArray[np.float64]
GRAVITY = 9.80665

# ---- patterns and sheets


def panel(
    vertices: Sequence[Sequence[float]], *, at: Sequence[float] = (0, 0, 0), turned: Sequence[float] = (0, 0, 0)
) -> dict[str, Any]:
    """A panel of straight edges in the file's axes (y up, +z in front) [m]."""
    count = len(vertices)
    return {
        "translation": list(at),
        "rotation": list(turned),
        "vertices": [list(v) for v in vertices],
        "edges": [{"endpoints": [i, (i + 1) % count]} for i in range(count)],
    }


def rectangle(width: float, height: float, **placement: Any) -> dict[str, Any]:
    """A rectangle around its own origin; edges 0 to 3 are the lower, right, upper and left one."""
    w, h = width / 2, height / 2
    return panel([(-w, -h), (w, -h), (w, h), (-w, h)], **placement)


def pattern(
    panels: Mapping[str, dict[str, Any]], stitches: Sequence[tuple[Any, ...]] = (), name: str = "it"
) -> Pattern:
    """A pattern in metres; stitches are ((panel, edge), (panel, edge)) or with a third entry "right_wrong"."""
    rows = [[{"panel": p, "edge": e} for p, e in s[:2]] + list(s[2:]) for s in stitches]
    data = {
        "pattern": {"panels": dict(panels), "stitches": rows, "panel_order": list(panels)},
        "properties": {"curvature_coords": "relative", "units_in_meter": 1},
    }
    return Pattern.from_json(json.dumps(data), name)


def sheet(width: float, height: float, spacing: float, z: float = 0.0) -> Garment:
    """A level sheet at height z [m], weft along x and warp along y, its normal up."""
    flat = pattern({"sheet": rectangle(width, height, at=(0, z, 0), turned=(-90, 0, 0))}, name="sheet")
    return Garment.from_pattern(flat, spacing)


def placed(garment: Garment, rotation: ArrayLike | None = None, move: ArrayLike = (0.0, 0.0, 0.0)) -> Garment:
    """The garment with its start positions turned by a matrix (3, 3) and then moved [m]."""
    turn = np.eye(3) if rotation is None else np.asarray(rotation)
    return replace(
        garment, start=garment.start @ turn.T + np.asarray(move), panel_normals=garment.panel_normals @ turn.T
    )


def plain_fabric(**changes: Any) -> Fabric:
    """A soft fabric without damping, friction or the third spring family, so that a test adds what it is about."""
    values: dict[str, Any] = {
        "area_density": 0.2,
        "structural_warp": 400.0,
        "structural_weft": 400.0,
        "shear": 100.0,
        "bending": 1e-5,
        "bending_spring": 0.0,
        "damping_time": 0.0,
        "bending_damping_time": 0.0,
        "friction": 0.0,
        "strain_limit": 10.0,
    }
    return Fabric(name="plain", **(values | changes))


# ---- bodies


def body_of(mesh: trimesh.Trimesh, rotation: ArrayLike | None = None, move: ArrayLike = (0.0, 0.0, 0.0)) -> Body:
    """A trimesh as a body, turned and moved."""
    turn = np.eye(3) if rotation is None else np.asarray(rotation)
    return Body.from_arrays(np.asarray(mesh.vertices) @ turn.T + np.asarray(move), np.asarray(mesh.faces), "test body")


def crossings(x: Floats, triangles: NDArray[np.int32], body: Body) -> int:
    """Sides of the cloth through the body and of the body through the cloth: without the package's trees.

    By the formula of Moeller and Trumbore, which is not the package's.
    """
    cloth, obstacle = (x, triangles), (body.vertices, body.triangles)
    return sides_through(*cloth, *obstacle) + sides_through(*obstacle, *cloth)


def sides_through(va: Floats, ta: NDArray[np.int32], vb: Floats, tb: NDArray[np.int32]) -> int:
    """Number of sides of one mesh, (n, 3) and (m, 3), that cross any triangle of the other."""
    sides = np.unique(np.sort(np.concatenate([ta[:, [0, 1]], ta[:, [1, 2]], ta[:, [2, 0]]]), axis=1), axis=0)
    ends, corner = va[sides], vb[tb]
    # Pairs whose boxes meet as seen from above and from the side; of these the crossing ones.
    a, b = (np.hstack([m.min(axis=1), m.max(axis=1)]) for m in (ends, corner))
    side, triangle = shapely.STRtree(shapely.box(*b[:, [0, 1, 3, 4]].T)).query(shapely.box(*a[:, [0, 1, 3, 4]].T))
    meet = (a[side, 2] <= b[triangle, 5]) & (b[triangle, 2] <= a[side, 5])
    side, triangle = side[meet], triangle[meet]
    p, near = ends[side, 0], corner[triangle]
    way, e1, e2 = ends[side, 1] - p, near[:, 1] - near[:, 0], near[:, 2] - near[:, 0]
    h = np.cross(way, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = 1.0 / (e1 * h).sum(-1)
        s = p - near[:, 0]
        k = np.cross(s, e1)
        u, v, t = f * (s * h).sum(-1), f * (way * k).sum(-1), f * (e2 * k).sum(-1)
    return len(np.unique(side[(u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)]))


def throw(simulation: Simulation, velocity: ArrayLike) -> None:
    """Give the particles a velocity [m/s], one for all or (k, 3)."""
    simulation.motion.v[:] = velocity
    if simulation.model.contact is not None:
        simulation.motion.search_contacts()  # how far it looks depends on the speed


# ---- bare steps, without a Simulation


def keep_within_travel(x: Floats, v: Floats, found: ContactState, moved: Floats) -> bool:
    """That of the package for x, v with a row for each particle, (n, 3), in place."""
    columns, speeds = by_axis(x), by_axis(v)
    spent = contact.keep_within_travel(columns, speeds, found, moved)
    x[:], v[:] = columns.T, speeds.T
    return bool(spent)


def by_axis(a: ArrayLike) -> Floats:
    """A copy of (n, 3) with a row for each axis, (3, n), as the force kernels take it."""
    return np.ascontiguousarray(np.asarray(a, dtype=float).T)


def spring_force(
    x: Floats, v: Floats, pairs: ArrayLike, rest_length: ArrayLike, stiffness: ArrayLike, damping_time: float
) -> Floats:
    """The package's spring forces on each particle, x and v (n, 3); returns (n, 3)."""
    force = np.zeros((3, len(x)))
    values = np.stack([np.asarray(rest_length, dtype=float), np.asarray(stiffness, dtype=float)], axis=1)
    runs = find_runs(np.asarray(pairs, dtype=np.int32), values)
    spring_forces(by_axis(x), by_axis(v), runs, damping_time, force)
    return np.ascontiguousarray(force.T)


def bending_force(bending: Bending, x: Floats, v: Floats | None = None, damping_time: float = 0.0) -> Floats:
    """The package's bending forces on each particle, x and v (n, 3); returns (n, 3)."""
    ahead = x if v is None else x + damping_time * v
    force = np.zeros((3, len(x)))
    bending_forces(
        by_axis(ahead), bending.line_runs(), bending.hinges, bending.hinge_weights, bending.hinge_stiffness, force,
    )  # fmt: skip
    twist_forces(by_axis(ahead), bending.twist_runs(), force)
    return np.ascontiguousarray(force.T)


def force_terms(mass: ArrayLike, **given: Any) -> ForceTerms:
    """Force terms of particles of the given masses [kg]; what is not given is absent. `held` lists fixed particles."""
    m = np.array(mass, dtype=float)
    inverse = 1.0 / m
    inverse[np.asarray(given.pop("held", []), dtype=int)] = 0.0
    pairs = np.asarray(given.pop("spring_pairs", np.zeros((0, 2))), dtype=np.int32)
    lengths, stiffness = (
        np.asarray(given.pop(key, np.zeros(0)), dtype=float) for key in ("spring_rest_length", "spring_stiffness")
    )
    values: dict[str, Any] = {
        "mass": m,
        "inverse_mass": inverse,
        "gravity": np.zeros(3),
        "air_drag": 0.0,
        "springs": find_runs(pairs, np.stack([lengths, stiffness], axis=1)),
        "spring_damping_time": 0.0,
        "trellis": find_runs(np.zeros((0, 4), dtype=np.int32), np.zeros((0, 1))),
        "lines": find_runs(np.zeros((0, 3), dtype=np.int32), np.zeros((0, 1))),
        "twists": find_runs(np.zeros((0, 4), dtype=np.int32), np.zeros((0, 1))),
        "hinges": np.zeros((0, 4), dtype=np.int32),
        "hinge_weights": np.zeros((0, 4)),
        "hinge_stiffness": np.zeros(0),
        "bending_damping_time": 0.0,
        "seam": SeamPull(np.zeros((0, 2), dtype=np.int32), np.zeros(0), np.zeros(0), np.zeros(0), 0.0, 0.0),
        "strain_limit": no_strain_limit(),
    }  # fmt: skip
    for key, value in given.items():
        values[key] = np.asarray(value, dtype=float) if isinstance(value, list) else value
    for key in ("air_drag", "spring_damping_time", "bending_damping_time"):
        values[key] = float(values[key])
    return ForceTerms(**values)


def chain(count: int, mass: float, stiffness: float, length: float, **given: Any) -> tuple[Floats, ForceTerms]:
    """`count` equal masses [kg] below a held particle 0, each on a spring of that stiffness [N/m] and length [m]."""
    x = np.zeros((count + 1, 3))
    x[:, 2] = -length * np.arange(count + 1)
    links = np.stack([np.arange(count), np.arange(1, count + 1)], axis=1)
    terms = force_terms(
        np.full(count + 1, mass),
        held=given.pop("held", [0]),
        spring_pairs=links,
        spring_rest_length=np.full(count, length),
        spring_stiffness=np.full(count, stiffness),
        **given,
    )
    return x, terms


def no_contact() -> ContactSettings:
    """Nothing to collide with."""
    return ContactSettings(
        active=False, body_vertices=np.zeros((0, 3)), body_velocity=np.zeros((0, 3)),
        body_triangles=np.zeros((0, 3), dtype=np.int32), body_way=0.0, offset=0.0, friction=0.0, push_speed=0.0,
    )  # fmt: skip


def do_steps(x: Floats, v: Floats, terms: ForceTerms, dt: float, count: int, openness: float = 0.0) -> None:
    """`count` steps of the package's compiled loop, in place, with nothing to collide with."""
    done = run_steps(
        x, v, Workspace.of(len(x)), np.zeros(len(x)), terms, no_contact(), ContactState.none(), dt, count, openness, 0.0
    )
    assert done == count
