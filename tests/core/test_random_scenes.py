"""Random valid scenes: finite whatever they are, nothing through the body, the same bits again, momentum kept."""

import numpy as np
import trimesh
from apparatus import body_of, crossings, do_steps, placed, sheet, throw
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cloth_core.fabric import Fabric
from cloth_core.model import Model
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

FEW = settings(
    max_examples=6, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow], database=None
)


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(np.log10(low), np.log10(high)).map(lambda e: float(10.0**e))


FABRICS = st.builds(
    Fabric,
    name=st.just("drawn"),
    area_density=powers(0.02, 2.0),
    structural_warp=powers(0.1, 1e4),
    structural_weft=powers(0.1, 1e4),
    shear=powers(0.01, 1e3),
    bending=powers(1e-7, 1e-3),
    bending_spring=st.sampled_from([0.0, 1.0, 50.0]),
    damping_time=powers(1e-6, 1e-2),
    bending_damping_time=powers(1e-5, 1e-1),
    friction=st.floats(0.0, 2.0),
    strain_limit=powers(0.01, 1.0),
)
SHEETS = st.tuples(st.integers(1, 4), st.integers(1, 4), st.floats(0.02, 0.06))
VELOCITIES = st.tuples(*[st.floats(-5.0, 5.0)] * 3)
TICKS = 10


def run(simulation: Simulation) -> Simulation:
    for _ in range(TICKS):
        simulation.tick()
        assert np.isfinite(simulation.positions).all()
        assert np.isfinite(simulation.motion.v).all()
    return simulation


def of_cells(size: tuple[int, int, float], z: float = 0.0):
    return sheet(size[0] * size[2], size[1] * size[2], size[2], z=z)


@FEW
@given(FABRICS, SHEETS, VELOCITIES, st.integers(0, 2), st.floats(0.0, 20.0))
def test_sheet_thrown_at_a_body_stays_finite_and_outside_and_does_so_again(fabric, size, velocity, shape, gravity):
    meshes = (
        trimesh.creation.icosphere(2, radius=0.1),
        trimesh.creation.box([0.2] * 3),
        trimesh.creation.cone(0.1, 0.2),
    )
    body = body_of(meshes[shape])
    scene = Scene(
        garment=of_cells(size, z=0.22), body=body, fabric=fabric, gravity=(0.0, 0.0, -gravity), settings=Settings()
    )

    def thrown() -> Simulation:
        simulation = Simulation(scene)
        throw(simulation, velocity)
        return run(simulation)

    one = thrown()
    assert crossings(one.motion.x, one.model.triangles, body) == 0
    assert one.state_hash() == thrown().state_hash()


@FEW
@given(FABRICS, SHEETS, st.integers(0, 2**31), st.floats(0.01, 0.5))
def test_forces_and_strain_limit_keep_the_momentum_of_any_sheet(fabric, size, seed, speed):
    model = Model(Scene(garment=of_cells(size), fabric=fabric, gravity=(0.0, 0.0, 0.0), air_drag=0.0))
    x = model.scene.garment.start.copy()
    v = speed * np.random.default_rng(seed).standard_normal(x.shape)
    mass = model.mass[:, None]
    before, scale = (mass * v).sum(axis=0), float((mass * np.abs(v)).sum())
    do_steps(x, v, model.force_terms(0.0), min(0.5 * model.stable_step(x, 0.0).time_step, 1e-3), 200)
    np.testing.assert_allclose((mass * v).sum(axis=0), before, rtol=0, atol=1e-9 * scale)


@FEW
@given(FABRICS, SHEETS, VELOCITIES, st.floats(-3.0, 3.0))
def test_moved_and_turned_scene_gives_the_moved_and_turned_result(fabric, size, move, angle):
    # A fall of a fiftieth of a second: longer, and rounding of what folds at random grows into something to be seen.
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    garment = of_cells(size)
    ends = []
    for here in (garment, placed(garment, turn, move)):
        corner = np.array([0], dtype=np.int32)
        simulation = Simulation(Scene(garment=here, fabric=fabric, pins=corner, settings=Settings(time_step=1e-6)))
        run(simulation)
        ends.append((simulation.time, simulation.positions))
    assert abs(ends[0][0] - ends[1][0]) < 1e-6
    np.testing.assert_allclose(ends[1][1], ends[0][1] @ turn.T + np.array(move), rtol=0, atol=1e-7)
