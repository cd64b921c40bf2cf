"""Writes docs/terms.md: what a scene does not need is not paid for, with the measured gain of each.

    python benchmarks/terms.py [--output docs/terms.md]

Takes about two minutes on one core.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import trimesh

from cloth_core.body import Body
from cloth_core.contact import Contact
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment
from cloth_core.grasp import Pose
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.term_cost import term_costs

ROOT = Path(__file__).parents[1]
SPACING = 0.02
# How little a particle moves in 0.05 s to count as resting here [m].
_RESTING = 1e-6


def cpu(run: Callable[[], object]) -> float:
    """Processor seconds."""
    began = time.process_time()
    run()
    return time.process_time() - began


def in_turn(*measures: Callable[[], float]) -> list[float]:
    """The least value of each of what is compared, measured in turn, so that a busy moment does not fall on one."""
    return [min(values) for values in zip(*([measure() for measure in measures] for _ in range(9)), strict=True)]


def tshirt(**changes: object) -> Scene:
    """On the young woman."""
    scene = Scene.build(Pattern.load("tshirt"), Body.load("young"), settings=Settings(spacing=SPACING))
    return replace(scene, **changes)


def hung_sheet(without: tuple[str, ...] = (), air_drag: float = 1.0) -> Simulation:
    """A square metre of poplin that swings down from level, held at two corners."""
    pattern = Pattern.load("rectangle")
    garment = Garment.from_pattern(pattern, SPACING)
    width, height = np.ptp(garment.rest[:, :2], axis=0)
    flat = np.column_stack([garment.rest[:, 0], garment.rest[:, 1], np.zeros(len(garment.rest))])
    corners = np.flatnonzero(
        (np.abs(garment.rest[:, 0]) > 0.499 * width) & (garment.rest[:, 1] > garment.rest[:, 1].max() - 0.001 * height)
    ).astype(np.int32)
    return Simulation(Scene(
        garment=replace(garment, start=flat), fabric=Fabric.preset("cotton_poplin"), pins=corners, air_drag=air_drag,
        settings=Settings(spacing=SPACING), without=without,
    ))  # fmt: skip


def step_cost(simulation: Simulation, term: str = "step") -> float:
    """Microseconds that one step, or one term of it, takes on the present state; best of some measurements."""
    s = simulation
    return min(
        term_costs(s.motion.x, s.motion.v, s.motion.terms, s.motion.contact_settings, s.motion.contacts, s.time_step)[
            term
        ]
        for _ in range(5)
    )


def self_contact() -> str:
    """Swinging sheet with and without."""
    off, on = (hung_sheet(without) for without in (("self contact",), ()))
    listed = int(on.motion.contacts.pairs.listed_count[0])
    seconds = [cpu(lambda: s.advance(0.3)) / s.time for s in (off, on)]  # noqa: B023
    met = int(on.motion.contacts.pairs.listed_count[0])
    contact = on.model.contact
    assert contact is not None
    particles = on.model.particle_count
    return (
        f"{particles} particles that swing down, held at two corners: {seconds[1]:.2f} s of processor time for a "
        f"simulated second with the search ({contact.broad.searches} in {on.time:.1f} s), {seconds[0]:.2f} without; "
        f"{listed} pairs at the start, {met} at the end"
    )


def smooth_cloth() -> str:
    """Swinging sheet with and without leaving out of the search what is too smooth to touch itself."""
    seconds, searches = [], []
    for leave_out in (False, True):
        sheet = hung_sheet()
        contact = sheet.model.contact
        assert contact is not None
        assert contact.cloth is not None
        if not leave_out:
            contact.cloth.smooth = None
            contact.forget()
        before = contact.broad.searches
        seconds.append(cpu(lambda: sheet.advance(1.0)))  # noqa: B023
        searches.append(contact.broad.searches - before)
    return (
        f"the sheet of the row above for 1 s, in which it swings through and bends: {searches[1]} searches and "
        f"{seconds[1]:.2f} s of processor time with it, {searches[0]} and {seconds[0]:.2f} s without"
    )


def candidates() -> str:
    """A T-shirt that is sewn, with pairs kept while they hold and with a search of all before each step."""
    seconds, searches, steps = [], [], 0
    for kept in (True, False):
        simulation = Simulation(tshirt())
        simulation.advance(0.2)
        contact = simulation.model.contact
        assert contact is not None
        before, steps = contact.broad.searches, simulation.steps
        if kept:
            seconds.append(cpu(lambda: simulation.advance(0.05)))  # noqa: B023
        else:
            seconds.append(cpu(lambda: searched_each_step(simulation, 0.05)))  # noqa: B023
        searches.append(contact.broad.searches - before)
        steps = simulation.steps - steps
    return (
        f"T-shirt at {1000 * SPACING:g} mm while it is sewn, {steps} steps: {searches[0]} searches and "
        f"{seconds[0]:.2f} s of processor time, {searches[1]} and {seconds[1]:.1f} s with one before each step"
    )


def searched_each_step(simulation: Simulation, duration: float) -> None:
    """As `advance`, with all contacts searched anew before each step."""
    assert simulation.model.contact is not None
    end = simulation.time + duration
    while simulation.time < end - 1e-12:
        simulation.model.contact.forget()
        simulation.motion.search_contacts()
        simulation.motion.run(1, last_time=end)


def air() -> str:
    """A step with and without air."""
    sheets = [hung_sheet(("self contact",), air_drag) for air_drag in (0.0, 1.0)]
    off, on = in_turn(*(partial(step_cost, sheet) for sheet in sheets))
    return f"a step of that sheet: {on:.1f} us with air, {off:.1f} without"


def rest() -> str:
    """Stepping and not stepping what lies still; how much of a garment rests while it still drapes."""
    simulation = Simulation(tshirt())
    resting: list[float] = []
    last: list[tuple[float, np.ndarray]] = []

    def look(s: Simulation) -> None:
        if s.drapes_coarsely:
            return
        x = s.positions
        if last and s.time - last[-1][0] < 0.05:
            return
        if last:
            resting.append(float((np.linalg.norm(x - last[-1][1], axis=1) < _RESTING).mean()))
        last.append((s.time, x))

    assert simulation.settle(look).settled
    with all_awake():
        awake = cpu(lambda: simulation.advance(0.5)) / 0.5
    while not simulation.asleep and simulation.time < 60.0:
        simulation.advance(0.5)
    asleep = cpu(lambda: simulation.advance(1000.0))
    return (
        f"T-shirt at {1000 * SPACING:g} mm after rest: {awake:.2f} s for a simulated second that is stepped, "
        f"{1e3 * asleep:.1f} ms for 1000 s that are not. While it still draped, {100 * np.mean(resting):.0f} % of its "
        f"particles on average moved by less than 1 um in 0.05 s"
    )


def all_awake() -> Any:
    """A context in which nothing is still enough to sleep."""
    return patch("cloth_core.resting_regions._STILL", -1.0)


def regions() -> str:
    """Cloth at rest that a gripper takes hold of, carries aside and holds there."""
    texts = []
    for name, scene, way in (
        ("towel of 0.8 m on a table, one corner held up", towel(), (-0.1, -0.1, 0.12)),
        ("T-shirt, a sleeve held aside", tshirt(), (0.05, 0.0, 0.05)),
    ):
        simulation = held_aside(scene, way)
        asleep, cost, x = float(simulation.motion.asleep.mean()), step_cost(simulation), simulation.positions
        simulation.motion.let_sleep(None)
        whole_cost = step_cost(simulation)
        with all_awake():
            reference = held_aside(scene, way).positions
            nudged = held_aside(scene, way, nudge=1e-6).positions
        texts.append(
            f"{name} for a second: {100 * asleep:.0f} % asleep, a step {cost:.0f} us, with all awake {whole_cost:.0f}; "
            f"positions differ by {distance(x, reference)}, those of a run with all awake in which one particle was 1 "
            f"um elsewhere when the gripper took hold by {distance(nudged, reference)}"
        )
    return "; ".join(texts)


def towel() -> Scene:
    """A square of poplin flat on a table."""
    garment = Garment.from_pattern(Pattern.load("rectangle"), SPACING)
    shape = 0.8 * garment.rest[:, :2] / np.ptp(garment.rest[:, :2], axis=0)
    flat = np.column_stack([shape - shape.mean(axis=0), np.full(len(shape), 0.004)])
    table = trimesh.creation.box(extents=[1.4, 1.4, 0.1])
    body = Body.from_arrays(np.asarray(table.vertices) - [0.0, 0.0, 0.05], np.asarray(table.faces), "table")
    return Scene(garment=replace(garment, start=flat), body=body, fabric=Fabric.preset("cotton_poplin"))


def held_aside(scene: Scene, way: tuple[float, float, float], nudge: float = 0.0) -> Simulation:
    """Cloth at rest of which a gripper has carried a corner off within a second, then held it for another one."""
    simulation = Simulation(scene)
    assert simulation.settle().settled
    simulation.advance(1.0)
    x = simulation.positions
    corner = x[np.argmax(x[:, 0])]
    held = np.flatnonzero(np.linalg.norm(x - corner, axis=1) < 0.03)
    simulation.motion.x[len(simulation.motion.x) // 2] += nudge
    simulation.grasp("hand", held, Pose.of(corner))
    for share in np.linspace(0.0, 1.0, 100):
        simulation.move_grasp("hand", Pose.of(corner + share**2 * (3.0 - 2.0 * share) * np.array(way)))
        simulation.advance(0.01)
    simulation.advance(1.0)
    return simulation


def distance(a: np.ndarray, b: np.ndarray) -> str:
    """RMS and largest, in words."""
    way = 1000.0 * np.linalg.norm(a - b, axis=1)
    return f"{np.sqrt((way**2).mean()):.2g} mm (RMS; at most {way.max():.2g} mm)"


def seams() -> str:
    """Before and after merging."""
    simulation = Simulation(tshirt())
    particles, whole, pull = len(simulation.motion.x), step_cost(simulation), step_cost(simulation, "seams")
    while simulation.phase == "sewing":
        simulation.tick()
    merged = simulation.model.particle_count
    return (
        f"T-shirt at {1000 * SPACING:g} mm: {particles} particles become {merged}, and the pull of the "
        f"seams, {pull:.1f} of {whole:.0f} us of a step, is gone"
    )


def body_tree() -> str:
    """Search in the part of the body's tree that the cloth can reach, and in all of it."""
    simulation = Simulation(replace(tshirt(), worn=()))
    contact = simulation.model.contact
    assert contact is not None
    assert contact.body is not None
    both = search_cost(simulation, contact)
    contact.broad.cloth = None

    def in_whole_tree() -> float:
        with patch("cloth_core.reachable_tree.ReachableTree.of", lambda self, whole, lower, upper: whole):
            return search_cost(simulation, contact)

    cut, uncut = in_turn(partial(search_cost, simulation, contact), in_whole_tree)
    tree, whole = contact.body.reachable.tree, contact.body.body.tree
    assert tree is not None
    return (
        f"T-shirt: {(tree.triangle >= 0).sum()} of {(whole.triangle >= 0).sum()} triangles are in the tree; a search "
        f"takes {cut:.2f} ms, in the whole tree {uncut:.2f} ms; with cloth against cloth {both:.1f} ms"
    )


def search_cost(simulation: Simulation, contact: Contact) -> float:
    """Milliseconds of a broad phase at the present state, best of five."""
    x = simulation.motion.x
    reach = np.full(len(x), 0.001)

    def search() -> None:
        for _ in range(20):
            contact.broad.forget()
            contact.broad.at(x, reach)

    return min(50.0 * cpu(search) for _ in range(5))


PAGE = """# Only what the scene requires

What a scene does not need is not there: no arrays, no tree, no loop. Measured by `python benchmarks/terms.py`
(processor time of one thread; it varies by 10 to 20 % from run to run), tests by name in `tests/core`.

| what | how it is found out | measured | it comes back by itself | off costs nothing and changes no bit |
|---|---|---|---|---|
{rows}

## What is not done, and why

- **Self contact is not switched off as a whole.** Any sheet can be folded onto itself, so that nothing can be proved
  before a run. What can be proved at each moment is that smooth cloth does not touch itself (third row); pairs of what
  else can meet before the next search are listed, and where there are none, no response runs. Who knows that nothing
  will meet says `--without "self contact"`, and the report counts what came closer than the thickness.
- **A run to rest steps everything.** {resting}: at most that share of the steps
  after sewing could be saved, a tenth of the T-shirt's time, and what creeps to its place in a drape must not be held.
  No region sleeps either while a body moves, with implicit steps, or in motion that no run to rest has gone before.
"""


def main() -> None:
    """Measures and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "terms.md")
    output = parser.parse_args().output
    Simulation(tshirt()).settle()  # compiles
    hung_sheet().advance(0.05)
    asleep, _, resting = rest().partition(". ")
    rows = (
        ("search before each step", "pairs are kept until a particle has used up its radius", candidates(),
         "`test_cloth_on_cloth.py::test_candidates_are_kept_while_they_hold`",
         "not to the bit: `test_cloth_on_cloth.py::test_run_does_not_depend_on_when_candidates_were_searched`"),
        ("self contact", "pairs within reach of the next search; none: no response", self_contact(),
         "`test_only_what_is_needed.py::test_self_contact_...`",
         "`test_switched_off.py::test_self_contact_that_is_off_changes_no_bit_...`, `..._has_no_arrays`"),
        ("smooth cloth",
         "deformation gradients in overlapping windows: no two of their points are nearer than 0.3 of their distance "
         "in the panel (`smooth_windows.py`)", smooth_cloth(),
         "`test_smooth_windows.py::test_what_folds_is_noticed_and_searched_again`, `..._sheet_that_is_folded_over_...`",
         "`test_smooth_windows.py::test_sheet_that_swings_without_folding_...`"),
        ("air", "k_a = 0", air(), "`test_only_what_is_needed.py::test_drag_of_a_run_to_rest_...`",
         "`test_switched_off.py::test_term_that_is_off_...`"),
        ("cloth at rest", "nothing moves by 0.1 um in a window after a run to rest", asleep,
         "`test_asleep.py::test_a_gripper_wakes_it`, `..._a_body_that_moves_...`, `..._a_reset_...`",
         "`test_asleep.py::test_after_rest_time_goes_on_without_steps`, `..._stepping_on_would_have_changed_nothing`"),
        ("regions at rest",
         "particles that move by less than 0.5 um in 0.05 s, and would in a swing, with neighbours and what they "
         "touch; after a run to rest (`resting_regions.py`)", regions(),
         "`test_resting_regions.py::test_what_sleeps_follows_...`, `..._what_is_let_go_...`, "
         "`..._a_body_that_moves_...`, `..._neighbours_that_creep_...`",
         "`test_resting_regions.py::test_motion_without_a_run_to_rest_...`, `..._forces_on_what_is_awake_...`"),
        ("seams", "all points have met: merged into one particle each", seams(),
         "`test_simulation.py::test_reset_opens_the_seams_again`, "
         "`test_sewing.py::test_points_that_had_to_stay_two_...`",
         "`test_only_what_is_needed.py::test_garment_that_is_sewn_...`"),
        ("body out of reach", "triangles whose boxes do not meet the cloth's, 10 cm larger (`reachable_tree.py`)",
         body_tree(),
         "`test_reachable_tree.py::test_a_simulation_searches_...`, "
         "`test_only_what_is_needed.py::test_body_that_was_out_of_reach_...`",
         "`test_reachable_tree.py::test_the_same_pairs_...`, "
         "`test_only_what_is_needed.py::test_body_out_of_reach_...`, `test_switched_off.py::test_without_body_...`"),
    )  # fmt: skip
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    output.write_text(PAGE.format(rows=table, resting=resting), encoding="utf-8")
    print(output.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
