"""Implicit steps: against closed forms, against symplectic Euler, and at stiffnesses that it needs tiny steps for."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, bending_force, body_of, crossings, pattern, plain_fabric, rectangle, sheet, throw
from numpy.typing import NDArray

from cloth_core.errors import SceneError
from cloth_core.grasp import Pose
from cloth_core.implicit_matrix import assemble
from cloth_core.intersections import self_crossing_edges
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.step import Workspace, total_force

Floats = NDArray[np.float64]
DT = 1.0 / 60.0


def _scene(garment: Any = None, **given: Any) -> Scene:
    """A sheet of 0.5 m by itself, implicit steps of 1/60 s; fabric changes as `fabric`."""
    garment = sheet(0.5, 0.5, 0.1) if garment is None else garment
    values: dict[str, Any] = {
        "fabric": plain_fabric(**given.pop("fabric", {})),
        "air_drag": 0.0,
        "without": ("self contact", "strain limit"),
        "settings": Settings(spacing=0.1, integrator="implicit", time_step=given.pop("time_step", DT)),
    }
    return Scene(garment=garment, **(values | given))


def _corners(garment: Any) -> NDArray[np.int32]:
    """The two corners of the upper edge."""
    x = garment.start
    upper = np.flatnonzero(x[:, 1] > x[:, 1].max() - 1e-9)
    return upper[[np.argmin(x[upper, 0]), np.argmax(x[upper, 0])]].astype(np.int32)


def _energy(simulation: Simulation) -> float:
    """Of motion, height, springs and bending [J]."""
    model, x, v = simulation.model, simulation.motion.x, simulation.motion.v
    springs = model.springs
    length = np.linalg.norm(x[springs.pairs[:, 0]] - x[springs.pairs[:, 1]], axis=1)
    stretched = 0.5 * float((springs.stiffness * (length - springs.rest_length) ** 2).sum())
    bent = -0.5 * float((bending_force(model.bending, x) * x).sum())
    moving = 0.5 * float((model.mass[:, None] * v**2).sum())
    return moving + stretched + bent + GRAVITY * float((model.mass * x[:, 2]).sum())


def _oscillator(cycles: float) -> tuple[Simulation, float]:
    """A cell, one side of it held, that swings along x with frequency w [rad/s], and w; w dt = cycles."""
    garment = sheet(0.1, 0.1, 0.1)
    held = np.flatnonzero(garment.start[:, 0] < 0.0).astype(np.int32)
    scene = _scene(garment, fabric={"shear": 0.0, "bending": 0.0}, gravity=(0.0, 0.0, 0.0), pins=held)
    model = Simulation(scene).model
    free = int(np.flatnonzero(model.inverse_mass > 0.0)[0])
    across = np.ptp(garment.start[model.springs.pairs][:, :, 0], axis=1) > 0.05
    level = across & (np.ptp(garment.start[model.springs.pairs][:, :, 1], axis=1) < 0.01)
    stiffness = model.springs.stiffness[level & (model.springs.pairs == free).any(axis=1)]
    assert len(stiffness) == 1
    w = math.sqrt(float(stiffness[0]) / model.mass[free])
    return Simulation(replace(scene, settings=replace(scene.settings, time_step=cycles / w))), w


@pytest.mark.parametrize("cycles", [0.05, 0.3, 3.0])
def test_first_step_is_implicit_eulers_closed_form(cycles: float) -> None:
    """x'' = -w^2 x: x1 = x0 / (1 + w^2 dt^2) from rest."""
    simulation, w = _oscillator(cycles)
    free = simulation.model.inverse_mass > 0.0
    before = simulation.motion.x.copy()
    simulation.motion.x[free, 0] += 1e-3
    simulation.motion.run(1)
    np.testing.assert_allclose((simulation.motion.x - before)[free, 0], 1e-3 / (1.0 + cycles**2), rtol=1e-6)
    amplitude = np.hypot((simulation.motion.x - before)[free, 0], simulation.motion.v[free, 0] / w)
    np.testing.assert_allclose(amplitude, 1e-3 / math.sqrt(1.0 + cycles**2), rtol=1e-6)


@pytest.mark.parametrize("cycles", [0.05, 0.3, 3.0])
def test_swing_is_damped_like_the_second_order_difference(cycles: float) -> None:
    """y' = l y, l = i w: (3/2 - z) r^2 - 2 r + 1/2 = 0 for the factor r of a step, z = l dt."""
    simulation, w = _oscillator(cycles)
    free = simulation.model.inverse_mass > 0.0
    before = simulation.motion.x.copy()
    simulation.motion.x[free, 0] += 1e-3

    # The same scheme on one complex number y = x + i v / w, for which y' = -i w y.
    z = -1j * cycles
    expected = [1e-3 + 0j, 1e-3 / (1.0 - z)]
    for _ in range(20):
        expected.append((2.0 * expected[-1] - 0.5 * expected[-2]) / (1.5 - z))
    seen = []
    for _ in range(21):
        simulation.motion.run(1)
        seen.append((simulation.motion.x - before)[free, 0][0] + 1j * simulation.motion.v[free, 0][0] / w)
    np.testing.assert_allclose(seen, expected[1:], atol=2e-9)
    principal = (2.0 + np.sqrt(1.0 + 2.0 * z)) / (3.0 - 2.0 * z)
    if cycles < 1.0:  # then the other root has died away
        assert seen[-1] / seen[-2] == pytest.approx(principal, rel=1e-3)


def test_matrix_is_the_derivative_of_the_forces() -> None:
    """M + h D + h^2 K by central differences of the forces, where no spring is compressed."""
    fabric = {"damping_time": 1e-3, "bending_damping_time": 2e-3, "bending": 1e-2}
    simulation = Simulation(_scene(fabric=fabric, air_drag=2.0, pins=_corners(sheet(0.5, 0.5, 0.1))))
    model, terms, h = simulation.model, simulation.motion.terms, 0.01
    x, n = 1.05 * simulation.motion.x, len(simulation.motion.x)
    x[:, 2] = 0.1 * np.sin(7.0 * x[:, 0])
    assert simulation.motion.implicit is not None
    matrix = simulation.motion.implicit.matrix
    assemble(matrix, x, terms, h)
    factors = matrix.factors
    found = np.zeros((n, 3, n, 3))
    for axis in range(3):
        for i in range(n):
            at = factors.diagonal[i] + axis * factors.diagonal_stride[i]
            found[i, :, i, axis] = factors.values[at : at + 3]
        for k, (i, j) in enumerate(matrix.links):
            at = factors.off_diagonal[k] + axis * factors.off_diagonal_stride[k]
            # The rows of a block belong to the particle that is eliminated later.
            row, column = (i, j) if factors.place[i] > factors.place[j] else (j, i)
            found[row, :, column, axis] = found[column, axis, row, :] = factors.values[at : at + 3]

    work, v = Workspace.of(n), np.zeros((n, 3))

    def force(dx: Floats, dv: Floats) -> Floats:
        total_force(x + dx, v + dv, terms, 0.0, work)
        return work.force[:, :n].T.copy()

    free = model.inverse_mass > 0.0
    expected = np.zeros((n, 3, n, 3))
    for i in range(n):
        for axis in range(3):
            expected[i, axis, i, axis] = model.mass[i] if free[i] else 1.0
            if not free[i]:
                continue
            e = np.zeros((n, 3))
            e[i, axis] = 1e-6
            k = (force(e, v) - force(-e, v)) / 2e-6
            d = (force(v, e) - force(v, -e)) / 2e-6
            expected[free, :, i, axis] -= (h * h * k + h * d)[free]
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_free_flight_keeps_momentum_and_shape() -> None:
    simulation = Simulation(_scene())
    throw(simulation, (0.4, -0.3, 2.0))
    simulation.motion.x[:, 0] *= 1.02  # and it rings
    start, momentum = simulation.motion.x.copy(), simulation.model.mass @ simulation.motion.v
    simulation.advance(0.5)
    mass = simulation.model.mass
    expected = momentum - np.array([0.0, 0.0, GRAVITY * 0.5 * mass.sum()])
    np.testing.assert_allclose(mass @ simulation.motion.v, expected, atol=1e-6 * np.abs(expected).max())
    middle = (mass @ simulation.motion.x - mass @ start) / mass.sum()
    # Both formulas are exact for a constant force but for the first step, of first order: g dt^2 / 2 too low.
    np.testing.assert_allclose(middle[:2], [0.2, -0.15], atol=1e-6)
    assert middle[2] == pytest.approx(2.0 * 0.5 - GRAVITY * 0.125, abs=GRAVITY * DT**2)


def test_terminal_speed_in_air() -> None:
    simulation = Simulation(_scene(air_drag=8.0, time_step=0.1))
    simulation.advance(5.0)
    np.testing.assert_allclose(
        simulation.motion.v, np.broadcast_to([0, 0, -GRAVITY / 8.0], simulation.motion.v.shape), atol=1e-9
    )


def test_second_order_halves_of_a_step_quarter_the_error() -> None:
    garment = sheet(0.5, 0.5, 0.125)

    def at(**settings: Any) -> Floats:
        scene = _scene(garment, pins=_corners(garment), air_drag=1.0, fabric={"structural_warp": 100.0})
        simulation = Simulation(replace(scene, settings=Settings(spacing=0.125, **settings)))
        simulation.advance(0.2)
        return simulation.positions

    reference = at(safety=0.02)
    errors = [
        float(np.sqrt(((at(integrator="implicit", time_step=dt) - reference) ** 2).mean()))
        for dt in (1 / 120, 1 / 240, 1 / 480)
    ]
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0


@pytest.mark.parametrize("stiffness", [1e3, 1e6])
def test_hung_sheet_comes_to_the_rest_of_symplectic_euler(stiffness: float) -> None:
    garment = sheet(0.5, 0.5, 0.125)
    fabric = plain_fabric(structural_warp=stiffness, structural_weft=stiffness, damping_time=1e-5, bending=1e-2)
    rests = []
    # Firm enough to hang flat: a limp one has several rests.
    plain = Settings(spacing=0.125, rest_displacement=5e-5)
    for settings in (plain, replace(plain, integrator="implicit")):
        scene = Scene(garment, fabric, pins=_corners(garment), settings=settings)
        simulation = Simulation(scene)
        report = simulation.settle()
        assert report.settled
        assert report.self_intersections == 0
        rests.append(simulation.positions)
    # Both end where no particle moves more than 0.05 mm in 0.1 s.
    assert np.abs(rests[0] - rests[1]).max() < 5e-4


def test_hanging_chain_of_sheets_stretches_by_its_weight() -> None:
    """Total extension of N masses, N (N + 1) m g / (2 k), of a strip two particles wide without shear."""
    garment = sheet(0.1, 0.6, 0.1)
    x = garment.start.copy()
    x[:, [1, 2]] = np.stack([np.zeros(len(x)), x[:, 1]], axis=1)  # it hangs
    garment = replace(garment, start=x)
    top = np.flatnonzero(x[:, 2] > x[:, 2].max() - 1e-9).astype(np.int32)
    scene = _scene(garment, fabric={"shear": 0.0, "bending": 0.0, "damping_time": 0.01}, pins=top, air_drag=5.0)
    simulation = Simulation(scene)
    simulation.advance(20.0)
    model = simulation.model
    column = np.flatnonzero(np.abs(x[:, 0] - x[:, 0].min()) < 1e-9)
    column = column[np.argsort(-x[column, 2])]
    weights = GRAVITY * model.mass[column]
    link = [
        model.springs.stiffness[(model.springs.pairs == np.sort([i, j])).all(axis=1)][0] for i, j in pairwise(column)
    ]
    expected = sum(weights[k + 1 :].sum() / link[k] for k in range(len(link)))
    extension = x[column[-1], 2] - simulation.motion.x[column[-1], 2]
    assert extension == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e8])
def test_stiff_sheet_stays_bounded_with_steps_of_a_sixtieth_of_a_second(stiffness: float) -> None:
    garment = sheet(0.5, 0.5, 0.0625)
    scene = _scene(garment, pins=_corners(garment), fabric={"structural_warp": stiffness, "structural_weft": stiffness})
    simulation = Simulation(scene)
    start = _energy(simulation)
    height = float(np.ptp(garment.start[:, 1])) * float(simulation.model.mass.sum()) * GRAVITY
    assert simulation.stable.time_step < 0.1 * DT
    for _ in range(30):
        simulation.advance(DT)
        # Falling gives at most the weight times the height; no step adds to what there was at the start.
        assert np.isfinite(simulation.motion.x).all()
        assert _energy(simulation) < start + 0.02 * height
    simulation.advance(1.5)
    assert _energy(simulation) < start  # what rings is damped, without any damping in the fabric or air


def test_two_runs_are_equal_to_the_bit_and_pins_stay() -> None:
    garment = sheet(0.5, 0.5, 0.1)
    runs = [Simulation(_scene(garment, pins=_corners(garment))) for _ in range(2)]
    for simulation in runs:
        simulation.advance(0.5)
    assert runs[0].state_hash() == runs[1].state_hash()
    pins = _corners(garment)
    np.testing.assert_array_equal(runs[0].positions[pins], garment.start[pins])


def test_gripper_takes_the_sheet_along() -> None:
    garment = sheet(0.5, 0.5, 0.1)
    scene = _scene(garment, pins=_corners(garment)[:1], fabric={"structural_warp": 1e6}, without=("self contact",))
    simulation = Simulation(scene)
    held = _corners(garment)[1:]
    assert simulation.grasp("hand", held, Pose.of(garment.start[held[0]])) == 1
    goal = garment.start[held[0]] + [0.0, -0.2, 0.1]
    simulation.move_grasp("hand", Pose.of(goal))
    simulation.advance(1.0)
    np.testing.assert_allclose(simulation.positions[held[0]], goal, atol=1e-9)
    simulation.release("hand")
    simulation.advance(0.3)
    assert simulation.positions[held[0], 2] < goal[2] - 0.1


def test_strain_limit_holds_a_soft_sheet() -> None:
    garment = sheet(0.5, 0.5, 0.1)
    scene = _scene(
        garment, pins=_corners(garment), without=("self contact",), air_drag=5.0, time_step=1 / 120,
        fabric={"structural_warp": 10.0, "structural_weft": 10.0, "strain_limit": 0.05},
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.advance(4.0)
    assert simulation.report().max_strain < 0.06
    free = Simulation(replace(scene, without=("self contact", "strain limit")))
    free.advance(4.0)
    assert free.report().max_strain > 0.1


@pytest.mark.parametrize("stiffness", [1e3, 1e7])
def test_nothing_crosses_a_ball_or_itself(stiffness: float) -> None:
    garment = sheet(0.6, 0.6, 0.06, z=0.05)
    ball = body_of(trimesh.creation.icosphere(subdivisions=2, radius=0.15), move=(0.0, 0.0, -0.16))
    fabric = {"structural_warp": stiffness, "structural_weft": stiffness, "friction": 0.4}
    scene = _scene(garment, body=ball, fabric=fabric, without=(), time_step=1 / 120)
    simulation = Simulation(scene)
    for _ in range(6):
        simulation.advance(0.1)
        x, triangles = simulation.sewn_mesh()
        assert crossings(x, triangles, ball) == 0
        assert len(self_crossing_edges(x, triangles)) == 0
    # It lies on the ball, whose top is at -10 mm, and hangs down around it.
    assert -0.01 < x[:, 2].max() < 0.02
    assert x[:, 2].min() < -0.1


def test_garment_with_open_seams_is_refused_in_one_line() -> None:
    sewn = pattern(
        {"a": rectangle(0.2, 0.2, at=(0, 0, 0.1)), "b": rectangle(0.2, 0.2, at=(0, 0, -0.1))},
        [(("a", 1), ("b", 1))],
    )
    scene = Scene.build([sewn], settings=Settings(spacing=0.05, integrator="implicit"))
    with pytest.raises(SceneError, match="integrator 'implicit': it sews no seams") as error:
        Simulation(scene)
    assert "\n" not in str(error.value)
    Simulation(replace(scene, without=("seams",)))


def test_unknown_integrator_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(SceneError, match="'leapfrog' is not known; use one of symplectic, implicit"):
        Settings(integrator="leapfrog")


def test_step_of_a_second_is_finite() -> None:
    garment = sheet(0.5, 0.5, 0.1)
    simulation = Simulation(_scene(garment, pins=_corners(garment), time_step=1.0))
    simulation.advance(60.0)
    assert np.isfinite(simulation.motion.x).all()
    # So long steps damp every swing: it hangs.
    assert simulation.progress.largest_speed < 1e-2


def test_stiff_sheet_comes_to_rest_on_a_ball_with_friction() -> None:
    garment = sheet(0.6, 0.6, 0.06, z=0.01)
    ball = body_of(trimesh.creation.icosphere(subdivisions=2, radius=0.15), move=(0.0, 0.0, -0.16))
    fabric = plain_fabric(structural_warp=1e6, structural_weft=1e6, friction=0.4, damping_time=1e-5)
    scene = Scene(garment, fabric, body=ball, settings=Settings(spacing=0.06, integrator="implicit", max_time=5.0))
    simulation = Simulation(scene)
    report = simulation.settle()
    assert report.settled
    assert crossings(*simulation.sewn_mesh(), ball) == report.self_intersections == 0
    # All of its weight at once on one row would stretch it by 1.2e-5.
    assert report.max_strain < 1e-3
    # Where it lies it stays: nothing creeps over the ball when the drape goes on as motion.
    before = simulation.positions
    simulation.advance(0.5)
    assert np.abs(simulation.positions - before).max() < 2e-3
