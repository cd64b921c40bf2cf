"""True bending: the energy of a cylinder, along warp and weft and across seams, and the cantilever's master curve."""

import math

import numpy as np
import pytest
from apparatus import bending_force, pattern, plain_fabric, rectangle, sheet
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.bending import Bending, build_bending, hinges
from cloth_core.garment import Garment

B = 2e-5  # N m


def energy(bending: Bending, x: np.ndarray) -> float:
    """The forces are linear in the positions, F = -K x: their energy is x K x / 2."""
    return float(-(x * bending_force(bending, x)).sum() / 2)


def cylinder(flat: np.ndarray, curvature: float, axis: float) -> np.ndarray:
    """A flat sheet (n, 2) rolled up without stretch; `axis` is the cylinder's direction in the sheet [rad]."""
    along = np.array([math.cos(axis), math.sin(axis)])
    across = np.array([-along[1], along[0]])
    u = flat @ across * curvature
    return np.column_stack([np.sin(u) / curvature, flat @ along, np.cos(u) / curvature])


def of_garment(garment: Garment, sewn: bool = False) -> Bending:
    number = garment.merged_indices if sewn else np.arange(garment.particle_count, dtype=np.int32)
    return build_bending(garment, plain_fabric(bending=B), number)


@pytest.mark.parametrize("spacing", [0.01, 0.005])
@pytest.mark.parametrize(("direction", "axis"), [("weft", math.pi / 2), ("warp", 0.0)])
def test_cylinder_has_its_bending_energy(direction, axis, spacing):
    # B kappa^2 / 2 per area, at any spacing; the half cells at the two straight ends have no neighbour to bend against.
    width, height, curvature = 0.1, 0.06, 8.0
    garment = sheet(width, height, spacing)
    found = energy(of_garment(garment), cylinder(garment.rest, curvature, axis))
    length = width if direction == "weft" else height
    area = width * height * (1 - spacing / length)
    assert found == pytest.approx(B * curvature**2 / 2 * area, rel=2e-3)


def disc(spacing: float) -> Garment:
    data = rectangle(0.2, 0.2)
    for edge in data["edges"]:
        edge["curvature"] = {"type": "circle", "params": [0.2 / math.sqrt(2), 0, 1]}
    return Garment.from_pattern(pattern({"disc": data}), spacing)


@pytest.mark.parametrize("axis", [0.0, math.pi / 2])
def test_panel_with_a_curved_outline_bends_nearly_like_the_grid(axis):
    # Its band is made of triangles in all directions; of the whole energy at most a quarter is missing or too much.
    garment = disc(0.01)
    found = energy(of_garment(garment), cylinder(garment.rest, 3.0, axis))
    assert found == pytest.approx(B * 9.0 / 2 * garment.areas.sum(), rel=0.25)


def two_halves(spacing: float) -> Garment:
    """Two rectangles side by side, sewn together along their upright edges; in one plane, 0.2 by 0.06 m."""
    panels = {"left": rectangle(0.1, 0.06, at=(-0.05, 0, 0)), "right": rectangle(0.1, 0.06, at=(0.05, 0, 0))}
    return Garment.from_pattern(pattern(panels, [(("left", 1), ("right", 3))]), spacing)


def laid_out(garment: Garment) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the sewn particles in the common plane (k, 2), and each unsewn particle's number."""
    plane = np.zeros((garment.merged_indices.max() + 1, 2))
    plane[garment.merged_indices] = garment.start[:, [0, 2]]
    return plane, garment.merged_indices


@pytest.mark.parametrize("spacing", [0.01, 0.005])
def test_cylinder_across_a_seam_bends_like_one_piece(spacing):
    garment = two_halves(spacing)
    plane, _ = laid_out(garment)
    one_piece = sheet(0.2, 0.06, spacing)
    for curvature in (2.0, 8.0):
        across = energy(of_garment(garment, sewn=True), cylinder(plane, curvature, math.pi / 2))
        whole = energy(of_garment(one_piece), cylinder(one_piece.rest, curvature, math.pi / 2))
        assert across == pytest.approx(whole, rel=5e-3)
        along = energy(of_garment(garment, sewn=True), cylinder(plane, curvature, 0.0))
        whole = energy(of_garment(one_piece), cylinder(one_piece.rest, curvature, 0.0))
        assert along == pytest.approx(whole, rel=5e-3)


def test_unsewn_halves_fold_freely():
    garment = two_halves(0.01)
    plane, number = laid_out(garment)
    folded = np.column_stack([np.abs(plane[:, 0]), plane[:, 1], np.zeros(len(plane))])  # right down on the left one
    assert energy(of_garment(garment), np.ascontiguousarray(folded[number])) == pytest.approx(0.0, abs=1e-15)
    # Sewn, each of the six sides of 1 cm is bent by 180 degrees, |K x| = 2 |e|.
    assert energy(of_garment(garment, sewn=True), folded) == pytest.approx(
        6 * B * (2 * 0.01) ** 2 / (2 * 0.0001), rel=1e-6
    )


def test_flat_sheet_anywhere_has_no_bending_force():
    for garment in (sheet(0.1, 0.06, 0.01), disc(0.02)):
        turned = cylinder(garment.rest, 1e-9, 0.4)
        turned = turned - turned.mean(axis=0)
        assert np.abs(bending_force(of_garment(garment), np.ascontiguousarray(turned))).max() < 1e-9


@pytest.mark.parametrize(
    "garment", [sheet(0.1, 0.06, 0.02), disc(0.03), two_halves(0.02)], ids=["sheet", "disc", "seam"]
)
def test_forces_push_nothing_as_a_whole(garment):
    bending = of_garment(garment, sewn=True)
    x = np.random.default_rng(4).standard_normal((garment.merged_indices.max() + 1, 3))
    force = bending_force(bending, x)
    assert np.abs(force).max() > 0.1
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10)
    np.testing.assert_allclose(np.cross(x, force).sum(axis=0), 0.0, atol=1e-9)
    # Damping acts on velocities as stiffness does on positions.
    v = np.random.default_rng(5).standard_normal(x.shape)
    np.testing.assert_allclose(bending_force(bending, x, v, 0.3) - force, 0.3 * bending_force(bending, v), atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.3, 3.0), st.floats(-0.8, 0.8), st.floats(0.2, 3.0), st.floats(0.2, 3.0))
def test_hinge_energy_is_that_of_its_angle(length, apex, one, other):
    # B |e| angle^2 / (h1 + h2) for a small angle, whatever the two triangles look like.
    angle = 0.01
    plane = np.array([[0, 0], [length, 0], [length * (0.5 + apex), one], [length * (0.5 - apex), -other]])
    x = np.column_stack([plane, np.zeros(4)])
    x[2, 1:] = one * math.cos(angle), one * math.sin(angle)
    triangles = np.array([[0, 1, 2], [1, 0, 3]], dtype=np.int32)
    garment = Garment(
        name="two", rest=plane, start=x, triangles=triangles, quads=np.zeros((0, 4), dtype=np.int32),
        in_quad=np.zeros(2, dtype=bool), rows=np.zeros((0, 3), dtype=np.int32),
        columns=np.zeros((0, 3), dtype=np.int32), panel_of_particle=np.zeros(4, dtype=np.int32),
        panel_of_triangle=np.zeros(2, dtype=np.int32), panel_names=("two",), panel_normals=np.array([[0.0, 0, 1]]),
        outline=(np.arange(4, dtype=np.int32),), seams=(), merged_indices=np.arange(4, dtype=np.int32), spacing=1.0,
    )  # fmt: skip
    assert energy(of_garment(garment), x) == pytest.approx(B * length * angle**2 / (one + other), rel=1e-3)


def test_hinges_join_two_triangles_and_never_three():
    # Three triangles at the side 0-1, and one more that shares 1-2 with the first.
    triangles = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [2, 1, 5]], dtype=np.int32)
    hinge, sides = hinges(triangles)
    assert {frozenset(s) for s in sides.tolist()} == {frozenset({0, 3})}
    assert set(hinge[0, :2].tolist()) == {1, 2}
    assert hinge[0, 2:].tolist() == [0, 5]
