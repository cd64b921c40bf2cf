"""Terms switched off by hand: they cost nothing and change nothing, and the report says what the run lacks."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from apparatus import body_of, pattern, plain_fabric, rectangle

from cloth_core.errors import SceneError
from cloth_core.layer_distance import close_pairs
from cloth_core.model import Model, Term
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.switched_off import SWITCHABLE
from cloth_core.term_shares import term_shares

FABRIC = plain_fabric(
    structural_warp=1500.0,
    structural_weft=1500.0,
    bending_spring=4.0,
    damping_time=1e-5,
    bending_damping_time=1e-3,
    friction=0.3,
    strain_limit=0.002,
    thickness=1e-3,
)
BALL = body_of(trimesh.creation.icosphere(2, radius=0.12))


def full_scene(without=(), **changes):
    """Two upright sheets, sewn together at the top over a ball, one corner held: every term has something to do."""
    two = pattern(
        {
            "front": rectangle(0.2, 0.2, at=(0, 0.05, 0.15)),
            "back": rectangle(0.2, 0.2, at=(0, 0.05, -0.15), turned=(0, 180, 0)),
        },
        [(("front", 2), ("back", 2))],
    )
    scene = Scene.build(two, BALL, FABRIC, settings=Settings(spacing=0.05, closing_time=0.2), pins=[0], without=without)
    return replace(scene, **changes)


def state_after(scene, duration=0.35):
    simulation = Simulation(scene)
    simulation.advance(duration)
    return simulation


def lacking(name):
    """The full scene built so that it has no cause for a term, without the mechanism that is tested."""
    scene = full_scene()
    fabric = {
        "shear springs": {"shear": 0.0},
        "bending springs": {"bending_spring": 0.0},
        "bending": {"bending": 0.0},
        "spring damping": {"damping_time": 0.0},
        "strain limit": {"strain_limit": 0.05},  # never reached, and the seams pull by it as before
    }
    if name in fabric:
        return replace(scene, fabric=replace(FABRIC, **fabric[name]))
    garment = scene.garment
    unsewn = replace(garment, seams=(), merged_indices=np.arange(garment.particle_count, dtype=np.int32))
    return replace(
        scene,
        **{
            "gravity": {"gravity": (0.0, 0.0, 0.0)},
            "air drag": {"air_drag": 0.0},
            "pins": {"pins": np.zeros(0, dtype=np.int32)},
            "seams": {"garment": unsewn},
            "body contact": {"body": None},
        }[name],
    )


@pytest.fixture(scope="module")
def whole_hash():
    return state_after(full_scene()).state_hash()


@pytest.mark.parametrize("name", [name for name in SWITCHABLE if name not in ("friction", "self contact")])
def test_term_that_is_off_changes_no_bit_against_a_scene_that_never_had_it(name, whole_hash):
    off = state_after(full_scene((name,)))
    assert off.state_hash() == state_after(lacking(name)).state_hash()
    assert off.state_hash() != whole_hash, "the term had nothing to do in this scene"


def test_friction_that_is_off_changes_no_bit_against_a_fabric_without_it():
    flat = pattern({"p": rectangle(0.2, 0.2, at=(0.03, 0.13, 0), turned=(-90, 0, 0))})
    scene = Scene.build(flat, BALL, FABRIC, settings=Settings(spacing=0.05))
    slippery = replace(scene, fabric=replace(FABRIC, friction=0.0))
    off, never, on = (state_after(s, 0.2) for s in (replace(scene, without=("friction",)), slippery, scene))
    assert off.state_hash() == never.state_hash() != on.state_hash()
    assert "particles that lie on the body slide freely" in off.report().terms["friction"]["missed"]


def test_self_contact_that_is_off_changes_no_bit_where_layers_cannot_meet():
    scene = Scene.build(pattern({"p": rectangle(0.2, 0.2)}), None, FABRIC, settings=Settings(spacing=0.05), pins=[0])
    # Which springs are near their strain limit is noted anew after each search, so that one is left out here; and in
    # whole ticks, because the length of a last, shorter one depends on how the time was summed up.
    off = (("strain limit",), ("strain limit", "self contact"))
    runs = [Simulation(replace(scene, without=without)) for without in off]
    for simulation in runs:
        for _ in range(12):
            simulation.tick()
    assert runs[0].model.contact is not None
    assert runs[1].model.contact is None
    assert runs[0].state_hash() == runs[1].state_hash()


def test_term_that_is_off_stays_off_while_the_body_moves():
    ends = []
    for scene in (full_scene(("gravity",)), replace(full_scene(), gravity=(0.0, 0.0, 0.0))):
        simulation = Simulation(scene)
        while simulation.phase == "sewing":
            simulation.tick()
        simulation.move_body(BALL.vertices - [0.0, 0.0, 0.05], 0.05)
        for _ in range(100):
            simulation.tick()
        assert not simulation.body_moves
        ends.append(simulation.state_hash())
    assert ends[0] == ends[1]


def test_body_whose_contact_is_off_moves_and_changes_no_bit_of_the_cloth():
    ends = []
    for moves in (False, True):
        simulation = Simulation(full_scene(("body contact",)))
        simulation.advance(0.1)
        if moves:
            there = BALL.vertices + np.array([0.0, 0.0, 0.05])
            simulation.move_body(there, 0.05)
            np.testing.assert_array_equal(simulation.scene.body.vertices, there)
        simulation.advance(0.1)
        ends.append(simulation.state_hash())
    assert ends[0] == ends[1]


@pytest.mark.parametrize("name", SWITCHABLE)
def test_term_that_is_off_has_no_arrays(name):
    model = Model(full_scene((name,)), sewing=name != "seams")
    term = next(t for t in model.terms if t.name == name)
    assert term == Term(name, False, "switched off by hand", 0)
    terms = model.force_terms(0.0)
    assert {
        "gravity": lambda: not terms.gravity.any(),
        "air drag": lambda: terms.air_drag == 0.0,
        "shear springs": lambda: model.springs.stiffness[model.springs.family == 1].sum() == 0.0,
        # Those that keep panels smooth while they are sewn are another term.
        "bending springs": lambda: not (Model(full_scene((name,))).springs.family == 2).any(),
        "bending": lambda: (
            len(model.bending) == 0 and sum(map(len, (terms.lines.first, terms.lines.rest, terms.hinges))) == 0
        ),
        "strain limit": lambda: len(terms.strain_limit.longest) == len(terms.strain_limit.watched) == 0,
        "spring damping": lambda: terms.spring_damping_time == 0.0,
        "pins": lambda: (terms.inverse_mass > 0.0).all(),
        "seams": lambda: model.seam_pull is None and len(terms.seam.pairs) == 0,
        "body contact": lambda: model.contact.body is None and len(model.contact_settings().body_triangles) == 0,
        "friction": lambda: model.contact_settings().friction == 0.0,
        "self contact": lambda: model.contact.cloth is None,
    }[name]()


def test_without_body_and_self_contact_nothing_is_searched():
    model = Model(full_scene(("body contact", "self contact")))
    assert model.contact is None
    assert not model.contact_settings().active


def test_what_is_no_term_is_refused():
    with pytest.raises(SceneError, match="without 'structural springs': no term that can be switched off; use some of"):
        full_scene(("structural springs",))


# ---- what a run lacks


def test_report_says_what_is_lacking_and_where():
    simulation = state_after(full_scene(("body contact", "gravity", "pins")), 0.6)
    report = simulation.report()
    assert report.terms["body contact"]["missed"] == next(w for w in report.warnings if w.startswith("body contact"))
    assert report.terms["gravity"]["missed"].startswith("gravity is off and ")
    assert report.terms["pins"]["missed"] == "pins are off and 1 particles were to be held"
    assert report.terms["friction"]["missed"] is None
    # The body is measured against although nothing collides with it.
    assert report.body == "test body"
    assert report.terms["body contact"]["missed"].startswith(
        f"body contact is off and {report.body_intersections} sides cross the body, "
        f"{report.body_edges_through_cloth} of its sides the cloth, up to {1000 * report.max_penetration:.3g} mm deep"
    )


def test_what_is_lacking_is_known_before_the_run_as_far_as_it_shows():
    facts = Simulation(full_scene(("gravity", "pins"))).describe()
    assert facts["terms"]["pins"]["missed"] == "pins are off and 1 particles were to be held"
    assert facts["terms"]["pins"]["missed"] in facts["warnings"]
    assert facts["terms"]["gravity"]["missed"].startswith("gravity is off and 0.016 kg of cloth do not weigh 0.157 N")


def test_effect_that_the_scene_does_not_need_is_not_missed():
    scene = full_scene(("self contact", "strain limit"), gravity=(0.0, 0.0, 0.0), air_drag=0.0)
    report = Simulation(scene).report()
    assert report.terms["self contact"]["missed"] is None
    assert report.terms["strain limit"]["missed"] is None
    assert report.warnings == ()


def test_scene_with_all_its_terms_misses_nothing():
    report = Simulation(full_scene()).report()
    assert all(term["missed"] is None for term in report.terms.values())


def flat_layers(gap):
    """Two level sheets of 5 x 5 points, one above the other, as one cloth of two panels."""
    u, v = np.meshgrid(0.05 * np.arange(5), 0.05 * np.arange(5), indexing="ij")
    one = np.stack([u.ravel(), v.ravel(), np.zeros(25)], axis=1)
    k = np.arange(25).reshape(5, 5)
    quads = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32)
    return np.concatenate([one, one + np.array([0.01, 0.01, gap])]), np.concatenate([triangles, triangles + 25]).astype(
        np.int32
    )


def test_close_layers_are_counted_as_a_naive_search_counts_them():
    x, triangles = flat_layers(0.0008)
    naive = 0
    for t in triangles:
        for i in set(range(50)) - set(t):
            # Of one sheet all are neighbours within it or far away; between the sheets none is.
            if (i < 25) != (t[0] < 25):
                point = trimesh.triangles.closest_point(x[t][None], x[i][None])[0]
                naive += np.linalg.norm(point - x[i]) < 0.001
    assert naive > 30
    assert close_pairs(x, triangles, 0.001) == naive
    assert close_pairs(*flat_layers(0.0012), 0.001) == 0


def test_points_that_are_sewn_together_are_no_layers():
    x, triangles = flat_layers(0.0)
    x[25:] = x[:25] + np.array([0.0, 0.0, 0.0005])
    assert close_pairs(x, triangles, 0.001) > 0
    assert close_pairs(x, triangles, 0.001, np.tile(np.arange(25, dtype=np.int32), 2)) == 0


# ---- shares


def test_shares_are_fractions_of_the_step_and_one_loop_is_shared_out_by_numbers():
    terms = [
        Term("gravity", True, "", 9),
        Term("structural springs", True, "", 30),
        Term("shear springs", True, "", 10),
        Term("bending springs", False, "", 0),
        Term("spring damping", True, "", 40),
        Term("seams", True, "", 2),
        Term("body contact", True, "", 5),
        Term("friction", True, "", 5),
    ]
    found = term_shares(terms, {"gravity": 1.0, "structural springs": 8.0, "body contact": 6.0, "step": 20.0})
    shares = {name: entry["share"] for name, entry in found.items()}
    assert shares["gravity"] == pytest.approx(0.05)
    assert shares["structural springs"] == pytest.approx(0.3)
    assert shares["shear springs"] == pytest.approx(0.1)
    assert shares["body contact"] == pytest.approx(0.3)
    assert shares["bending springs"] == shares["seams"] == 0.0
    assert shares["spring damping"] is shares["friction"] is None
    assert found["spring damping"]["within"] == "structural springs"
    assert found["friction"]["within"] == "body contact"


@pytest.mark.parametrize("sewn", [False, True])
def test_every_term_of_a_report_has_a_reason_and_a_share_or_says_where_it_is_counted(sewn):
    simulation = state_after(full_scene(), 0.2 if sewn else 0.0)
    for terms in (simulation.report().terms, simulation.describe()["terms"]):
        assert all(term["reason"] for term in terms.values())
        known = [term["share"] for term in terms.values() if term["share"] is not None]
        assert all(share >= 0.0 for share in known)
        assert 0.0 < sum(known) <= 1.0 + 1e-9
        for name, term in terms.items():
            assert (term["share"] is None) == (term["within"] is not None), name
            if term["within"] is not None:
                assert terms[term["within"]]["share"] > 0.0
            if not term["active"]:
                assert term["share"] == 0.0
