"""A strip clamped level at one end, hanging under its weight: the master curve of Romero et al. 2021."""

from __future__ import annotations

import math

import numpy as np
from apparatus import GRAVITY, do_steps, plain_fabric, sheet

from cloth_core.model import Model
from cloth_core.scene import Scene

__all__ = ["MASTER_CURVE", "drop_over_reach", "hang"]

# Gamma = area density * g * L^3 / B: drop over reach of the tip, to 0.1 %.
MASTER_CURVE = {
    0.1: 0.0125, 1.0: 0.1247, 2.0: 0.2469, 5.0: 0.5862, 8.0: 0.8849, 10.0: 1.067, 20.0: 1.864, 50.0: 3.704,
    100.0: 5.884,
}  # fmt: skip


def hang(gamma: float, spacing: float = 0.008, overall: float = 0.2) -> tuple[np.ndarray, float]:
    """Rest shape of the strip: (n, 2) reach and height of its middle line [m], and the free length [m].

    Two columns of particles hold the direction between them, so that it is free from the middle of the first cell on.
    """
    garment = sheet(overall, spacing, spacing)
    along = garment.rest[:, 0] - garment.rest[:, 0].min()
    clamped = np.flatnonzero(along < 1.5 * spacing).astype(np.int32)
    length = overall - spacing / 2.0
    fabric = plain_fabric(area_density=0.2, bending=0.2 * GRAVITY * length**3 / gamma, shear=300.0)
    # Stiff strips swing fast and with little air are still soon; limp ones need more.
    drag = 8.0
    scene = Scene(garment=garment, fabric=fabric, pins=clamped, gravity=(0.0, 0.0, -GRAVITY), air_drag=drag)
    model = Model(scene)
    x, v = garment.start.copy(), np.zeros_like(garment.start)
    dt = 0.9 * model.stable_step(x, drag).time_step
    do_steps(x, v, model.force_terms(drag), dt, math.ceil(4.0 / dt))
    assert np.abs(v).max() < 1e-4, "the strip still moves"
    columns = np.unique(np.round(along, 9))
    line = np.array([x[np.abs(along - c) < 1e-8][:, [0, 2]].mean(axis=0) for c in columns])
    return line - [line[0, 0] + spacing / 2.0, 0.0], length


def drop_over_reach(line: np.ndarray) -> float:
    """H / W of the tip."""
    return float(-line[-1, 1] / line[-1, 0])
