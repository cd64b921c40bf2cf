"""The three spring families: how many, which, how stiff; what a sheet of them weighs in as; Hooke's law."""

import math

import numpy as np
import pytest
from apparatus import pattern, plain_fabric, rectangle, sheet, spring_force

from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.springs import SpringFamily, Springs, build_springs, spring_strains

STRUCTURAL, SHEAR, BENDING = SpringFamily

# The paper's law of shear: a spring along each diagonal.
DIAGONALS = {"shear": 0.0, "shear_spring": 100.0}


def energy(x: np.ndarray, springs: Springs) -> float:
    """Sum of k (|d| - L0)^2 / 2 over all springs [J]."""
    length = np.linalg.norm(x[springs.pairs[:, 1]] - x[springs.pairs[:, 0]], axis=1)
    return float((springs.stiffness * (length - springs.rest_length) ** 2).sum() / 2)


def flat(garment: Garment) -> np.ndarray:
    """Rest positions in space, shape (n, 3)."""
    return np.column_stack([garment.rest, np.zeros(len(garment.rest))])


def curved_panel(spacing: float) -> Garment:
    """A disc."""
    data = rectangle(0.2, 0.2)
    for edge in data["edges"]:
        edge["curvature"] = {"type": "circle", "params": [0.2 / math.sqrt(2), 0, 1]}
    return Garment.from_pattern(pattern({"disc": data}), spacing)


# ---- which springs there are


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (2, 2), (5, 3), (8, 13)])
def test_families_of_a_rectangle_by_formula(nx, ny):
    garment = sheet(0.02 * nx, 0.02 * ny, 0.02)
    springs = build_springs(garment, plain_fabric(bending_spring=3.0))
    count = {f: int((springs.family == f).sum()) for f in SpringFamily}
    assert count[STRUCTURAL] == nx * (ny + 1) + ny * (nx + 1)  # along rows and columns
    assert count[SHEAR] == 2 * nx * ny  # both diagonals of each cell
    assert count[BENDING] == (nx - 1) * (ny + 1) + (ny - 1) * (nx + 1)  # two apart along rows and columns
    d = np.abs(np.diff(garment.rest[springs.pairs], axis=1)[:, 0]) / 0.02
    for family, steps in ((STRUCTURAL, {(1, 0), (0, 1)}), (SHEAR, {(1, 1)}), (BENDING, {(2, 0), (0, 2)})):
        assert {tuple(s) for s in np.rint(d[springs.family == family]).astype(int)} <= steps
    np.testing.assert_allclose(d, np.rint(d), atol=1e-9)
    np.testing.assert_allclose(springs.rest_length, 0.02 * np.linalg.norm(d, axis=1), rtol=1e-9)


def test_springs_have_a_fixed_order_and_stand_once():
    garment = curved_panel(0.02)
    one, two = (build_springs(garment, plain_fabric(bending_spring=3.0)) for _ in range(2))
    for field in ("pairs", "rest_length", "stiffness", "family"):
        np.testing.assert_array_equal(getattr(one, field), getattr(two, field))
    key = np.column_stack([one.pairs, one.family == BENDING])
    assert (one.pairs[:, 0] < one.pairs[:, 1]).all()
    assert (key == np.unique(key, axis=0)).all()  # sorted, and none twice


def test_springs_at_the_boundary_follow_the_triangles_and_their_opposite_corners():
    garment = curved_panel(0.02)
    springs = build_springs(garment, plain_fabric(**DIAGONALS, bending_spring=3.0))
    band = garment.triangles[~garment.in_quad]
    assert len(band) > 30
    sides, opposite = set(), set()
    corner_of: dict[tuple[int, int], list[tuple[int, bool]]] = {}
    for t, in_quad in zip(garment.triangles.tolist(), garment.in_quad, strict=True):
        for k in range(3):
            side = tuple(sorted((t[k], t[(k + 1) % 3])))
            corner_of.setdefault(side, []).append((t[(k + 2) % 3], bool(in_quad)))
            if not in_quad:
                sides.add(side)
    for corners in corner_of.values():
        if len(corners) == 2 and not (corners[0][1] and corners[1][1]):
            opposite.add(tuple(sorted(c for c, _ in corners)))
    grid_sides, grid_diagonals = set(), set()
    for a, b, c, d in garment.quads.tolist():
        grid_sides |= {tuple(sorted(p)) for p in ((a, b), (b, c), (c, d), (d, a))}
        grid_diagonals |= {tuple(sorted(p)) for p in ((a, c), (b, d))}
    straight = {tuple(sorted((t[0], t[2]))) for t in [*garment.rows.tolist(), *garment.columns.tolist()]}
    pairs = [tuple(p) for p in springs.pairs.tolist()]
    stretching = {p for p, f in zip(pairs, springs.family, strict=True) if f != BENDING}
    bending = {p for p, f in zip(pairs, springs.family, strict=True) if f == BENDING}
    assert stretching == sides | grid_sides | grid_diagonals
    assert bending == opposite | straight
    assert (springs.stiffness > 0).all()


def test_every_particle_has_springs_that_stretch_and_springs_that_bend():
    garment = curved_panel(0.015)
    springs = build_springs(garment, plain_fabric(bending_spring=3.0))
    bends = springs.family == BENDING
    assert len(np.unique(springs.pairs[~bends])) == garment.particle_count
    # But for a corner of a single triangle, which is opposite to nothing but its own side's neighbour.
    alone = int((np.bincount(garment.triangles.ravel()) == 1).sum())
    assert len(np.unique(springs.pairs[bends])) >= garment.particle_count - alone


def test_sewn_springs_lie_across_the_seam_and_parallel_ones_are_combined():
    springs = Springs(
        np.array([[0, 1], [2, 3], [1, 4]], dtype=np.int32), np.array([1.0, 2.0, 0.5]), np.array([10.0, 30.0, 7.0]),
        np.zeros(3, dtype=np.int32),
    )  # fmt: skip
    sewn = springs.renumbered(np.array([0, 1, 0, 1, 2], dtype=np.int32))
    assert sewn.pairs.tolist() == [[0, 1], [1, 2]]
    # F = 10 (L - 1) + 30 (L - 2) = 40 (L - 1.75)
    assert sewn.stiffness == pytest.approx([40.0, 7.0])
    assert sewn.rest_length == pytest.approx([1.75, 0.5])


# ---- Hooke's law


def test_forces_are_the_papers_sum_over_the_neighbours():
    rng = np.random.default_rng(1)
    x, v = rng.standard_normal((2, 12, 3))
    pairs = np.array([(i, j) for i in range(12) for j in range(i) if rng.random() < 0.4], dtype=np.int32)
    rest, k = rng.uniform(0.2, 3.0, len(pairs)), rng.uniform(1.0, 50.0, len(pairs))
    tau = 0.03
    expected = np.zeros_like(x)
    for i in range(12):
        for (a, b), length0, stiffness in zip(pairs.tolist(), rest, k, strict=True):
            if i not in (a, b):
                continue
            other = b if i == a else a
            d = x[other] - x[i]  # from the particle to its neighbour
            length = np.linalg.norm(d)
            expected[i] += stiffness * (1 - length0 / length) * d
            expected[i] += stiffness * tau * np.dot(v[other] - v[i], d / length) * d / length
    force = spring_force(x, v, pairs, rest, k, tau)
    np.testing.assert_allclose(force, expected, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-11)
    np.testing.assert_allclose(np.cross(x, force).sum(axis=0), 0.0, atol=1e-11)


def test_forces_are_the_slope_of_the_energy():
    garment = curved_panel(0.04)
    springs = build_springs(garment, Fabric.preset("denim"))
    x = flat(garment) + 0.002 * np.random.default_rng(2).standard_normal((garment.particle_count, 3))
    force = spring_force(x, np.zeros_like(x), springs.pairs, springs.rest_length, springs.stiffness, 0.0)
    for i in range(0, garment.particle_count, 3):
        for axis in range(3):
            nudge = np.zeros_like(x)
            nudge[i, axis] = 1e-7
            slope = (energy(x + nudge, springs) - energy(x - nudge, springs)) / 2e-7
            assert force[i, axis] == pytest.approx(-slope, rel=1e-5, abs=1e-5)


def test_coincident_ends_exert_nothing():
    x = np.zeros((2, 3))
    v = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    assert not spring_force(x, v, [[0, 1]], [1.0], [1.0], 0.1).any()
    assert not spring_force(x, v, [[0, 1]], [0.0], [1.0], 0.1).any()


def test_strain_is_extension_over_rest_length():
    x = np.array([[0.0, 0, 0], [0, 0, 1.2]])
    springs = Springs(np.array([[0, 1]], dtype=np.int32), np.ones(1), np.ones(1), np.zeros(1, dtype=np.int32))
    assert spring_strains(x, springs) == pytest.approx([0.2])


# ---- the sheet as a membrane


def moduli(garment: Garment, springs: Springs) -> dict[str, float]:
    """C11, C22, C12 and G [N/m] of a sheet under small uniform strains, from its energy per area."""
    e = 1e-5
    x, area = flat(garment), garment.areas.sum()

    def stretched(xx: float, yy: float, xy: float) -> float:
        return 2 * energy(x @ np.array([[1 + xx, xy, 0], [xy, 1 + yy, 0], [0, 0, 1]]), springs) / (e * e * area)

    c11, c22, both = stretched(e, 0, 0), stretched(0, e, 0), stretched(e, e, 0)
    return {"C11": c11, "C22": c22, "C12": (both - c11 - c22) / 2, "G": stretched(0, 0, e / 2)}


@pytest.mark.parametrize("spacing", [0.02, 0.01])
def test_membrane_moduli_of_the_grid(spacing):
    # C11 = k_s + k_d, C12 = G = k_d: at any spacing, outline springs included.
    springs_of = plain_fabric(structural_warp=500.0, structural_weft=300.0, shear=0.0, shear_spring=70.0)
    garment = sheet(0.2, 0.12, spacing)
    found = moduli(garment, build_springs(garment, springs_of))
    assert found == pytest.approx({"C11": 370.0, "C22": 570.0, "C12": 70.0, "G": 70.0}, rel=1e-3)


def test_bending_springs_add_four_of_their_stiffness_to_the_membrane():
    nx, ny, k = 20, 12, 5.0
    garment = sheet(0.01 * nx, 0.01 * ny, 0.01)
    with_them = moduli(garment, build_springs(garment, plain_fabric(**DIAGONALS, bending_spring=k)))
    without = moduli(garment, build_springs(garment, plain_fabric(**DIAGONALS)))
    # Each of them, 2 h long, stands for a cell of h by h; the outline has one row more and one column fewer than cells.
    assert with_them["C11"] - without["C11"] == pytest.approx(4 * k * (nx - 1) * (ny + 1) / (nx * ny), rel=1e-3)
    assert with_them["C22"] - without["C22"] == pytest.approx(4 * k * (ny - 1) * (nx + 1) / (nx * ny), rel=1e-3)
    assert with_them["C12"] == pytest.approx(without["C12"], rel=1e-3)
    assert with_them["G"] == pytest.approx(without["G"], rel=1e-3)


def test_cells_that_are_not_square():
    # 0.07 by 0.05 m at 0.02 m: cells of 17.5 by 16.7 mm.
    garment = sheet(0.07, 0.05, 0.02)
    found = moduli(
        garment,
        build_springs(
            garment, plain_fabric(structural_warp=500.0, structural_weft=300.0, shear=0.0, shear_spring=70.0)
        ),
    )
    assert found == pytest.approx({"C11": 370.0, "C22": 570.0, "C12": 70.0, "G": 70.0}, rel=0.06)


def test_membrane_moduli_of_a_panel_with_a_curved_outline():
    # The band follows the sides of its triangles; the panel as a whole is as stiff as the grid to a tenth.
    garment = curved_panel(0.01)
    found = moduli(garment, build_springs(garment, plain_fabric(**DIAGONALS)))
    assert found == pytest.approx({"C11": 500.0, "C22": 500.0, "C12": 100.0, "G": 100.0}, rel=0.1)


def test_pulled_strip_stretches_as_its_modulus_says():
    # Force, not energy: a strip k_s + k_d - k_d^2 / (k_s + k_d) stiff, its sides free.
    from cloth_core.quality import Settings
    from cloth_core.scene import Scene
    from cloth_core.simulation import Simulation

    garment = sheet(0.1, 0.3, 0.02)
    fabric = plain_fabric(**DIAGONALS, damping_time=1e-4, bending=0.0)
    top = np.flatnonzero(garment.rest[:, 1] > 0.149).astype(np.int32)
    scene = Scene(
        garment=garment, fabric=fabric, pins=top, gravity=(0.0, -20.0, 0.0), air_drag=30.0, settings=Settings()
    )
    simulation = Simulation(scene)
    simulation.advance(2.0)
    weight = 0.2 * 0.3 * 20.0  # per width [N/m], at the top
    effective = 500.0 - 100.0**2 / 500.0
    lengthening = garment.start[:, 1].min() - simulation.positions[:, 1].min()
    # Tension falls linearly to nothing at the lower end: the mean is half of it.
    assert lengthening == pytest.approx(0.3 * weight / 2 / effective, rel=0.04)


# ---- the paper's third family


def test_bending_springs_have_no_stiffness_when_flat():
    # Their energy grows with the fourth power of the angle: doubled, it is 16 times as large.
    h, k, energies = 0.01, 5.0, []
    for angle in (0.02, 0.04, 0.08):
        ends = [
            [-h * math.cos(angle / 2), 0, h * math.sin(angle / 2)],
            [h * math.cos(angle / 2), 0, h * math.sin(angle / 2)],
        ]
        spring = Springs(
            np.array([[0, 1]], dtype=np.int32), np.array([2 * h]), np.array([k]), np.array([2], dtype=np.int32)
        )
        energies.append(energy(np.array(ends), spring))
        assert energies[-1] == pytest.approx(k * h**2 * angle**4 / 32, rel=2e-3)
    assert energies[1] / energies[0] == pytest.approx(16.0, rel=2e-3)
    assert energies[2] / energies[1] == pytest.approx(16.0, rel=2e-3)


def test_bending_springs_of_a_rolled_sheet_grow_with_the_fourth_power():
    garment = sheet(0.1, 0.06, 0.01)
    springs = build_springs(garment, plain_fabric(bending_spring=5.0))
    only = springs.family == BENDING
    third = Springs(springs.pairs[only], springs.rest_length[only], springs.stiffness[only], springs.family[only])

    def rolled(angle: float) -> float:
        # Links keep their length: corner angle `angle` between two of them.
        radius = 0.005 / math.sin(angle / 2)
        u = garment.rest[:, 0] / 0.01 * angle
        return energy(np.column_stack([radius * np.sin(u), garment.rest[:, 1], radius * np.cos(u)]), third)

    assert rolled(0.1) / rolled(0.05) == pytest.approx(16.0, rel=3e-3)
    assert rolled(0.2) / rolled(0.1) == pytest.approx(16.0, rel=1e-2)


@pytest.mark.parametrize("damping_time", [0.0, 0.02])
def test_runs_and_single_springs_give_the_same_forces(damping_time):
    # One spring after the other, shuffled so that no two in line follow each other, against the runs of the grid.
    garment = curved_panel(0.02)
    springs = build_springs(garment, Fabric.preset("denim", **DIAGONALS))
    runs = springs.runs(springs.stiffness).mixed(1.0)
    assert runs.length.sum() + len(runs.rest) == len(springs)
    assert runs.length.sum() > 0.5 * len(springs)
    rng = np.random.default_rng(8)
    x = flat(garment) + 0.002 * rng.standard_normal((garment.particle_count, 3))
    v = rng.standard_normal(x.shape)
    single = sum(
        spring_force(x, v, springs.pairs[[s]], springs.rest_length[[s]], springs.stiffness[[s]], damping_time)
        for s in rng.permutation(len(springs))
    )
    together = spring_force(x, v, springs.pairs, springs.rest_length, springs.stiffness, damping_time)
    np.testing.assert_allclose(together, single, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("spacing", [0.03, 0.02])
def test_nothing_swings_faster_than_an_endless_lattice(spacing):
    # In the mode that alternates along a row, w^2 = 4 (k_structural + k_shear) / m; at the outline of a disc particles
    # are lighter and springs shorter.
    k, shear, density = 800.0, 60.0, 0.2
    garment = curved_panel(spacing)
    springs = build_springs(garment, plain_fabric(structural_warp=k, structural_weft=k, shear=0.0, shear_spring=shear))
    matrix = np.zeros((2 * garment.particle_count,) * 2)
    for (i, j), length, stiffness in zip(springs.pairs, springs.rest_length, springs.stiffness, strict=True):
        along = (garment.rest[j] - garment.rest[i]) / length
        block = stiffness * np.outer(along, along)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] += sign * block
    scale = np.repeat(1.0 / np.sqrt(density * garment.particle_areas), 2)
    highest = np.linalg.eigvalsh(scale[:, None] * matrix * scale)[-1]
    a, b, _, d = garment.quads[0]
    cell = (garment.rest[b, 0] - garment.rest[a, 0]) * (garment.rest[d, 1] - garment.rest[a, 1])
    assert 0.8 < highest / (4.0 * (k + shear) / (density * cell)) < 1.01
