"""The extremes that other cloth simulators fail on, one row after the other, each with what is expected of it.

What a test elsewhere states is named here; what none states is tested here.
"""

import ast
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from apparatus import body_of, panel, pattern, placed, plain_fabric, rectangle, sheet

from cloth_core.blow_up import FixedStepMotion
from cloth_core.calibration import Cloth
from cloth_core.errors import ClothError, PatternError, SimulationError
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.model import Model
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings, with_expected_error
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.springs import spring_strains

# Row: the case, what is expected, and the tests that state it ("." is this file).
ROWS: dict[int, tuple[str, str, tuple[str, ...]]] = {
    1: ("dt at 0.95 / 1.05 of the stable limit", "runs / a named error before anything is not finite",
        ("test_row_01_step_on_either_side_of_the_limit",
         "test_stability.py::test_sheet_is_bounded_below_its_stable_time_step_and_not_above")),
    2: ("dt of 1 s", "sub-steps, and the usable dt is stated",
        ("test_simulation.py::test_time_step_longer_than_the_stable_one_is_cut_and_the_user_told",)),
    3: ("dt of 1e-8", "correct, and slow is not taken for still",
        ("test_simulation.py::test_tiny_time_step_is_right_and_not_taken_for_rest",
         "test_row_03_run_to_rest_with_a_tiny_step_does_not_end_at_rest")),
    4: ("stiffness 1e8 N/m; 1e-3 N/m", "stable dt stated; all finite",
        ("test_stability.py::test_extreme_stiffness_has_a_finite_stable_step", "test_row_04_extreme_stiffness_runs")),
    5: ("free fall at 0.005 and at 2 kg/m2", "zero strain",
        ("test_free_fall.py::test_free_fall_is_exact_and_strains_nothing",)),
    6: ("neighbouring mass ratio 1e3, 1e6", "stable, dt stated",
        ("test_stability.py::test_very_different_masses_next_to_each_other",
         "test_blow_up.py::test_prediction_holds_at_the_extremes",
         "test_row_06_very_different_masses_run_with_the_stated_step")),
    7: ("zero, negative, NaN mass; NaN or infinite vertex", "refused, with the name and index",
        ("test_garment.py::test_panel_without_cloth_is_no_scene",
         "test_fabric.py::test_value_that_is_no_plausible_number_is_refused_with_its_name",
         "test_recovery.py::test_particle_whose_place_is_no_number_is_refused_with_its_name",
         "test_body.py::test_malformed_body_is_refused_with_its_name_and_the_reason",
         "test_pattern.py::test_malformed_pattern_is_refused_in_one_line_that_says_what_is_wrong")),
    8: ("resolution x2, x4", "dt rescaled by itself; the same drape within the stated error",
        ("test_stability.py::test_finer_sheet_has_a_shorter_stable_step_by_itself",
         "test_row_08_finer_sheets_have_the_same_drape")),
    9: ("sliver triangles (aspect 1e4)", "warning, finite",
        ("test_garment.py::test_sliver_gives_a_warning_with_the_panels_name", "test_row_09_slivers_stay_finite")),
    10: ("zero-area triangle in the body", "dropped, counted", ("test_body.py::test_every_repair_is_counted",)),
    11: ("coincident particles, zero-length spring", "no NaN, no kick",
         ("test_springs.py::test_coincident_ends_exert_nothing", "test_row_11_coincident_particles_are_not_kicked")),
    12: ("isolated vertex, single particle, 2 x 2 sheet, empty mesh", "harmless, or a clear error",
         ("test_row_12_two_by_two_sheet_swings", "test_row_12_nothing_at_all_is_refused",
          "test_pattern.py::test_vertices_of_no_edge_are_left_out_with_a_warning",
          "test_mesh_files.py::test_broken_bodies_are_refused_in_one_line")),
    13: ("seam edges of different length or sample count", "matched; beyond 50 % difference a warning",
         ("test_garment.py::test_seam_edges_of_different_length_take_the_count_of_the_longer",
          "test_sewing.py::test_unequal_edges_close_by_gathering",
          "test_pattern.py::test_seam_of_very_different_lengths_is_warned_about")),
    14: ("twisted seam", "detected, named", ("test_pattern.py::test_twisted_seam_is_warned_about",)),
    15: ("five seams that meet in one point", "merged once",
         ("test_garment.py::test_five_seams_that_meet_in_one_point_are_merged_once",)),
    16: ("cloth starts inside the body", "pushed out at bounded speed, or named as impossible",
         ("test_contact.py::test_too_near_is_pushed_out_and_never_held_back",
          "test_scene.py::test_panel_inside_the_body_is_moved_straight_out_and_the_user_told",
          "test_scene.py::test_panel_that_cannot_be_cleared_is_refused_with_its_name")),
    17: ("cloth starts crossed with itself", "warning; the count never rises",
         ("test_crossed_start.py::test_cloth_that_starts_crossed_is_warned_about_with_its_panels",
          "test_crossed_start.py::test_number_of_crossings_is_that_of_a_count_by_another_formula",
          "test_crossed_start.py::test_crossings_never_become_more",
          "test_crossed_start.py::test_start_that_does_not_cross_is_not_warned_about",
          "test_worn_cloth.py::test_crossed_panels_are_separated_before_the_run_and_named",
          "test_worn_cloth.py::test_panels_that_cannot_be_separated_are_named_in_the_report_and_cross_no_more_than_before")),
    18: ("speed * dt larger than the body is thick", "no tunnelling",
         ("test_contact.py::test_no_tunnelling_at_100_m_per_s_and_2_ms",)),
    19: ("body with flipped winding, holes, several shells", "repaired, or refused with the reason",
         ("test_body.py::test_inside_out_body_is_turned",
          "test_body.py::test_open_surface_gives_a_warning_with_the_number_of_its_sides",
          "test_body_repair.py::test_mixed_winding_is_made_to_agree",
          "test_body_repair.py::test_each_shell_is_turned_by_itself",
          "test_body_repair.py::test_open_shell_is_turned_by_what_it_would_enclose",
          "test_body_repair.py::test_inner_shell_is_reported_and_counts_as_inside",
          "test_body_repair.py::test_moebius_strip_is_left_as_it_is_and_named",
          "test_body_repair.py::test_winding_number_is_that_of_libigl_on_a_body_with_holes",
          "test_draped_on_repaired.py::test_shells_with_holes_and_any_winding_all_face_outwards",
          "test_draped_on_repaired.py::test_cloth_lies_on_the_repaired_body_as_on_the_good_one",
          "test_body.py::test_malformed_body_is_refused_with_its_name_and_the_reason")),
    20: ("metres taken for centimetres, millimetres for metres", "refused with the likely unit",
         ("test_scene.py::test_body_in_another_unit_is_refused_with_the_likely_unit",
          "test_scene.py::test_garment_in_another_unit_is_refused_with_the_likely_unit",
          "test_scene.py::test_garment_that_is_too_large_for_the_body_is_refused_with_the_likely_unit")),
    21: ("scene rotated, moved by 1e4 m", "the same result, rotated / to the precision of its coordinates",
         ("test_free_fall.py::test_turned_scene_gives_the_turned_result",
          "test_free_fall.py::test_turned_scene_with_contact_gives_the_turned_result",
          "test_free_fall.py::test_scene_moved_by_10_km_gives_the_same_to_the_precision_of_its_coordinates",
          "test_free_fall.py::test_scene_with_contact_moved_by_10_km_gives_the_same_to_the_precision_of_its_coordinates")),
    22: ("garment that nothing supports", "ends with the reason, does not run for ever",
         ("test_simulation.py::test_nothing_that_supports_ends_the_run_with_the_reason",
          "test_simulation.py::test_garment_that_misses_the_body_ends_the_run_with_the_reason",
          "test_row_22_garment_that_slides_off_ends_with_the_reason")),
    23: ("cloth leaving the body", "contact never pulls it back",
         ("test_contact.py::test_contact_never_pulls_back_what_leaves",)),
    24: ("the same input twice, and with 1 or 2 threads", "bit-identical",
         ("test_simulation.py::test_two_runs_have_the_same_bits",
          "test_simulation.py::test_same_bits_in_two_processes_with_one_and_two_threads")),
}  # fmt: skip


@cache
def names_in(file: str) -> set[str]:
    tree = ast.parse((Path(__file__).parent / file).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_all_24_rows_are_there():
    assert sorted(ROWS) == list(range(1, 25))


@pytest.mark.parametrize("row", ROWS)
def test_every_row_is_stated_by_a_test_that_is_there(row):
    for test in ROWS[row][2]:
        file, _, name = test.rpartition("::")
        assert name in names_in(file or Path(__file__).name), f"row {row}: {test} is gone"


def finite(simulation: Simulation) -> bool:
    return bool(np.isfinite(simulation.positions).all() and np.isfinite(simulation.motion.v).all())


def hung(garment: Garment, fabric: Fabric | None = None, **changes) -> Scene:
    """Held at the upper corners."""
    upper = garment.rest[:, 1] > garment.rest[:, 1].max() - 1e-6
    outer = np.abs(garment.rest[:, 0]) > np.abs(garment.rest[:, 0]).max() - 1e-6
    return Scene(
        garment=garment, fabric=fabric or Fabric.preset("cotton_poplin"),
        pins=np.flatnonzero(upper & outer).astype(np.int32), **changes,
    )  # fmt: skip


def test_row_01_step_on_either_side_of_the_limit():
    for share, bounded in ((0.95, True), (1.05, False)):
        scene = hung(sheet(0.2, 0.2, 0.02), plain_fabric())
        motion = FixedStepMotion(scene)
        model = Model(scene)
        model.contact = None  # that of cloth with cloth would hold it back
        motion.use(model, scene.garment.start, np.zeros_like(scene.garment.start))
        motion.fixed_step = share * motion.stable.time_step
        motion.refresh_time_step()
        if bounded:
            motion.run(math.ceil(0.5 / motion.time_step))
            assert motion.speeds().max() < 10.0
            continue
        with pytest.raises(SimulationError, match=r"particle \d+ of panel 'sheet': left all bounds at .* time step of"):
            motion.run(math.ceil(2.0 / motion.time_step))
        assert np.isfinite([motion.x, motion.v]).all()  # the last good state


def test_row_03_run_to_rest_with_a_tiny_step_does_not_end_at_rest():
    # 3000 steps after the start nothing has moved by more than a nanometre yet, and all of it is falling.
    simulation = Simulation(hung(sheet(0.2, 0.2, 0.1), settings=Settings(time_step=1e-8, max_time=3e-5)))
    start = simulation.positions
    report = simulation.settle()
    assert not report.settled
    assert report.rest_reason.startswith("not at rest after 3.0")
    assert 0.0 < np.abs(simulation.positions - start).max() < 1e-8


@pytest.mark.parametrize("stiffness", [1e-3, 1e8])
def test_row_04_extreme_stiffness_runs(stiffness):
    fabric = plain_fabric(structural_warp=stiffness, structural_weft=stiffness, shear=stiffness / 4, bending=0.0)
    simulation = Simulation(hung(sheet(0.2, 0.2, 0.05), fabric))
    for _ in range(100):
        simulation.tick()
    assert finite(simulation)
    assert math.isfinite(simulation.report().stable_time_step)
    if stiffness > 1.0:  # as good as rigid: what has fallen beside a pin lengthens its spring, no more
        fallen = 9.80665 * simulation.time**2 / 2
        assert np.abs(spring_strains(simulation.motion.x, simulation.model.springs)).max() < (fallen / 0.05) ** 2 / 2


@pytest.mark.parametrize("ratio", [1e3, 1e6])
def test_row_06_very_different_masses_run_with_the_stated_step(ratio):
    simulation = Simulation(hung(sheet(0.2, 0.2, 0.05), plain_fabric()))
    plain = simulation.report().stable_time_step
    model = simulation.model
    model.mass[1::2] /= ratio  # rows of an odd number of particles alternate
    model.inverse_mass[1::2] *= ratio
    simulation.motion.stable = model.stable_step(simulation.motion.x, simulation.motion.air_drag)
    simulation.motion.refresh_time_step()
    stated = simulation.report().stable_time_step
    # The light ones swing alone between heavy neighbours: frequency with the root of the ratio.
    assert plain / stated == pytest.approx(math.sqrt(ratio), rel=0.5)
    assert simulation.time_step <= 0.9 * stated * (1 + 1e-12)
    for _ in range(300):
        simulation.tick()
    assert finite(simulation)
    assert simulation.progress.largest_speed <= 1.5 * 9.80665 * simulation.time


def test_row_08_finer_sheets_have_the_same_drape():
    # Distances of the coarse sheets' particles from the finest one's, at the same place of the cloth.
    shapes = {}
    for spacing in (0.05, 0.025, 0.0125):
        garment = sheet(0.2, 0.2, spacing)
        simulation = Simulation(hung(garment, settings=Settings(spacing=spacing, rest_displacement=1e-4)))
        assert simulation.settle().settled
        shapes[spacing] = {
            tuple(np.round(p, 6)): x for p, x in zip(garment.rest, simulation.positions, strict=True)
        }  # fmt: skip
    finest = shapes[0.0125]

    def error(spacing: float) -> float:
        far = [np.sum((x - finest[p]) ** 2) for p, x in shapes[spacing].items()]
        return math.sqrt(np.mean(far))

    fabric = Fabric.preset("cotton_poplin")
    stated = with_expected_error(Settings(spacing=0.025), Cloth.of(0.2 * 0.2, fabric)).expected_error
    assert stated is not None
    for spacing in (0.025, 0.05):
        assert error(spacing) < min(stated, 0.005)  # of a sheet of 200 mm


@pytest.mark.parametrize("aspect", [1e2, 1e4])
def test_row_09_slivers_stay_finite(aspect):
    garment = sheet(0.2, 0.05 / aspect, 0.05)
    assert any("narrowest triangle" in w for w in garment.warnings)
    simulation = Simulation(hung(garment, plain_fabric()))
    for _ in range(200):
        simulation.tick()
    assert finite(simulation)
    # Nothing is faster than the end of a rod that falls from where it is hinged.
    assert simulation.progress.largest_speed <= 1.5 * 9.80665 * simulation.time * 1.01


def test_row_11_coincident_particles_are_not_kicked():
    # All of a sheet in one point, and then two neighbours in one point.
    garment = sheet(0.2, 0.2, 0.1)
    weightless = {"gravity": (0.0, 0.0, 0.0), "air_drag": 0.0}
    all_in_one = replace(garment, start=np.zeros_like(garment.start))
    heap = Simulation(Scene(garment=all_in_one, fabric=plain_fabric(), **weightless))
    heap.advance(0.1)
    assert finite(heap)
    assert np.abs(heap.positions).max() == 0.0  # no direction, no force
    start = garment.start.copy()
    start[4] = start[8]
    two_in_one = replace(garment, start=start)
    pair = Simulation(Scene(garment=two_in_one, fabric=plain_fabric(damping_time=1e-3), **weightless))
    spring = plain_fabric()
    stored = 3 * (spring.structural_warp + spring.shear) * 0.1**2  # more than all springs at a moved particle hold
    lightest = float(pair.model.mass.min())
    for _ in range(50):
        pair.tick()
        assert finite(pair)
        assert pair.progress.largest_speed <= math.sqrt(2 * stored / lightest)


def test_row_12_two_by_two_sheet_swings():
    garment = sheet(0.1, 0.1, 0.1)
    assert garment.particle_count == 4
    simulation = Simulation(hung(garment))
    assert simulation.settle().settled
    low = simulation.positions[garment.rest[:, 1] < 0]
    assert low[:, 2] == pytest.approx(-0.1, abs=0.005)  # hangs down from its two pins


def test_row_12_nothing_at_all_is_refused():
    with pytest.raises(PatternError):
        pattern({})
    with pytest.raises(ClothError):
        Scene.build([])
    with pytest.raises(PatternError):
        Pattern.from_json("{}", "empty")
    for corners in ([(0, 0)], [(0, 0), (1, 0)]):  # a single particle, or two
        with pytest.raises(PatternError, match="panel 'p'"):
            pattern({"p": panel(corners)})


def test_row_22_garment_that_slides_off_ends_with_the_reason():
    # It touches the body first, with no friction to hold it.
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    scene = Scene(
        garment=placed(Garment.from_pattern(pattern({"p": rectangle(0.1, 0.1, turned=(-90, 0, 0))}), 0.05),
                       move=[0.08, 0.0, 0.11]),
        body=ball, fabric=Fabric.preset("silk", friction=0.0), settings=Settings(max_time=10.0),
    )  # fmt: skip
    report = Simulation(scene).settle()
    assert not report.settled
    assert report.rest_reason == "not supported by the body: it has fallen past it"
    assert report.simulated_time < 5.0
