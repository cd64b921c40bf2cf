"""The Cusick drape test (BS 5058, ISO 9073-9): a disc of cloth over a smaller round table, seen from above.

In the test the table rises slowly. A disc that all of its weight pulls down at once buckles into many more folds, which
then stay; so here the weight grows step by step, from rest to rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
import trimesh
from apparatus import body_of, pattern, rectangle
from scipy.signal import find_peaks

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

__all__ = ["BANDS", "DISC_RADIUS", "PUBLISHED", "SUPPORT_RADIUS", "Drape", "drape", "published_fabric"]

DISC_RADIUS, SUPPORT_RADIUS = 0.150, 0.090
OFFSET = 0.001

# Matsudaira et al. 2015 (read in a transcription): kg/m2, m, N m, drape coefficient [%], folds.
PUBLISHED = {
    "cotton broadcloth": (0.1238, 0.497e-3, 11.57e-6, 82.9, 2),
    "polyester tropical": (0.1165, 0.340e-3, 7.55e-6, 50.7, 5),
    "wool tropical": (0.1629, 0.407e-3, 6.57e-6, 49.8, 5),
    "polyester faille": (0.1043, 0.226e-3, 1.86e-6, 28.3, 7),
}
# Usual drape coefficients of the classes that presets stand for [%].
BANDS = {"silk": (20.0, 40.0), "cotton_poplin": (60.0, 76.0), "wool": (40.0, 70.0), "denim": (70.0, 90.0)}
# Shares of the weight, one after the other.
LOADS = np.geomspace(0.02, 1.0, 10)


@dataclass(frozen=True)
class Drape:
    """A disc at rest: positions (n, 3) [m], triangles, drape coefficient [%], folds, whether it came to rest."""

    x: np.ndarray
    triangles: np.ndarray
    rim: np.ndarray
    coefficient: float
    folds: int
    settled: bool


def disc(spacing: float) -> Garment:
    """A level disc of cloth just above the table, warp along y."""
    side = DISC_RADIUS * math.sqrt(2.0)
    data = rectangle(side, side, at=(0, 2.0 * OFFSET, 0), turned=(-90, 0, 0))
    for edge in data["edges"]:
        edge["curvature"] = {"type": "circle", "params": [DISC_RADIUS, 0, 1]}
    return Garment.from_pattern(pattern({"disc": data}, name="disc"), spacing)


def published_fabric(name: str, shear: float = 30.0) -> Fabric:
    """One of the published fabrics; their shear stiffness is not, so that it is what wearable cloth has at least.

    Its weight pulls with less than 0.1 N/m: a membrane of 500 N/m strains by 0.02 % and is as good as a stiffer one.
    """
    area_density, thickness, bending, _, _ = PUBLISHED[name]
    return Fabric(
        name=name, area_density=area_density, structural_warp=500.0, structural_weft=500.0, shear=shear,
        bending=bending, thickness=thickness, friction=0.35,
    )  # fmt: skip


def drape(
    fabric: Fabric,
    spacing: float = 0.01,
    seed: int = 0,
    loads: Sequence[float] = LOADS,
    start: np.ndarray | None = None,
) -> Drape:
    """Drape a disc.

    It starts with unevenness of 0.1 mm, from which its folds grow; the seed draws it. Or with given heights [m], (n,).
    """
    garment = disc(spacing)
    random = 1e-4 * np.random.default_rng(seed).standard_normal(garment.particle_count)
    uneven = random if start is None else start
    garment = replace(garment, start=garment.start + uneven[:, None] * [0.0, 0.0, 1.0])
    table = body_of(trimesh.creation.cylinder(SUPPORT_RADIUS, 0.3, sections=96), move=(0.0, 0.0, -0.15))
    clamped = np.flatnonzero(np.hypot(*garment.rest.T) < SUPPORT_RADIUS - 0.25 * spacing).astype(np.int32)
    settings = Settings(spacing=spacing, contact_offset=OFFSET, rest_displacement=2e-4)
    settled = True
    for load in loads:
        gravity = (0.0, 0.0, -9.80665 * float(load))
        simulation = Simulation(
            Scene(garment=garment, fabric=fabric, body=table, pins=clamped, gravity=gravity, settings=settings)
        )
        settled &= simulation.settle().settled
        garment = replace(garment, start=simulation.positions.copy())
    x, triangles = simulation.sewn_mesh()
    rim = x[garment.outline[0]]
    return Drape(x, triangles, rim, drape_coefficient(x, triangles), fold_count(rim), settled)


def drape_coefficient(x: np.ndarray, triangles: np.ndarray) -> float:
    """(Projected area - support) / (cloth - support) in per cent: the union of the triangles seen from above."""
    seen = shapely.union_all(shapely.polygons(x[triangles][:, :, :2]).astype(object), grid_size=1e-7).area
    support, cloth = math.pi * SUPPORT_RADIUS**2, math.pi * DISC_RADIUS**2
    return float(100.0 * (seen - support) / (cloth - support))


def outline(rim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radius [m] of the rim over 360 even directions [rad], seen from above."""
    angle = np.arctan2(rim[:, 1], rim[:, 0])
    order = np.argsort(angle)
    even = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    return even, np.interp(even, angle[order], np.hypot(rim[:, 0], rim[:, 1])[order], period=2.0 * math.pi)


def fold_count(rim: np.ndarray) -> int:
    """Waves of the rim: peaks of its radius that stand out by a tenth of the overhang."""
    _, radius = outline(rim)
    peaks, _ = find_peaks(np.tile(radius, 3), prominence=0.1 * (DISC_RADIUS - SUPPORT_RADIUS))
    return int(((peaks >= 360) & (peaks < 720)).sum())
