"""Cloth against cloth in motion and at rest: impacts, stacks, friction, folds, and searches only where something moves.

Crossings are counted by another formula than the package's, or by its exact test.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import GRAVITY, body_of, crossings, pattern, placed, plain_fabric, rectangle, sheet, sides_through, throw
from scipy.spatial.transform import Rotation

from cloth_core.contact import Contact
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.intersections import self_crossing_edges
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

OFFSET = Settings().cloth_offset
BODY_OFFSET = Settings().contact_offset
# Next to no springs: each particle flies for itself, and kinetic energy is all that there is.
LOOSE = {"structural_warp": 1e-3, "structural_weft": 1e-3, "shear": 0.0, "bending": 0.0, "area_density": 1.0}
PLATE = body_of(trimesh.creation.box(extents=[1.0, 1.0, 0.1]), move=[0, 0, -0.05])


def joined(*sheets: Garment) -> Garment:
    return Garment.joined([replace(s, name=f"sheet {k}") for k, s in enumerate(sheets)])


def panel_crossings(simulation: Simulation) -> int:
    """Sides of each panel through each other one."""
    garment, x = simulation.scene.garment, simulation.positions
    parts = [garment.triangles[garment.panel_of_triangle == k] for k in range(len(garment.panel_names))]
    return sum(sides_through(x, a, x, b) for a in parts for b in parts if a is not b)


def of_panel(simulation: Simulation, k: int) -> np.ndarray:
    return np.asarray(simulation.positions[simulation.scene.garment.panel_of_particle == k])


def panel_mesh(simulation: Simulation, k: int) -> trimesh.Trimesh:
    garment = simulation.scene.garment
    return trimesh.Trimesh(simulation.positions, garment.triangles[garment.panel_of_triangle == k], process=False)


def distance_to_panel(simulation: Simulation, points: np.ndarray, k: int) -> np.ndarray:
    """By trimesh."""
    return np.asarray(trimesh.proximity.closest_point(panel_mesh(simulation, k), points)[1])


# ---- impacts

DIRECTIONS = {"straight": [0, 0, -1.0], "slanting": [1, 0.4, -1], "glancing": [1, 0, -0.2]}


def thrown(
    speed: float, direction: str, spacing: float, fabric: dict[str, float], upper: float = 0.16
) -> Iterator[Simulation]:
    """A sheet thrown upon another one that floats freely, until 1 cm after they met; the simulation after each tick."""
    velocity = speed * np.array(DIRECTIONS[direction]) / np.linalg.norm(DIRECTIONS[direction])
    lower = sheet(0.2, 0.2, 0.05)
    gap = 0.01
    way = [*(0.01 + velocity[:2] * gap / velocity[2]), gap]
    garment = joined(lower, placed(sheet(upper, upper, spacing), move=way))
    scene = Scene(garment=garment, fabric=plain_fabric(**fabric), air_drag=0.0, gravity=(0.0, 0.0, 0.0))
    simulation = Simulation(scene)
    throw(simulation, np.where(garment.panel_of_particle[:, None] == 1, velocity, 0.0))
    yield simulation
    while simulation.time < (gap + 0.01) / -velocity[2]:
        simulation.tick()
        yield simulation


@pytest.mark.parametrize(
    ("speed", "direction", "spacing"),
    [
        (1.0, "straight", 0.02), (10.0, "straight", 0.16), (50.0, "straight", 0.04), (10.0, "slanting", 0.02),
        (50.0, "slanting", 0.16), (50.0, "glancing", 0.04), (10.0, "glancing", 0.16),
    ],
)  # fmt: skip
@pytest.mark.parametrize("fabric", [LOOSE, {}], ids=["loose", "cloth"])
def test_thrown_sheets_do_not_pass_through_each_other(speed, direction, spacing, fabric):
    momenta, energies = [], []
    for simulation in thrown(speed, direction, spacing, fabric):
        assert panel_crossings(simulation) == 0
        mass, v = simulation.model.mass, simulation.motion.v
        momenta.append(mass @ v)
        energies.append(float(mass @ (v**2).sum(axis=1)) / 2)
    # Nothing but the two acts, and there is no friction.
    scale = float(np.abs(momenta[0]).max())
    np.testing.assert_allclose(momenta, np.broadcast_to(momenta[0], (len(momenta), 3)), atol=1e-12 * scale)
    # Not even in one go between two counts: what is under a particle of the upper sheet is the lower one.
    upper, up = of_panel(simulation, 1), np.array([0.0, 0.0, 1.0])
    lower = panel_mesh(simulation, 0)
    assert not lower.ray.intersects_any(upper, np.broadcast_to(up, upper.shape)).any()
    assert lower.ray.intersects_any(upper, np.broadcast_to(-up, upper.shape)).any()
    if fabric is LOOSE:
        assert (np.diff(energies) <= 1e-6 * energies[0]).all()  # springs of 1e-3 N/m are in it
    assert energies[-1] < energies[0] * (1 + 1e-9)


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_plastic_impact_of_equal_sheets_leaves_half_of_the_energy(speed):
    # Two lattices of the same shape, one straight upon the other: every particle meets its like.
    *_, simulation = thrown(speed, "straight", 0.05, LOOSE | {"area_density": 2.0}, upper=0.2)
    mass, v = simulation.model.mass, simulation.motion.v
    assert (mass @ (v**2).sum(axis=1)) / 2 == pytest.approx(0.5 * mass[25:].sum() * speed**2 / 2, rel=0.15)
    assert (mass @ v)[2] == pytest.approx(-mass[25:].sum() * speed, rel=1e-12)


def test_sheets_in_turmoil_between_each_other_never_cross():
    # Three sheets, each particle with a velocity of its own of some metres per second.
    rng = np.random.default_rng(3)
    sheets = [placed(sheet(0.15, 0.15, 0.03), move=[0.01 * k, 0.005 * k, 0.006 * k]) for k in range(3)]
    scene = Scene(
        garment=joined(*sheets), fabric=plain_fabric(damping_time=1e-4), air_drag=0.0, gravity=(0.0, 0.0, 0.0)
    )
    simulation = Simulation(scene)
    velocity = 4.0 * rng.normal(size=simulation.positions.shape)
    throw(simulation, velocity)
    while simulation.time < 0.06:
        simulation.tick()
        assert len(self_crossing_edges(*simulation.sewn_mesh())) == 0
        assert panel_crossings(simulation) == 0
    spread = np.abs(simulation.motion.v - simulation.motion.v.mean(axis=0)).mean()
    assert spread < 3.0  # they have met


# ---- stacks


def stack(heights: list[float], spacing: float) -> Garment:
    """Sheets over each other, each turned by 17 degrees against the one below and off its centre."""
    return joined(
        *(
            placed(
                sheet(0.24, 0.24, spacing), Rotation.from_euler("z", 17 * k, degrees=True).as_matrix(),
                (0.01 * k, 0.006 * k, z),
            )
            for k, z in enumerate(heights)
        )
    )  # fmt: skip


def test_three_sheets_on_a_plate_rest_in_order_an_offset_apart():
    scene = Scene(garment=stack([0.01, 0.02, 0.03], 0.04), body=PLATE, fabric=Fabric.preset("cotton_poplin"))
    simulation = Simulation(scene)
    report = simulation.settle(lambda s: panel_crossings(s) > 0)
    assert report.settled
    assert report.self_intersections == report.body_intersections == 0
    layers = [of_panel(simulation, k) for k in range(3)]
    tolerance = 0.02 * OFFSET
    np.testing.assert_allclose(layers[0][:, 2], BODY_OFFSET, atol=tolerance)
    for lower, upper in ((0, 1), (1, 2)):
        distance = distance_to_panel(simulation, layers[upper], lower)
        inside = np.linalg.norm(layers[upper][:, :2], axis=1) < 0.1
        assert inside.sum() > 10
        assert np.median(distance[inside]) == pytest.approx(OFFSET, abs=tolerance)
        assert distance[inside].max() < 1.2 * OFFSET
        assert (distance > OFFSET - tolerance).all()
        assert np.median(layers[upper][inside, 2]) == pytest.approx(BODY_OFFSET + upper * OFFSET, abs=2 * tolerance)


def test_two_sheets_on_a_ball_rest_in_order_without_crossing():
    ball = body_of(trimesh.creation.icosphere(3, radius=0.1))
    scene = Scene(garment=stack([0.11, 0.12], 0.03), body=ball, fabric=Fabric.preset("cotton_poplin"))
    simulation = Simulation(scene)
    report = simulation.settle(lambda s: panel_crossings(s) > 0)
    assert report.settled
    assert report.self_intersections == report.body_intersections == 0
    assert crossings(*simulation.sewn_mesh(), ball) == 0
    inner, outer = of_panel(simulation, 0), of_panel(simulation, 1)
    apart = distance_to_panel(simulation, outer, 0)
    assert apart.min() > 0.98 * OFFSET
    assert apart.min() < 2.0 * OFFSET
    # Seen from the middle of the ball the outer one is outside: from its particles a ray inwards meets the inner one.
    lower = panel_mesh(simulation, 0)
    top = outer[np.linalg.norm(outer[:, :2], axis=1) < 0.09]
    assert len(top) > 3
    assert lower.ray.intersects_any(top, -top).all()
    assert not lower.ray.intersects_any(top, top).any()
    assert ball.signed_distance(inner).min() > 0.98 * BODY_OFFSET


# ---- friction between layers

MU = 0.4


@pytest.mark.parametrize("steepness", [0.5, 0.95, 1.3, 2.0])
def test_sheet_on_a_held_sheet_sticks_or_slides_by_coulombs_law(steepness):
    angle = math.atan(steepness * MU)
    turn = Rotation.from_euler("y", angle).as_matrix()
    below = placed(sheet(0.8, 0.4, 0.05), move=[0.15, 0, 0])
    garment = placed(joined(below, placed(sheet(0.2, 0.2, 0.04), move=[-0.1, 0.007, OFFSET])), turn)
    scene = Scene(
        garment=garment, fabric=plain_fabric(friction=MU, damping_time=1e-4), air_drag=0.0,
        pins=np.flatnonzero(garment.panel_of_particle == 0).astype(np.int32),
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.advance(0.35)
    way = ((simulation.positions - garment.start) @ turn)[garment.panel_of_particle == 1]
    acceleration = max(GRAVITY * (math.sin(angle) - MU * math.cos(angle)), 0.0)
    np.testing.assert_allclose(way[:, 0], acceleration * 0.35**2 / 2, rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(way[:, 1:], 0.0, atol=1e-5)
    assert panel_crossings(simulation) == 0


# ---- folds


@pytest.mark.parametrize("fabric", ["silk", "denim"])
def test_strip_that_falls_onto_itself_never_crosses_itself(fabric):
    # It stands upright, leans a little, and buckles into folds on the plate.
    standing = {"strip": rectangle(0.1, 0.5, at=(0, 0.26, 0), turned=(3, 0, 0))}
    garment = Garment.from_pattern(pattern(standing), 0.025)
    simulation = Simulation(Scene(garment=garment, body=PLATE, fabric=Fabric.preset(fabric)))
    nearest = math.inf
    while simulation.time < 0.8:
        simulation.tick()
        x, triangles = simulation.sewn_mesh()
        assert len(self_crossing_edges(x, triangles)) == 0
        assert crossings(x, triangles, PLATE) == 0
        pairs = simulation.motion.contacts.pairs
        own = pairs.listed[: pairs.listed_count[0]]
        own = own[(pairs.body[own] < 0).all(axis=1)]
        nearest = min(nearest, float(pairs.gap[own[pairs.impulse[own] > 0]].min(initial=math.inf)))
    assert x[:, 2].max() < 0.3  # it has collapsed
    assert nearest < 1e-4  # upon itself


def test_strip_laid_over_an_edge_hangs_on_both_sides_against_itself():
    # A thin blade: the two halves hang 7 mm apart at their bodies' offset and must not pass through it or each other.
    blade = body_of(trimesh.creation.box(extents=[0.4, 0.001, 0.3]), move=[0, 0, -0.15])
    garment = placed(sheet(0.12, 0.4, 0.03), move=[0, 0.01, 0.01])
    simulation = Simulation(Scene(garment=garment, body=blade, fabric=Fabric.preset("silk", friction=1.0)))
    while simulation.time < 0.6:
        simulation.tick()
        x, triangles = simulation.sewn_mesh()
        assert len(self_crossing_edges(x, triangles)) == 0
        assert crossings(x, triangles, blade) == 0
    assert x[:, 2].min() < -0.1


# ---- searches


def dropped(seconds: float) -> Simulation:
    # Leather with springs along its diagonals does not buckle at the impact: what limp cloth does then hangs on the
    # last bit.
    leather = Fabric.preset("leather", shear=0.0, shear_spring=600.0)
    scene = Scene(garment=stack([0.03, 0.045], 0.03), body=PLATE, fabric=leather)
    simulation = Simulation(scene)
    simulation.advance(seconds)
    return simulation


def test_candidates_are_kept_while_they_hold():
    scene = Scene(garment=stack([0.09, 0.1], 0.03), body=PLATE, fabric=Fabric.preset("cotton_poplin"))
    simulation = Simulation(scene)
    contact = simulation.model.contact
    assert contact is not None
    before = contact.broad.searches, contact.narrow_phases, simulation.steps
    simulation.advance(0.15)
    moving = np.subtract((contact.broad.searches, contact.narrow_phases, simulation.steps), before)
    assert 0 < moving[0] < moving[1] < moving[2]
    # A fall of 10 cm, over radii of which half may be used up before it is worth searching anew.
    assert moving[0] <= 2 * 0.1 / (0.5 * contact.broad.radius)
    assert simulation.settle().settled
    before = contact.broad.searches, contact.narrow_phases
    simulation.advance(0.3)
    assert (contact.broad.searches, contact.narrow_phases) == before  # nothing at all at rest


def test_run_does_not_depend_on_when_candidates_were_searched(monkeypatch):
    # Not to the bit: how far particles may go between two searches depends on what is left of the radius, and from
    # that follow the lengths of the steps before an impact. What comes to rest is the same but for a fraction of a
    # step.
    kept = dropped(0.4)
    search = Contact.search

    def anew(self, x, reach):
        self.forget()
        return search(self, x, reach)

    monkeypatch.setattr(Contact, "search", anew)
    forced = dropped(0.4)
    assert forced.model.contact is not None
    assert kept.model.contact is not None
    assert forced.model.contact.broad.searches == forced.model.contact.narrow_phases
    assert kept.model.contact.broad.searches < kept.model.contact.narrow_phases
    step = math.sqrt(2 * 9.81 * 0.045) * kept.time_step
    assert step < 0.25 * OFFSET
    np.testing.assert_allclose(kept.positions, forced.positions, atol=0.1 * step)


def test_the_same_drop_twice_is_the_same_to_the_bit():
    assert dropped(0.12).state_hash() == dropped(0.12).state_hash()
