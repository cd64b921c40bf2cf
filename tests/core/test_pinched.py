"""What nearly touches: kept on its own side however hard and long it is pressed, free to leave and to slide.

Whether anything has passed through is decided by libigl's exact orientation.
"""

from collections.abc import Iterator

import igl.predicates
import numpy as np
import pytest
import trimesh
from apparatus import body_of, crossings, keep_within_travel, placed, sheet
from naive_geometry import edge_edge_distance, point_triangle_distance
from scipy.spatial.transform import Rotation

from cloth_core.body import Body
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.contact_state import ContactState
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_edges
from cloth_core.near_planes import NEAR
from cloth_core.pair_contacts import BODY_SIDE, BODY_VERTEX, CLOTH_SIDE, CLOTH_VERTEX, PairContacts
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.self_contact import SelfContact
from cloth_core.simulation import Simulation
from cloth_core.travel_renewal import renew_spent

TWO = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)


def nearly_touching(rng: np.random.Generator, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Two triangles of 20 cm so far apart, anywhere within 1 m; and the direction from the second to the first."""
    noise = 0.01 * rng.normal(size=(2, 3, 3))
    if rng.uniform() < 0.5:  # a tip upon a face
        one = np.array([[0, 0, 0], [0.1, 0.05, 0.15], [-0.1, 0.07, 0.12]]) + noise[0]
        other = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0, 0.15, 0]]) + noise[1] * [1, 1, 0]
        one[0, 2] = 0.0
    else:  # side across side
        one = np.array([[-0.1, 0, 0], [0.1, 0, 0], [0, 0.03, 0.15]]) + noise[0]
        other = np.array([[0, -0.1, 0], [0, 0.1, 0], [0.03, 0, -0.15]]) + noise[1]
        one[:2, 2] = other[:2, 2] = 0.0
    one[:, 2] += distance
    turn = Rotation.random(random_state=rng).as_matrix()
    return np.concatenate([one, other]) @ turn.T + rng.uniform(-1, 1, 3), turn[:, 2]


def apart(x: np.ndarray) -> float:
    """Distance of triangles 0 1 2 and 3 4 5."""
    one, other = x[:3], x[3:]
    vertices = [point_triangle_distance(p, *t) for a, t in ((one, other), (other, one)) for p in a]
    sides = [edge_edge_distance(one[i], one[i - 1], other[j], other[j - 1]) for i in range(3) for j in range(3)]
    return float(np.sqrt(min(vertices + sides)))


def side_of(a: np.ndarray, b: np.ndarray, c: np.ndarray, p: np.ndarray) -> int:
    return int(igl.predicates.orient3d(*(np.ascontiguousarray(q[None]) for q in (a, b, c, p)))[0])


def cross(x: np.ndarray) -> bool:
    """Whether a side of one triangle passes through the other one, exactly."""
    for one, other in ((x[:3], x[3:]), (x[3:], x[:3])):
        for k in range(3):
            p, q = one[k], one[k - 1]
            ends = side_of(*other, p) * side_of(*other, q)
            around = {side_of(p, q, other[i], other[i - 1]) for i in range(3)}
            if ends < 0 and not {1, -1} <= around:
                return True
    return False


def search_of(body: bool, x: np.ndarray) -> Contact:
    """Both triangles cloth, or the second one a body."""
    if body:
        obstacle = Body.from_arrays(x[3:], [[0, 1, 2]], "triangle")
        return Contact(TWO[:1], BodyContact(obstacle, 0.003), radius=0.006)
    return Contact(TWO, None, SelfContact(TWO, np.arange(6), np.full(6, np.inf), 0.001), radius=0.006)


def renewable(found: ContactState) -> ContactState:
    wanted = found.renewal._replace(steps=30.0, least_reach=0.002, least_room=1e-4, allowed=True)
    return found._replace(renewal=wanted)


@pytest.mark.parametrize("renewed", [False, True], ids=["searched", "renewed"])
@pytest.mark.parametrize("body", [False, True], ids=["cloth", "body"])
@pytest.mark.parametrize("distance", [1e-3, 1e-5, 1.1e-6, 1e-7, 1e-8])
def test_pressing_never_brings_two_triangles_through_each_other(distance, body, renewed):
    rng = np.random.default_rng(1)
    renewals = 0
    for _ in range(4):
        x, _ = nearly_touching(rng, distance)
        contact = search_of(body, x)
        movable = 3 if body else 6
        y, nearest = x[:movable].copy(), np.inf
        middle = x.reshape(2, 3, 3).mean(axis=1)
        found = renewable(contact.search(y, 0.006))
        for _ in range(40):
            towards = np.repeat(middle[::-1] - middle, 3, axis=0)[:movable]
            y += 0.05 * towards + 1e-3 * rng.normal(size=y.shape)
            v, moved = np.zeros_like(y), np.zeros(movable)
            keep_within_travel(y, v, found, moved)
            if renewed and renew_spent(y, v, found, x[3:], np.array([[0, 1, 2]], dtype=np.int32), moved, 1e-4):
                renewals += 1
            else:
                found = renewable(contact.search(y, 0.006))
            both = np.concatenate([y, x[movable:]])
            assert not cross(both)
            nearest = min(nearest, apart(both))
        assert nearest > 0.4 * min(distance, 1e-6)  # it gets no nearer than that, however often it is pressed
    assert (renewals > 20) == renewed


@pytest.mark.parametrize("body", [False, True], ids=["cloth", "body"])
@pytest.mark.parametrize("distance", [1e-5, 1e-6, 1e-7])
def test_what_nearly_touches_may_leave_and_slide(distance, body):
    rng = np.random.default_rng(2)
    for _ in range(8):
        x, normal = nearly_touching(rng, distance)
        along = np.cross(normal, [0.6, 0.0, 0.8])
        for way in (0.002 * normal, 0.002 * along / np.linalg.norm(along), 0.001 * normal + 0.002 * along):
            y = x[: 3 if body else 6].copy()
            found = search_of(body, x).search(y, 0.006)
            start = y.copy()
            y[:3] += way
            v = np.zeros_like(y)
            v[:3] = way
            keep_within_travel(y, v, found, np.zeros(len(y)))
            np.testing.assert_allclose(y[:3] - start[:3], np.broadcast_to(way, (3, 3)), atol=1e-5)
            np.testing.assert_allclose(v[:3], np.broadcast_to(way, (3, 3)), atol=1e-5)


# ---- whole sheets


def layers(count: int) -> Garment:
    return Garment.joined(
        [placed(sheet(0.2, 0.2, 0.04), move=(0.007 * k, 0.004 * k, 0.004 + 0.0015 * k)) for k in range(count)]
    )


def pressed(simulation: Simulation, seconds: float) -> Iterator[float]:
    """Least distance of what is near, after each tick; nothing crosses."""
    end = simulation.time + seconds
    while simulation.time < end:
        simulation.tick()
        x, triangles = simulation.sewn_mesh()
        assert len(self_crossing_edges(x, triangles)) == 0
        assert simulation.scene.body is not None
        assert crossings(x, triangles, simulation.scene.body) == 0
        yield nearest_of(x, simulation.motion.contacts.pairs, simulation.scene.body)


def nearest_of(x: np.ndarray, pairs: PairContacts, body: Body) -> float:
    """Least distance of the pairs on the list, by textbook formulas."""
    listed = pairs.listed[: pairs.listed_count[0]]
    kind = pairs.kind[listed]
    p, b = x[pairs.particles[listed]].transpose(1, 0, 2), body.vertices[pairs.body[listed]].transpose(1, 0, 2)
    squared = np.select(
        [kind == BODY_SIDE, kind == BODY_VERTEX, kind == CLOTH_VERTEX, kind == CLOTH_SIDE],
        [
            edge_edge_distance(p[0], p[1], b[0], b[1]),
            point_triangle_distance(b[0], p[0], p[1], p[2]),
            point_triangle_distance(*p),
            edge_edge_distance(*p),
        ],
    )
    return float(np.sqrt(squared.min(initial=1.0)))


def test_three_layers_pressed_on_a_plate_by_ten_thousand_times_their_weight():
    plate = body_of(trimesh.creation.box(extents=[1, 1, 0.1]), move=[0, 0, -0.05])
    scene = Scene(garment=layers(3), body=plate, fabric=Fabric.preset("cotton_poplin"), gravity=(0.0, 0.0, -1e5))
    least = min(pressed(Simulation(scene), 0.1))
    # Pressed to where planes keep it apart: the contacts alone would have let it through.
    assert 0.5e-6 < least < NEAR


@pytest.mark.parametrize("leave", [0.006, 0.004])
def test_three_layers_between_jaws_that_close_farther_than_there_is_room(leave):
    # Offsets add up to 8 mm.
    lower = trimesh.creation.box(extents=[0.1, 0.1, 0.1]).apply_translation([0, 0, -0.05])
    upper = trimesh.creation.icosphere(2, radius=0.05).apply_translation([0, 0, 0.07])
    jaws = body_of(trimesh.util.concatenate([lower, upper]))
    scene = Scene(garment=layers(3), body=jaws, fabric=Fabric.preset("cotton_poplin"), settings=Settings())
    simulation = Simulation(scene)
    closed = jaws.vertices.copy()
    closed[closed[:, 2] > 0.01, 2] -= 0.02 - leave
    simulation.move_body(closed, 0.1)
    assert min(pressed(simulation, 0.25)) > 0.5e-6
    # They open again, and the layers come apart.
    assert simulation.scene.body is not None
    opened = simulation.scene.body.vertices.copy()
    opened[len(lower.vertices) :, 2] += 0.05
    simulation.move_body(opened, 0.1)
    *_, last = pressed(simulation, 0.3)
    assert last > 0.9e-3
    assert not simulation.body_moves
    np.testing.assert_array_equal(simulation.scene.body.vertices, opened)
