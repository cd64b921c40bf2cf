"""docs/speed.md and its picture from the results of speed.py."""

from __future__ import annotations

import statistics
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

GATE = 0.05
OURS = "cloth_sim"
TITLES = {"hang": "A: hung from two corners", "sphere": "B: dropped on a sphere", "selfcontact": "B with self contact"}


NOTES = """
Figures from here on are from that other machine.

Springs and bending go over eight particles at a time (`cloth_core/lanes.py`). Written as plain loops they were
vectorised by LLVM as well, at full width, but with root and division of the processor, with checks before each run
of the lattice that no two arrays overlap, and with the last elements of each run one by one. At 128 x 128, old and
new in turn in one process: damped springs 179 to 134 us, undamped 149 to 116 us. The other figures below are from
separate runs minutes apart, under a load that changed. Bending: 70 to 62 us.

Much of the rest of a step was moving data: the state changed between a row for each particle and a row for each axis
twice in every step. It now stays by axis (85 to about 27 us at 128 x 128 where nothing can touch; with contact, which
has a view by particle on it, 1.88 to 1.74 s for all steps of scene B at 64 x 64, and 0.99 to 0.90 for those of the
T-shirt at 20 mm). Rows of 16,384 numbers also lay a multiple of 4 kB apart, so that 18 of them competed for 8 places
of the first-level cache; those of the workspace are now shifted against each other (damped springs inside a run: 165
to between 115 and 140 us). A step as a whole went from 373 to 230 us.

Outside of the steps it was the estimate of the stable time step, 60 times a simulated second: more than the steps
themselves at 128 x 128, most of it in BLAS, whose threads wait for each other on a busy machine. The first 0.2 s of
scene A at 128 x 128 and 200 N/m, under a profiler: 16 s of processor time per s with it, 3.2 without.

The search for contacts took more than everything else as long as all particles had one search radius; since each has
its own, in proportion to its speed, they are used up at the same time (processor seconds, before and after, same load:
trousers at 2 cm 10.2 and 5.9; sheet on the sphere, 64 x 64, 9.0 and 4.5; with self contact 43 and 21).

Where cloth meets a body alone, radii look two triangles ahead, since what is next to something fast will soon be fast:
126 searches of everything instead of 188 in scene B, 64 x 64, and a tenth less time (3.8 and 4.2 s of processor time
for the 2 s, in turn, under load). Beside contact of cloth with cloth it gains nothing, since lists grow.

While a body moves, what it takes is searching. Its tree is refitted only where something is searched in it (T-shirt at
3 cm on a body of 27,420 triangles, 0.1 s: 1.55 to 1.8 s of processor time, 3.3 to 3.8 before), and between two searches
there are now about ten steps, each of which takes the body on (shifted by 5 cm in 0.5 s: 8.5 to 1.75 s; turned by 30
degrees in 1 s: 12.8 to 3.7; 3 % larger within 0.3 s: 4.8 to 1.7; lifted at 1 m/s: 6.6 to 3.9). Nothing crosses in any
of them; places differ by 0.007 to 3.7 mm (RMS), those after a start 1 um elsewhere by 0.1 to 3.2.

Cloth that is smooth cannot touch itself, which its deformation gradients prove (`cloth_core/smooth_windows.py`): it is
left out of the search for self contact, and may move by 16 to 64 mm between two searches instead of 6. Under the load
of other processes, both times: the sheet of scene A, 64 x 64, with self contact 14.9 and 4 to 5 s of processor time per
s; on the sphere 8.5 and 6.5, where it crumples at the impact.

Numba counts references to arrays, with an atomic instruction for each row `x[i]` that is passed on and for each array
of a call. Sampled with perf on the machine of this page, 17 % of all processor time of scene B at 32 x 32 was spent in
these two instructions. Kernels that make no arrays borrow them now (`cloth_core/kernel.py`): 0.3 %. Pairs on the list
of those that are looked at in each step are not even looked up until one of their particles has used up their room.
Both together, new over old, slice by slice of the same run in turn, with the same bits: scene B 0.83 at 32 x 32 and
0.87 at 64 x 64, T-shirt at 20 mm 0.87.

Boxes of a body's triangles are made where the search comes near, not all of them at each search while it moves: 0.95 to
0.98 of the time of a T-shirt at 20 mm on a body on its way.

Tried and not kept, since it gained nothing: more inertia for the light points at the rims of panels while seams close
(the time step grows by 1.6, and the searches by as much); larger or smaller search radii; softer springs at the
beginning of a fine mesh that starts from a coarser drape (it comes to rest twice). Softer springs in scene B, where
they may stretch by 5 %, make steps longer but the folds of the impact finer: 400 N/m pay at 64 x 64 (1.25 s per s, 1.42
with 1000, in turn) and are what is measured there; 150 gain no more, nothing is gained at 32 x 32, and with self
contact it takes longer. One matrix for all of bending, by rows with a stencil for each run of the lattice: 10 to 20 %
of bending, 3 to 5 % of a step, not kept. Springs at outlines and seams in an order in which neighbours do not wait for
each other: nothing. Planes between triangles of the cloth and the body near them, which prove that sides cannot touch:
20 times fewer pairs on the sphere, and a quarter less time as long as sides may come nearer for a few steps before they
are looked at; where the planes see to it that they cannot, no gain at 64 x 64 and a loss of a quarter at 32 x 32, since
a plane that leaves too little way has to be renewed or given up too often. A search of everything is due as soon as one
particle has used up its radius, when half of the others have used less than a quarter of theirs; to search anew only
for those that have used up half of it (1 to 8 % of them) halves what a search costs, since their neighbours fill the
same boxes, and makes them twice as many. Regions that creep by less than 25 um in 0.05 s not stepped on the way to
rest, as they are not after it: T-shirt at 10 mm, 44 % asleep on average, a step half as long with 79 % asleep, but the
run as long as before (46,500 steps instead of 42,800); at 15 and 20 mm all of it moves until it rests. Bending
damped a tenth as strongly on the way to rest, since it holds back folds that are about to buckle: the slow end of the
T-shirt at 10 mm took half as many steps from one and the same state (14,000 instead of 27,800), but eight garments from
their starts 68.7 instead of 74 s of processor time, nearly all of it in that shirt, five of them with more steps. No
damping of springs at all: two to four times as many steps, since what trembles in contact no longer calms down.

There are minutes in which the same step takes up to 40 % longer, 1.7 to 2.5 ns per spring at 128 x 128, while the C
program beside it, whose arrays are a quarter of ours, takes 1.8 to 2.0: other machines on the same chip use its cache.

What remains between this and the C program: forces are added to both ends of a spring through memory (the program
computes each spring twice instead and adds in registers), the rim is a list, and bending takes three passes over
memory, one for each axis.

"""

FIRST_USE = (
    "Numba compiles more than a hundred functions then, for half a second each on this machine, half of them in "
    "another process beside: one process alone took twice as long. That is more than the 30 s that a first start "
    "should take; what is compiled belongs to the processor that it is compiled on, and so cannot come with the "
    "package. `make demo` and `make test` compile while they install."
)
LARGER = (
    "With two threads and a core for each, pyPBD is ahead in wall time in B at 32 x 32, 9.6 mm into the sphere. With "
    "more time, the day before: scene A at 128 x 128 MuJoCo 91.6 s of processor time per s, ours in the same run "
    "7.3; B at 128 x 128 pyPBD on one thread 89, ours 11. At 200 x 200 neither MuJoCo nor pyPBD had done 0.5 s of "
    "scene A after 600 s, set-up included; ours 34.5 s per s.\n\n"
    "The machine of this run is a slow one. On an idle one with AVX-512 the C program below took 0.80 to 0.84 ns, "
    "and A and B at 64 x 64, in wall seconds per s, MuJoCo 1.84 and 6.0, Blender 2.1 and 3.3, pyPBD on one thread "
    "4.2 and 1.7: three to five times less than here; ours was not measured there. On one in between, with 1.8 to "
    "2.0 ns, an earlier version of ours took 0.10, 0.50 and 4.3 s per s in scene A and 1.8, 2.8 and 6.4 s for the "
    "T-shirt; how many steps it takes to rest differs with the last bits, which are not the same on every processor: "
    "24,000 and 43,000 at 10 mm."
)


def write_page(results: dict[str, Any], path: Path) -> None:
    """Writes the page and, next to it, the picture of the same name."""
    load = results["load"]
    lines = [
        "# Speed",
        "",
        f"Measured {results['began']} on {results['machine']}, by `python benchmarks/speed.py`. The load average was "
        f"{min(load):.1f} to {max(load):.1f}: other processes shared the cores, so wall time says little here and "
        "processor time (of all threads) stands beside it. Medians where there are several runs.",
        "",
        f"![Processor seconds per simulated second, and time of a step over the number of particles]({path.stem}.png)",
        "",
        "## The same cloth in other simulators",
        "",
        "A sheet of 1 m x 1 m and 0.2 kg, N x N particles, 2 s. Strain is that of warp and weft, at the end and in the "
        "worst frame; depth is how far particles get into the sphere (radius 0.3 m, friction 0.4), in the worst frame. "
        f"Times are compared only between rows that end with at most {100 * GATE:g} % strain. How each is set up, and "
        "what not to read into the figures: [benchmarks/peers/README.md](../benchmarks/peers/README.md).",
    ]
    lines += compared(results["cases"])
    for part, when in results.get("again", {}).items():
        if "/" in part:
            scene, n = part.split("/")
            lines += ["", f"{TITLES[scene]}, N = {n}: measured again {when}, all simulators in turn."]
    lines += ["", LARGER]
    lines += stencil(results["limit"][0])
    lines += grown(results["growth"], results.get("again", {}).get("growth", ""))
    lines += shares(results["profile"][0])
    lines += drapes(results["drape"])
    lines += first_use(results.get("first", []), results.get("again", {}).get("first", ""))
    path.write_text("\n".join(lines) + "\n")
    picture(results, path.with_suffix(".png"))


def grouped(cases: list[dict[str, Any]]) -> dict[tuple[str, int, str], list[dict[str, Any]]]:
    """Runs of each case."""
    groups = defaultdict(list)
    for case in cases:
        groups[case["scene"], case["n"], case["peer"]].append(case)
    return groups


def compared(cases: list[dict[str, Any]]) -> list[str]:
    """A table for each scene."""
    groups = grouped(cases)
    lines = []
    for scene, title in TITLES.items():
        rows = []
        for (name, n, peer), runs in groups.items():
            if name != scene:
                continue
            good = [run for run in runs if "failed" not in run]
            if not good:
                rows.append((n, np.inf, f"| {peer} | {n} | {runs[0]['failed']} |||||||"))
                continue
            wall, cpu = (
                statistics.median(run[key] for run in good) for key in ("wall_per_second", "processor_per_second")
            )
            first = good[0]
            if first["exploded_at_frame"] is not None:
                rows.append((n, np.inf, f"| {peer} | {n} | exploded at frame {first['exploded_at_frame']} |||||||"))
                continue
            mark = "" if first["strain_max"] <= GATE else " (not compared)"
            depth = f"{1e3 * first['depth_any_frame']:.1f} mm" if "depth_any_frame" in first else "-"
            rows.append(
                (
                    n,
                    cpu,
                    f"| {peer} | {n} | {cpu:.3g} | {wall:.3g} | {len(good)} | "
                    f"{100 * first['strain_max']:.1f} %{mark} | "
                    f"{100 * first['strain_any_frame']:.0f} % | {depth} | {first['peak_mb']:.0f} MB |",
                )
            )
        if rows:
            lines += [
                "",
                f"### {title}",
                "",
                "| | N | processor s per s | wall s per s | runs | largest strain, end | any frame | depth | memory |",
                "|---|---|---|---|---|---|---|---|---|",
                *(row for _, _, row in sorted(rows)),
            ]
    falls = [
        f"{peer} {first['fallen']:.4f} m"
        for (scene, _, peer), (first, *_) in groups.items()
        if scene == "fall" and "fallen" in first
    ]
    return [*lines, "", f"Free fall in 0.25 s (exact: 0.3066 m; symplectic Euler adds g t dt / 2): {', '.join(falls)}."]


def stencil(limit: dict[str, Any]) -> list[str]:
    """Ours beside the C program."""
    lines = ["", "## The limit of the chip", ""]
    if "failed" in limit:
        return [*lines, f"Not measured: {limit['failed']}."]
    ours = statistics.median(limit["ours"])
    if not limit["c"]:
        return [*lines, f"Ours: {ours:.2f} ns per spring and step. There is no gcc here to build the limit with."]
    one, two = (statistics.median(run[1] for run in limit["c"][threads]) for threads in ("1", "2"))
    wall = {threads: min(run[0] for run in limit["c"][threads]) for threads in ("1", "2")}
    return [
        *lines,
        f"Scene A at {limit['n']} x {limit['n']} with the springs of the C program `stencil_limit.c`: three families, "
        "12 neighbours, no damping. That program knows nothing but a grid, has no index, no rim and no pins. In turn, "
        "median of 5, float64:",
        "",
        "| | ns per spring and step, processor | wall, best |",
        "|---|---|---|",
        f"| C, 1 thread | {one:.2f} | {wall['1']:.2f} |",
        f"| C, 2 threads | {two:.2f} | {wall['2']:.2f} |",
        f"| `run_steps`, 1 thread | {ours:.2f} | |",
        "",
        f"Ours takes {ours / one:.2f} times as long per spring. With damped springs and true bending instead, as cloth "
        f"has them, a step takes {statistics.median(limit['ours_cloth_us']):.0f} us. On an idle core of such a machine "
        "the C program was measured at 0.80 to 0.84 ns on one thread and 0.42 to 0.45 on two.",
    ]


def first_use(runs: list[dict[str, Any]], again: str) -> list[str]:
    """What a user waits for before anything moves."""
    if not runs or "failed" in runs[0]:
        return []
    found = runs[0]
    return [
        "",
        "## First use",
        "",
        f"Wall time{measured(again)}. Importing `cloth_core` takes {found['import']:.2f} s and compiles nothing. "
        "`cloth-sim drape tshirt --body young --quality draft` has done its first 32 steps after "
        f"{found['next']:.1f} s, and after {found['first']:.0f} s where nothing has been compiled yet, as after an "
        "installation. " + FIRST_USE,
    ]


def measured(again: str) -> str:
    """When a part was measured, if not with all others."""
    return f", measured {again}" if again else ""


def slope(rows: list[dict[str, Any]], key: str) -> float:
    """Exponent of growth with the number of particles, by least squares on log axes."""
    return float(np.polyfit(np.log([r["particles"] for r in rows]), np.log([r[key] for r in rows]), 1)[0])


def grown(rows: list[dict[str, Any]], again: str) -> list[str]:
    """Time and memory over the number of particles; again: when they were measured by themselves."""
    rows = [row for row in rows if "failed" not in row]
    if len(rows) < 2:
        return []
    return [
        "",
        "## Growth",
        "",
        f"Scene A, processor time on one thread{measured(again)}. The time of a step grows with exponent "
        f"{slope(rows, 'step_us'):.2f} over all, {slope(rows[1:], 'step_us'):.2f} without the smallest, where calls "
        f"count most, and {slope(rows[-2:], 'step_us'):.2f} between the two largest: there the "
        "rows no longer fit the caches.",
        "",
        "| particles | step | per particle | estimate of the stable step | setting up | memory per particle |",
        "|---|---|---|---|---|---|",
        *(
            f"| {r['particles']:,} | {r['step_us']:.0f} us | {1e3 * r['step_us'] / r['particles']:.1f} ns | "
            f"{r['stable_step_us'] / 1e3:.1f} ms | {r['build_s']:.2f} s | "
            f"{1048.576 * r['mb'] / r['particles']:.2f} kB |"
            for r in rows
        ),
        "",
        "Memory is the largest that the process ever had, setting up included, above what it has before.",
    ]


def shares(profile: dict[str, Any]) -> list[str]:
    """Where the time of a step goes."""
    if "failed" in profile:
        return ["", "## Where the time of a step goes", "", f"Not measured: {profile['failed']}."]
    lines = ["", "## Where the time of a step goes", "", "Processor time of each kernel alone, in microseconds:", ""]
    names = list(profile)
    lines += ["| | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    kernels = dict.fromkeys(kernel for name in names for kernel in profile[name])
    for kernel in kernels:
        figures = [f"{profile[name][kernel]:.0f}" if kernel in profile[name] else "-" for name in names]
        lines.append(f"| {kernel} | " + " | ".join(figures) + " |")
    return [*lines, *NOTES.rstrip().split("\n")]


def drapes(rows: list[dict[str, Any]]) -> list[str]:
    """The T-shirt until rest."""
    lines = [
        "",
        "## C: T-shirt on the young woman until rest",
        "",
        "Cotton poplin, `settle()`; set-up of the simulation included, compilation not. None of the others reads a "
        "sewing pattern or sews; a comparison would be one of set-ups, so there is none. A case that was "
        "stopped includes compilation in its time limit.",
        "",
        "| spacing | particles | processor | wall | steps | simulated | at rest | strain | through body, self |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        if "failed" in r:
            lines.append(f"| {1000 * float(r['value']):g} mm | {r['failed']} ||||||||")
            continue
        through_body = r["body_intersections"] + r["body_edges_through_cloth"]
        lines.append(
            f"| {1000 * r['spacing']:g} mm | {r['particles']} | {r['processor']:.1f} s | {r['wall']:.1f} s | "
            f"{r['steps']} | {r['simulated']:.2f} s | {'yes' if r['settled'] else 'no'} | "
            f"{100 * r['max_strain']:.1f} % | {through_body}, {r['self_intersections']} |"
        )
    return lines


def picture(results: dict[str, Any], path: Path) -> None:
    """Cost over N for the scenes, and time of a step over the number of particles."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    groups = grouped(results["cases"])
    for axis, scene in zip(axes, ("hang", "sphere"), strict=False):
        peers = list(dict.fromkeys(peer for name, _, peer in groups if name == scene))
        for peer in peers:
            points = sorted(
                (n, statistics.median(run["processor_per_second"] for run in runs))
                for (name, n, who), runs in groups.items()
                if name == scene and who == peer and all("failed" not in run for run in runs)
            )
            if points:
                axis.loglog(*zip(*points, strict=True), "o-", label=peer, lw=2.5 if peer == OURS else 1.2)
        axis.axhline(1.0, color="grey", lw=0.8, ls=":")
        axis.set(title=TITLES[scene], xlabel="particles per side N", ylabel="processor s per simulated s")
        axis.set_xticks([32, 64, 128, 200], ["32", "64", "128", "200"])
        axis.minorticks_off()
        axis.legend(fontsize=8)
    rows = [row for row in results["growth"] if "failed" not in row]
    count = [row["particles"] for row in rows]
    axes[2].loglog(count, [row["step_us"] for row in rows], "o-", label="a step")
    axes[2].loglog(count, [row["stable_step_us"] for row in rows], "s--", label="estimate of the stable step")
    axes[2].set(title="Growth", xlabel="particles", ylabel="processor time [us]")
    axes[2].legend(fontsize=8)
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
