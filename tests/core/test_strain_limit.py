"""The strain limit: cloth far too soft for its load stretches to its limit and no farther; momentum is kept."""

import numpy as np
import pytest
from apparatus import GRAVITY, chain, do_steps, plain_fabric, sheet

from cloth_core.model import Model
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.springs import SpringFamily, Springs, spring_strains
from cloth_core.strain_limit import build_strain_limit, hold_strain, watch_strain

LIMIT = 0.05


def chain_springs(count: int, length: float, stiffness: float) -> Springs:
    pairs = np.stack([np.arange(count), np.arange(1, count + 1)], axis=1).astype(np.int32)
    return Springs(pairs, np.full(count, length), np.full(count, stiffness), np.zeros(count, dtype=np.int32))


@pytest.mark.parametrize("stiffness", [50.0, 5000.0])
def test_hanging_chain_stretches_to_its_limit_and_no_farther(stiffness):
    # Extension (N - i + 1) m g / k below the limit, the limit above it.
    count, m, length = 8, 0.01, 0.1
    limit = build_strain_limit(chain_springs(count, length, stiffness), LIMIT)
    x, terms = chain(count, m, stiffness, length, gravity=[0.0, 0.0, -GRAVITY], air_drag=10.0, strain_limit=limit)
    v = np.zeros_like(x)
    dt = min(0.5 * np.sqrt(m / stiffness), 1e-3)
    for _ in range(int(6.0 / dt) // 32):
        do_steps(x, v, terms, dt, 32)
    strain = np.linalg.norm(np.diff(x, axis=0), axis=1) / length - 1.0
    free = np.arange(count, 0, -1) * m * GRAVITY / stiffness / length
    assert strain.max() <= LIMIT
    np.testing.assert_allclose(strain, np.minimum(free, strain.max()), atol=5e-4)
    if free.max() > LIMIT:
        assert strain.max() == pytest.approx(LIMIT, rel=0.05)
    assert np.abs(v).max() < 1e-3


@pytest.mark.parametrize("limit", [0.0075, 0.015, 0.025, 0.035, 0.05])
def test_sheet_too_soft_for_its_weight_comes_to_rest_at_its_limit(limit):
    # Without a limit 2 kg/m2 * g * 0.4 m / (100 + 5) N/m would stretch its upper rows by 7.5 %.
    garment = sheet(0.2, 0.4, 0.04)
    held = np.flatnonzero(garment.rest[:, 1] > 0.199).astype(np.int32)

    def hung(strain_limit: float) -> Simulation:
        fabric = plain_fabric(
            area_density=2.0, structural_warp=100.0, structural_weft=100.0, shear=5.0, damping_time=1e-3,
            strain_limit=strain_limit,
        )  # fmt: skip
        simulation = Simulation(
            Scene(
                garment=garment,
                fabric=fabric,
                pins=held,
                gravity=(0.0, -GRAVITY, 0.0),
                air_drag=5.0,
                settings=Settings(),
            )
        )
        simulation.advance(3.0)
        return simulation

    assert hung(10.0).report().max_strain == pytest.approx(0.07, abs=0.01)
    limited = hung(limit)
    assert limited.report().max_strain <= limit
    assert limited.report().max_strain > 0.9 * limit
    assert limited.progress.largest_speed < 0.01


def test_springs_below_their_limit_are_left_alone():
    rng = np.random.default_rng(1)
    springs = chain_springs(6, 0.1, 100.0)
    x = np.zeros((7, 3))
    x[:, 0] = np.concatenate([[0], np.cumsum(0.1 * rng.uniform(0.5, 1.03, 6))])
    v = rng.standard_normal((7, 3)) * 0.01
    limit = build_strain_limit(springs, LIMIT)
    before = x.copy(), v.copy()
    watch_strain(x, limit)
    hold_strain(x, v, np.ones(7), limit, 1e-3)
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(v, before[1])


def test_shear_and_bending_springs_have_no_limit():
    springs = chain_springs(3, 0.1, 1.0)
    kinds = Springs(springs.pairs, springs.rest_length, springs.stiffness, np.array([0, 1, 2], dtype=np.int32))
    limit = build_strain_limit(kinds, LIMIT)
    assert limit.pairs.tolist() == [[0, 1]]
    assert 0.1 < limit.longest[0] <= 0.105


def test_holding_keeps_momentum_and_angular_momentum():
    rng = np.random.default_rng(3)
    garment = sheet(0.2, 0.2, 0.05)
    model = Model(Scene(garment=garment, fabric=plain_fabric(strain_limit=LIMIT), settings=Settings()))
    x = garment.start * 1.06 + 0.001 * rng.standard_normal(garment.start.shape)
    v = rng.standard_normal(x.shape)
    mass, dt = model.mass[:, None], 1e-4
    momentum = (mass * v).sum(axis=0)
    angular = np.cross(x, mass * v).sum(axis=0)
    before = v.copy()
    watch_strain(x, model.strain_limit)
    hold_strain(x, v, model.inverse_mass, model.strain_limit, dt)
    assert np.abs(v - before).max() > 0.1  # it has done something
    np.testing.assert_allclose((mass * v).sum(axis=0), momentum, atol=1e-12)
    np.testing.assert_allclose(np.cross(x, mass * v).sum(axis=0), angular, atol=1e-5)


def test_it_only_ever_pulls():
    # A spring that has reached its limit while its ends already approach each other gets nothing.
    springs = chain_springs(1, 0.1, 1.0)
    x, v = np.array([[0.0, 0, 0], [0.106, 0, 0]]), np.array([[0.0, 0, 0], [-5.0, 0, 0]])
    limit = build_strain_limit(springs, LIMIT)
    watch_strain(x, limit)
    hold_strain(x, v, np.ones(2), limit, 1e-3)
    np.testing.assert_array_equal(v, [[0.0, 0, 0], [-5.0, 0, 0]])


def test_limit_does_not_shorten_the_time_step():
    garment = sheet(0.2, 0.2, 0.05)
    steps = [
        Model(Scene(garment=garment, fabric=plain_fabric(strain_limit=limit)))
        .stable_step(garment.start * 1.1, 0.0)
        .time_step
        for limit in (0.01, 10.0)
    ]
    assert steps[0] == steps[1]


def test_report_warns_of_a_strain_above_the_limit():
    garment = sheet(0.2, 0.2, 0.05)
    simulation = Simulation(Scene(garment=garment, fabric=plain_fabric(strain_limit=LIMIT), settings=Settings()))
    simulation.motion.x *= 1.08  # pulled apart all at once
    report = simulation.report()
    assert report.max_strain == pytest.approx(0.08, rel=1e-6)
    assert report.mean_strain == pytest.approx(0.08, rel=1e-6)
    assert any(w.startswith("strain 8.0 % is above the fabric's limit of 5 %") for w in report.warnings)
    structural = simulation.model.springs.family == SpringFamily.STRUCTURAL
    assert spring_strains(simulation.motion.x, simulation.model.springs)[structural].max() == pytest.approx(
        report.max_strain
    )
