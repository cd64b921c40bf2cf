"""Contact with a body: nothing passes through, nothing is pulled back, no energy appears; sheets come to rest on it."""

from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, crossings, placed, plain_fabric, sheet, throw
from naive_geometry import edge_edge_distance, point_triangle_distance
from scipy.spatial.transform import Rotation

from cloth_core.body import Body
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

OFFSET = 0.003
# Next to no springs: each particle flies for itself, and the time step is as long as a run ever takes, about 2 ms.
LOOSE = {"structural_warp": 1e-3, "structural_weft": 1e-3, "shear": 0.0, "bending": 0.0, "area_density": 1.0}


def quad(size: float = 4.0) -> Body:
    """One level square of two triangles at z = 0: as thin as a body can be."""
    corners = size / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return Body.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], "quad")


def ridge() -> Body:
    """A long prism whose upper edge is the x axis, and which is 90 degrees sharp."""
    turn = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    half = 0.2 / 2
    return body_of(trimesh.creation.box(extents=[4.0, 0.2, 0.2]), turn, [0.0, 0.0, -np.sqrt(2) * half])


def spike() -> Body:
    """A needle that stands on the plane z = -1 with its tip in the origin."""
    return body_of(trimesh.creation.cone(0.03, 1.0, sections=6), move=[0.0, 0.0, -1.0])


BODIES = {
    "quad": quad(),
    "sheet of 1 mm": body_of(trimesh.creation.box(extents=[4.0, 4.0, 0.001]), move=[0, 0, -0.0005]),
    "ball": body_of(trimesh.creation.icosphere(3, radius=0.1), move=[0.0, 0.0, -0.1]),
    "ridge": ridge(),
    "spike": spike(),
}


def flight(
    garment: Garment, body: Body | None, velocity: np.ndarray, seconds: float, *, time_step: float | None = None,
    **fabric: float,
) -> Iterator[Simulation]:  # fmt: skip
    """A sheet on its way without gravity and air; the simulation after each of its steps."""
    scene = Scene(
        garment=garment, body=body, fabric=plain_fabric(**(LOOSE | fabric)), air_drag=0.0, gravity=(0.0, 0.0, 0.0),
        settings=Settings(contact_offset=OFFSET, time_step=time_step),
    )  # fmt: skip
    simulation = Simulation(scene)
    throw(simulation, velocity)
    while simulation.time < seconds - 1e-9:
        simulation.advance(simulation.time_step)
        yield simulation


# ---- nothing passes through

STRAIGHT, SLANTING, GLANCING = (
    100 * np.array(v) / np.linalg.norm(v) for v in ([0, 0, -1.0], [1, 0.4, -1], [1, 0, -0.05])
)


@pytest.mark.parametrize("velocity", [STRAIGHT, SLANTING, GLANCING], ids=["straight", "slanting", "glancing"])
@pytest.mark.parametrize("name", ["quad", "sheet of 1 mm", "ball"])
def test_no_tunnelling_at_100_m_per_s_and_2_ms(name, velocity):
    # 20 cm in each step, against a body of nothing or a millimetre.
    body = BODIES[name]
    garment = placed(sheet(0.2, 0.2, 0.05), move=[*(-velocity[:2] * 0.05 / -velocity[2]), 0.05])
    steps = 0
    for simulation in flight(garment, body, velocity, 0.06):
        x = simulation.positions
        assert crossings(x, simulation.triangles, body) == 0
        if name == "ball":
            assert body.signed_distance(x).min() > 0
        else:
            assert x[np.abs(x).max(axis=1) < 2.0][:, 2].min(initial=1.0) > 0.0  # beside it they may fall past
        steps += 1
    assert simulation.time_step > 2e-3
    assert steps > 25


@pytest.mark.parametrize("speed", [1.0, 10.0, 100.0])
def test_impact_takes_the_approaching_velocity_and_nothing_else(speed):
    # Without friction, straight and slanting: only the normal part is lost. The cloth stops at the offset; when fast
    # up to a millimetre before it, where the last step would have brought it too near.
    for across in (0.0, 0.5):
        velocity = speed * np.array([across, 0.0, -1.0])
        *_, simulation = flight(placed(sheet(0.2, 0.2, 0.1), move=[0, 0, 0.02]), quad(400.0), velocity, 0.5)
        np.testing.assert_allclose(simulation.motion.v, np.tile([across * speed, 0.0, 0.0], (9, 1)), atol=1e-6 * speed)
        z = simulation.positions[:, 2]
        assert (z >= OFFSET * (1 - 1e-6)).all()
        assert (z <= OFFSET + 0.001).all()


@pytest.mark.parametrize("speed", [2.0, 40.0])
@pytest.mark.parametrize("turn", [0.0, 0.5, 45.0])
@pytest.mark.parametrize("name", ["ridge", "spike"])
def test_coarse_sheet_is_held_where_none_of_its_vertices_comes_near(name, turn, speed):
    # Two triangles of 0.6 m fall upon an edge (side against side) and upon a tip (triangle against corner).
    body = BODIES[name]
    garment = placed(sheet(0.6, 0.6, 0.6), Rotation.from_euler("z", turn, degrees=True).as_matrix(), [0.07, 0.05, 0.03])
    lowest = np.inf
    for simulation in flight(garment, body, np.array([0.0, 0.0, -speed]), 0.3 if speed < 10 else 0.05):
        assert crossings(simulation.positions, simulation.triangles, body) == 0
        lowest = min(lowest, simulation.positions[:, 2].min())
    x, triangles = simulation.sewn_mesh()
    if name == "spike":  # the tip itself
        distance = min(point_triangle_distance(np.zeros(3), *x[t]) for t in triangles) ** 0.5
    else:
        ends = body.vertices[np.abs(body.vertices[:, 2]) < 1e-9]
        sides = [(t[k], t[(k + 1) % 3]) for t in triangles for k in range(3)]
        distance = min(edge_edge_distance(x[i], x[j], *ends) for i, j in sides) ** 0.5
    assert 0.0 < distance < 0.1 if lowest < -0.05 else distance > 0.0


def test_resting_coarse_sheet_stays_off_edges_and_tips():
    # Three needles carry a sheet of two triangles; its corners hang in the air.
    tips = np.array([[0.15, 0.1, 0], [-0.15, 0.1, 0], [0.0, -0.2, 0]])
    needles = [trimesh.creation.cone(0.03, 1.0, sections=6).apply_translation(t - [0, 0, 1.0]) for t in tips]
    body = body_of(trimesh.util.concatenate(needles))
    scene = Scene(
        garment=sheet(0.8, 0.8, 0.8, z=0.01),
        body=body,
        fabric=plain_fabric(bending=1e-2, friction=0.4, damping_time=1e-3),
        settings=Settings(contact_offset=OFFSET), gravity=(0.0, 0.0, -GRAVITY),
    )  # fmt: skip
    simulation = Simulation(scene)
    for _ in range(20):
        simulation.advance(0.02)
        x, triangles = simulation.sewn_mesh()
        assert crossings(x, triangles, body) == 0
        nearest = min(point_triangle_distance(tip, *x[t]) for tip in tips for t in triangles) ** 0.5
        assert nearest > 0.4 * OFFSET
    assert x[:, 2].min() < -0.01  # it has come down on them


@pytest.mark.parametrize("seed", range(4))
def test_travel_bound_is_less_than_the_distance_to_anything(seed):
    # What makes tunnelling impossible: no particle may go as far as any part of the body from any part of the cloth
    # that moves with it. Distances by textbook formulas, all against all.
    rng = np.random.default_rng(seed)
    body = body_of(trimesh.creation.icosphere(1, radius=0.1), Rotation.random(random_state=seed).as_matrix())
    garment = placed(sheet(0.2, 0.2, 0.1), Rotation.random(random_state=seed + 10).as_matrix(), [0.0, 0.0, 0.16])
    x = garment.start + 0.01 * rng.standard_normal(garment.start.shape)
    contact = Contact(garment.triangles, BodyContact(body, OFFSET), radius=0.2)
    reach = 0.2
    travel = contact.search(x, reach).travel
    free = np.full(len(x), np.inf)
    for t in garment.triangles:
        for b in body.triangles:
            p, q = x[t], body.vertices[b]
            for k in range(3):
                free[t[k]] = min(free[t[k]], point_triangle_distance(p[k], *q))
                free[t] = np.minimum(free[t], point_triangle_distance(q[k], *p))
                for m in range(3):
                    side = t[[k, (k + 1) % 3]]
                    free[side] = np.minimum(free[side], edge_edge_distance(*x[side], q[m], q[(m + 1) % 3]))
    free = np.sqrt(free)
    assert free.min() < 0.1  # near enough to say something
    assert (travel > 0).all()
    assert (travel < free).all()
    assert (travel >= np.minimum(0.85 * free, 0.9 * reach) - 1e-12).all()  # and not much less


# ---- nothing is pulled back, nothing is given away


@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.parametrize("name", BODIES)
def test_contact_never_pulls_back_what_leaves(name, friction):
    garment = placed(sheet(0.2, 0.2, 0.05), move=[0.01, 0.02, OFFSET * 1.0001])
    rng = np.random.default_rng(1)
    velocity = np.column_stack([rng.uniform(-1, 1, 25), rng.uniform(-1, 1, 25), rng.uniform(0.3, 5.0, 25)])
    if name in ("ball", "spike"):
        velocity[:, :2] = 0.0  # straight up, so that nothing runs into the body sideways
    touching = flight(garment, BODIES[name], velocity, 0.02, time_step=1e-4, friction=friction)
    free = flight(garment, None, velocity, 0.02, time_step=1e-4)
    for with_body, alone in zip(touching, free, strict=True):
        np.testing.assert_allclose(with_body.positions, alone.positions, atol=1e-9)
        np.testing.assert_allclose(with_body.motion.v, alone.motion.v, atol=1e-9)


@pytest.mark.parametrize("speed", [0.0, 0.2, 0.7])
def test_too_near_is_pushed_out_and_never_held_back(speed):
    height = 0.0005
    previous = np.full(9, height)
    garment = placed(sheet(0.2, 0.2, 0.1), move=[0, 0, height])
    for simulation in flight(garment, quad(), np.array([0.0, 0.0, speed]), 0.1, time_step=1e-4):
        z = simulation.positions[:, 2]
        np.testing.assert_allclose(simulation.motion.v[:, 2], speed, atol=1e-6)  # it is not thrown
        # Springs between what was pushed farther and what less move particles against each other, but not all of them.
        way = speed * simulation.time_step
        assert (z - previous >= way * (1 - 1e-8)).all()
        assert np.average(z - previous, weights=simulation.model.mass) >= way * (1 - 1e-12)
        previous = z
    if speed == 0.0:
        np.testing.assert_allclose(z, OFFSET, rtol=0.01)


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("spacing", [0.05, 0.3], ids=["fine", "coarse"])
@pytest.mark.parametrize("name", BODIES)
def test_contact_never_adds_energy(name, spacing, friction):
    rng = np.random.default_rng(7)
    garment = placed(
        sheet(0.3, 0.3, spacing), Rotation.from_euler("xyz", [10, -7, 30], degrees=True).as_matrix(), [0, 0, 0.06]
    )
    velocity = np.array([0.3, -0.2, -3.0]) + 0.3 * rng.standard_normal((garment.particle_count, 3))
    energies = []
    for simulation in flight(garment, BODIES[name], velocity, 0.2, friction=friction):
        energies.append(float((simulation.model.mass[:, None] * simulation.motion.v**2).sum() / 2))
    first, last = energies[0], energies[-1]
    assert (np.diff(energies) <= 1e-6 * np.array(energies[:-1]) + 1e-8 * first).all()  # no more than rounding
    assert last < 0.99 * first  # there was an impact


@pytest.mark.parametrize("fabric", ["silk", "jersey", "denim"])
@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_cloth_that_glides_without_friction_keeps_its_way(speed, fabric):
    scene = Scene(
        garment=placed(sheet(0.2, 0.2, 0.025), move=[-1.0, 0, OFFSET]), body=quad(), air_drag=0.0,
        fabric=Fabric.preset(fabric, friction=0.0), settings=Settings(contact_offset=OFFSET),
    )  # fmt: skip
    simulation = Simulation(scene)
    throw(simulation, [speed, 0.0, 0.0])
    simulation.advance(0.5 / speed)
    way = (simulation.positions - scene.garment.start)[:, 0]
    np.testing.assert_allclose(way, 0.5, rtol=0.01)


# ---- rest


@pytest.mark.parametrize("radius", [0.06, 0.12])
def test_sheet_dropped_on_a_ball_comes_to_rest_at_the_offset(radius):
    ball = body_of(trimesh.creation.icosphere(3, radius=radius))
    scene = Scene(
        garment=sheet(0.25, 0.25, 0.02, z=radius + 0.01), body=ball, fabric=Fabric.preset("cotton_poplin"),
        settings=Settings(contact_offset=OFFSET),
    )  # fmt: skip
    simulation = Simulation(scene)
    report = simulation.settle()
    assert report.settled
    x, triangles = simulation.sewn_mesh()
    assert crossings(x, triangles, ball) == 0
    distance = ball.signed_distance(x)
    assert distance.min() == pytest.approx(OFFSET, rel=0.05)
    assert (distance < 1.05 * OFFSET).sum() >= 5  # it lies on it,
    assert x[:, 2].max() == pytest.approx(radius + OFFSET, abs=2e-3)
    assert x[:, 2].min() < radius - 0.05  # and hangs down
    still = simulation.positions
    simulation.advance(0.5)
    assert np.abs(simulation.positions - still).max() < 0.002


def test_sheet_on_a_level_plane_rests_exactly_and_weighs_what_it_weighs():
    # After landing nothing moves at all: contact has no stiffness that could ring.
    scene = Scene(
        garment=sheet(0.2, 0.2, 0.04, z=0.02), body=quad(), fabric=plain_fabric(friction=0.3, damping_time=1e-4),
        settings=Settings(contact_offset=OFFSET),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.advance(1.0)
    np.testing.assert_allclose(simulation.positions[:, 2], OFFSET, atol=1e-6)
    np.testing.assert_allclose(simulation.positions[:, :2], scene.garment.start[:, :2], atol=1e-6)
    assert np.abs(simulation.motion.v).max() < 1e-9


@pytest.mark.parametrize("name", ["ball", "ridge"])
def test_same_drop_twice_is_the_same_to_the_bit(name):
    def drop() -> tuple[str, int]:
        scene = Scene(
            garment=placed(sheet(0.3, 0.3, 0.03), move=[0.02, 0.01, 0.03]), body=BODIES[name],
            fabric=Fabric.preset("silk"), settings=Settings(contact_offset=OFFSET),
        )  # fmt: skip
        simulation = Simulation(scene)
        simulation.advance(0.3)
        return simulation.state_hash(), simulation.steps

    assert drop() == drop()
