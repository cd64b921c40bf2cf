"""Step 7 of the paper: seams pull the flat panels together around the body, step by step.

Each pair of seam points is joined by a spring whose length shrinks from the start distance to nothing within the
closing time; its force is limited, so that a seam that the body holds open pulls without tearing. When a seam has
closed, its pairs become one particle each.

Of several garments each is closed before the next one is pulled together over it. Otherwise the sides of a shirt that
are still flat stick out between those of the skirt that closes around them. The implicit integrator, which pulls from
the first step on with all its force, closes all at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment, Seam
from cloth_core.kernel import borrowing_kernel

__all__ = ["SeamPull", "build_seam_pull", "renumbered_pull", "seam_forces", "seam_gaps"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Damping ratio of a seam spring between its two particles: they hardly swing past each other.
_DAMPING_RATIO = 0.1


class SeamPull(NamedTuple):
    """Springs that close the seams.

    Attributes:
        pairs: particles to join, (p, 2).
        start_length: their distance at the start [m], (p,).
        damping: [N s/m], (p,).
        sooner: how many closing times before the last they close, (p,).
        stiffness: [N/m]; largest_force: [N].
    """

    pairs: Ints
    start_length: Floats
    damping: Floats
    sooner: Floats
    stiffness: float
    largest_force: float


def build_seam_pull(
    garment: Garment, fabric: Fabric, x: Floats, softness: float = 1.0, seams: Sequence[Seam] | None = None
) -> SeamPull:
    """Seam springs of a garment at positions x (n, 3) [m], for some of its seams or for all; unsewn numbering.

    They are as stiff as the cloth itself, so that they do not shorten the time step, and pull at most as hard as a
    stretch of the fabric by its strain limit would; softness: what the cloth's own stiffness is multiplied by.
    """
    seams = garment.seams if seams is None else seams
    if seams:
        both = np.concatenate([np.stack([s.first, s.second], 1) for s in seams])
        pairs = np.unique(np.sort(both[both[:, 0] != both[:, 1]], axis=1), axis=0).astype(np.int32)
    else:
        pairs = np.zeros((0, 2), dtype=np.int32)
    structural = 0.5 * softness * (fabric.structural_warp + fabric.structural_weft)
    stiffness = 0.5 * structural
    mass = fabric.area_density * garment.particle_areas[pairs]
    reduced = mass[:, 0] * mass[:, 1] / np.maximum(mass.sum(axis=1), 1e-300)
    return SeamPull(
        pairs=pairs,
        start_length=np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1),
        damping=2.0 * _DAMPING_RATIO * np.sqrt(stiffness * reduced),
        sooner=(garment.layer_count - 1 - garment.layer_of_particle[pairs[:, 0]]).astype(np.float64),
        stiffness=stiffness,
        largest_force=max(fabric.strain_limit, 0.05) * structural * garment.spacing,
    )


def renumbered_pull(pull: SeamPull, number: Ints) -> SeamPull:
    """The same springs where particles are merged to `number` (n,), without those whose ends are one by now."""
    pairs = number[pull.pairs]
    apart = pairs[:, 0] != pairs[:, 1]
    return pull._replace(
        pairs=np.ascontiguousarray(pairs[apart], dtype=np.int32),
        start_length=pull.start_length[apart],
        damping=pull.damping[apart],
        sooner=pull.sooner[apart],
    )


@borrowing_kernel
def seam_forces(x: Floats, v: Floats, seam: SeamPull, openness: float, force: Floats) -> None:
    """Pull both ends of each pair together; x, v, force (3, n) [m, m/s, N].

    Openness, in closing times, is what is left until the last pairs are closed, and below 1 the share of their start
    length that is still open; of those that close sooner it is so much less.
    """
    for s in range(seam.pairs.shape[0]):
        i, j = seam.pairs[s, 0], seam.pairs[s, 1]
        dx = x[0, j] - x[0, i]
        dy = x[1, j] - x[1, i]
        dz = x[2, j] - x[2, i]
        ux = v[0, j] - v[0, i]
        uy = v[1, j] - v[1, i]
        uz = v[2, j] - v[2, i]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        share = seam.stiffness
        still_open = min(openness - seam.sooner[s], 1.0)
        if still_open > 0.0:
            excess = length - still_open * seam.start_length[s]
            share = seam.stiffness * max(excess, 0.0) / length if length > 0.0 else 0.0
        pull = share * length
        if pull > seam.largest_force:
            share *= seam.largest_force / pull
        damping = seam.damping[s]
        fx = share * dx + damping * ux
        fy = share * dy + damping * uy
        fz = share * dz + damping * uz
        force[0, i] += fx
        force[1, i] += fy
        force[2, i] += fz
        force[0, j] -= fx
        force[1, j] -= fy
        force[2, j] -= fz


def seam_gaps(garment: Garment, x: Floats) -> dict[str, float]:
    """Largest distance [m] of the points to be joined, for each seam; x (n, 3) in the unsewn numbering."""
    return {s.name: float(np.linalg.norm(x[s.first] - x[s.second], axis=1).max()) for s in garment.seams}
