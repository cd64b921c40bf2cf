"""Shear of cells and their twist: moduli, forces against energies, and folds that cost the same in all directions."""

import math

import numpy as np
import pytest
from apparatus import by_axis, plain_fabric, sheet
from scipy.optimize import minimize

from cloth_core.bending import build_bending
from cloth_core.garment import Garment
from cloth_core.model import Model
from cloth_core.runs import find_runs
from cloth_core.scene import Scene
from cloth_core.springs import build_springs
from cloth_core.trellis import trellis_forces, trellis_stiffness
from cloth_core.twist import twist_forces, twist_stiffness

Floats = np.ndarray


def flat(garment: Garment) -> Floats:
    return np.column_stack([garment.rest, np.zeros(len(garment.rest))])


def shear_energy(x: Floats, cells: Floats, stiffness: Floats) -> float:
    """Sum of k / 4 (l1 - l2)^2 over all cells [J]."""
    first = np.linalg.norm(x[cells[:, 2]] - x[cells[:, 0]], axis=1)
    second = np.linalg.norm(x[cells[:, 3]] - x[cells[:, 1]], axis=1)
    return float((stiffness * (first - second) ** 2).sum() / 4)


def spring_energy(x: Floats, garment: Garment, **fabric: float) -> float:
    springs = build_springs(garment, plain_fabric(**fabric))
    length = np.linalg.norm(x[springs.pairs[:, 1]] - x[springs.pairs[:, 0]], axis=1)
    return float((springs.stiffness * (length - springs.rest_length) ** 2).sum() / 2)


def shear_force(x: Floats, v: Floats, cells: Floats, stiffness: Floats, damping_time: float = 0.0) -> Floats:
    """The package's, (n, 3)."""
    force = np.zeros((3, len(x)))
    trellis_forces(by_axis(x), by_axis(v), find_runs(cells, stiffness[:, None]), damping_time, force)
    return force.T


def twist_force(x: Floats, cells: Floats, stiffness: Floats) -> Floats:
    """The package's, (n, 3)."""
    force = np.zeros((3, len(x)))
    twist_forces(by_axis(x), find_runs(cells, stiffness[:, None]), force)
    return force.T


def crumpled(garment: Garment) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(5)
    return flat(garment) + 0.003 * rng.standard_normal((garment.particle_count, 3)), rng.standard_normal(
        (garment.particle_count, 3)
    )


def rolled(garment: Garment, curvature: float, angle: float) -> Floats:
    """The sheet on a cylinder, without any stretch; its axis is at `angle` to the weft."""
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    p, q = garment.rest @ along, garment.rest @ across
    bent = np.column_stack([p, np.sin(curvature * q) / curvature, (1 - np.cos(curvature * q)) / curvature])
    return bent


@pytest.mark.parametrize("spacing", [0.02, 0.01])
def test_shear_modulus_is_the_fabrics_and_stretch_is_free_of_it(spacing):
    # C11 and C22 are those of the structural springs alone, C12 = 0, G = k.
    garment = sheet(0.2, 0.12, spacing)
    stiffness, e, area = trellis_stiffness(garment, 70.0), 1e-5, garment.areas.sum()

    def stretched(xx: float, yy: float, xy: float) -> float:
        x = flat(garment) @ np.array([[1 + xx, xy, 0], [xy, 1 + yy, 0], [0, 0, 1]])
        held = spring_energy(x, garment, structural_warp=500.0, structural_weft=300.0, shear=70.0)
        return 2 * (held + shear_energy(x, garment.quads, stiffness)) / (e * e * area)

    c11, c22, both, g = stretched(e, 0, 0), stretched(0, e, 0), stretched(e, e, 0), stretched(0, 0, e / 2)
    assert [c11, c22, g] == pytest.approx([300.0, 500.0, 70.0], rel=1e-3)
    assert (both - c11 - c22) / 2 == pytest.approx(0.0, abs=0.1)


def test_forces_are_the_slope_of_the_energies():
    garment = sheet(0.25, 0.1, 0.02)  # runs of twelve cells, of which the last block overlaps the one before
    x, v = crumpled(garment)
    cells, shear, twist = garment.quads, trellis_stiffness(garment, 40.0), twist_stiffness(garment, 1e-4)

    def twist_energy(at: Floats) -> float:
        a, b, c, d = (at[cells[:, k]] for k in range(4))
        return float((twist * ((a - b + c - d) ** 2).sum(axis=1)).sum() / 2)

    sheared, twisted = shear_force(x, v, cells, shear), twist_force(x, cells, twist)
    for i in range(garment.particle_count):
        for axis in range(3):
            nudge = np.zeros_like(x)
            nudge[i, axis] = 1e-6
            slope = (shear_energy(x + nudge, cells, shear) - shear_energy(x - nudge, cells, shear)) / 2e-6
            assert sheared[i, axis] == pytest.approx(-slope, rel=1e-5, abs=1e-6)
            slope = (twist_energy(x + nudge) - twist_energy(x - nudge)) / 2e-6
            assert twisted[i, axis] == pytest.approx(-slope, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("damping_time", [0.0, 0.02])
@pytest.mark.parametrize("rows_apart", [False, True])
def test_runs_and_single_cells_give_the_same_forces(damping_time, rows_apart):
    garment = sheet(0.25, 0.1, 0.02)
    x, v = crumpled(garment)
    cells = garment.quads
    if rows_apart:  # no corner of a cell is the next particle after another one
        cells = np.arange(13, dtype=np.int32)[:, None] + np.array([0, 20, 60, 40], dtype=np.int32)
    shear, twist = np.full(len(cells), 40.0), np.full(len(cells), 0.5)
    runs = find_runs(cells, shear[:, None])
    assert runs.length.sum() > 0.6 * len(cells)
    assert (np.diff(runs.first[:, :2], axis=1) == (20 if rows_apart else 1)).all()
    order = np.random.default_rng(6).permutation(len(cells))
    single = sum(shear_force(x, v, cells[[s]], shear[[s]], damping_time) for s in order)
    np.testing.assert_allclose(shear_force(x, v, cells, shear, damping_time), single, rtol=1e-9, atol=1e-12)
    single = sum(twist_force(x, cells[[s]], twist[[s]]) for s in order)
    np.testing.assert_allclose(twist_force(x, cells, twist), single, rtol=1e-9, atol=1e-12)


def test_damping_takes_the_power_of_the_difference_of_the_rates():
    garment = sheet(0.1, 0.1, 0.02)
    x, v = crumpled(garment)
    cells, k, tau = garment.quads, trellis_stiffness(garment, 40.0), 0.01
    force = shear_force(x, v, cells, k, tau) - shear_force(x, v, cells, k)
    rates = []
    for one, other in ((0, 2), (1, 3)):
        way = x[cells[:, other]] - x[cells[:, one]]
        speed = v[cells[:, other]] - v[cells[:, one]]
        rates.append((way * speed).sum(axis=1) / np.linalg.norm(way, axis=1))
    assert (force * v).sum() == pytest.approx(-(0.5 * k * tau * (rates[0] - rates[1]) ** 2).sum(), rel=1e-9)


@pytest.mark.parametrize("degrees", [0, 20, 45, 70, 90])
def test_fold_stretches_nothing_in_any_direction(degrees):
    # What is left of the energy of chords when the strain that costs least is chosen, for either law of shear.
    garment, curvature, k, h = sheet(0.4, 0.4, 0.02), 1 / 0.05, 50.0, 0.02
    x, area = rolled(garment, curvature, math.radians(degrees)), garment.areas.sum()
    way = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])

    def left(strain: Floats, shear: float, spring: float) -> float:
        # A small strain of the plane, put on before it is rolled.
        xx, yy, xy = 1e-3 * strain
        plane = garment.rest @ np.array([[1 + xx, xy], [xy, 1 + yy]])
        p, q = plane @ way, plane @ np.array([-way[1], way[0]])
        at = np.column_stack([p, np.sin(curvature * q) / curvature, (1 - np.cos(curvature * q)) / curvature])
        held = spring_energy(at, garment, structural_warp=5e4, structural_weft=5e4, shear=shear, shear_spring=spring)
        return 1e6 * (held + shear_energy(at, garment.quads, trellis_stiffness(garment, shear))) / area

    least = [
        1e-6 * minimize(left, np.zeros(3), args=law, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-9}).fun
        for law in ((k, 0.0), (0.0, k))
    ]
    assert x.shape == (garment.particle_count, 3)
    # Along a diagonal two springs hold k (c h)^4 / 512 of it; the trellis holds hardly any.
    paper = k * (curvature * h) ** 4 / 512
    assert least[0] < 0.02 * paper
    if degrees == 45:
        assert least[1] == pytest.approx(paper, rel=0.15)


@pytest.mark.parametrize("degrees", [0, 30, 45, 80])
def test_bending_is_the_same_in_all_directions(degrees):
    # B c^2 / 2 per area: (sin^4 + cos^4) of it by the lines, 2 sin^2 cos^2 by the twist of cells.
    garment, stiffness, curvature = sheet(0.4, 0.4, 0.01), 1e-5, 2.0
    x = rolled(garment, curvature, math.radians(degrees))
    bending = build_bending(garment, plain_fabric(bending=stiffness), np.arange(garment.particle_count, dtype=np.int32))
    assert len(bending.hinges) == 0
    weights = np.array([1.0, -2.0, 1.0])
    lines = (bending.line_stiffness * ((x[bending.lines] * weights[:, None]).sum(axis=1) ** 2).sum(axis=1)).sum() / 2
    weights = np.array([1.0, -1.0, 1.0, -1.0])
    twist = (bending.twist_stiffness * ((x[bending.cells] * weights[:, None]).sum(axis=1) ** 2).sum(axis=1)).sum() / 2
    whole = stiffness * curvature**2 / 2 * garment.areas.sum()
    angle = math.radians(degrees)
    assert twist == pytest.approx(2 * (math.sin(angle) * math.cos(angle)) ** 2 * whole, rel=2e-3, abs=1e-3 * whole)
    # There is no triple across the outline: of 40 cells in a row, half of one is missing at each end.
    assert lines / (39 / 40) == pytest.approx((math.sin(angle) ** 4 + math.cos(angle) ** 4) * whole, rel=2e-3)


def test_model_has_cells_only_where_the_fabric_resists_shear_as_a_trellis():
    garment = sheet(0.1, 0.1, 0.02)
    model = Model(Scene(garment, plain_fabric(shear=40.0)))
    assert (len(model.trellis), len(model.force_terms(0.0).trellis.rest)) == (25, 25)
    paper = Model(Scene(garment, plain_fabric(shear=0.0, shear_spring=40.0)))
    assert len(paper.trellis) == 0
    without = Model(Scene(garment, plain_fabric(shear=40.0), without=("shear springs",)))
    assert len(without.trellis) == 0
    # The diagonals are counted, and no loop runs over those that have no stiffness.
    assert len(model.springs) == len(paper.springs) == len(without.springs)
    runs = model.force_terms(0.0).springs
    assert runs.length.sum() + len(runs.rest) == len(model.springs) - 50
