"""The command `cloth-sim`. What is heavy is imported by the command that needs it, so that `--help` is quick."""

from __future__ import annotations

import functools
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from cloth_core.errors import ClothError, SimulationError
from cloth_sim_ros.command_values import OutputFile, PictureSize, Quantity
from cloth_sim_ros.run_progress import Interruption, ProgressDisplay
from cloth_sim_ros.stability_command import stability

if TYPE_CHECKING:
    from cloth_core.pattern import Pattern
    from cloth_core.report import Report
    from cloth_core.simulation import Simulation
    from cloth_sim_ros.log_writer import LogError
    from cloth_sim_ros.run_recorder import RunRecorder

__all__ = ["main"]

FAILED_RUN = 1
BAD_INPUT = 2

Command = TypeVar("Command", bound=Callable[..., Any])


class FailedRun(ClothError):
    """The input was good, but the run did not end as it should."""


def _scene_options(command: Command) -> Command:
    """PATTERN and the options that make a scene."""
    options = (
        click.argument("patterns", metavar="PATTERN...", nargs=-1, required=True),
        click.option(
            "--body",
            metavar="BODY",
            help="What the garment is draped on: a built-in body (young, middle_aged, elderly) or a mesh file (PLY, "
            "OBJ and STL in metres, z up; GLB in metres, y up). Without it the garment has nothing to rest on.",
        ),
        click.option(
            "--fabric",
            metavar="NAME",
            default="cotton_poplin",
            show_default=True,
            help="silk, cotton_poplin, denim, wool, jersey, polyester, linen, leather or paper (the founding one).",
        ),
        click.option(
            "--quality",
            type=click.Choice(["draft", "normal", "fine"]),
            help="Speed against accuracy.  [default: normal]",
        ),
        click.option(
            "--tolerance",
            type=Quantity("mm", above=True),
            help="Instead of a quality: the largest error, in millimetres.",
        ),
        click.option(
            "--gravity", type=Quantity("m/s^2"), default=9.80665, show_default=True, help="Downward acceleration."
        ),
        click.option(
            "--air-drag",
            type=Quantity("1/s"),
            default=1.0,
            show_default=True,
            help="Air drag k_a: deceleration per velocity.",
        ),
        click.option(
            "--without",
            multiple=True,
            metavar="TERM",
            help="Switches a term off by hand, for example 'self contact'; the report says what the run then lacks. "
            "May be given several times.",
        ),
        click.option(
            "--max-time",
            type=Quantity("s", above=True),
            help="Simulated time after which a run is given up that has not come to rest.  [default: 20]",
        ),
    )
    return functools.reduce(lambda decorated, option: option(decorated), reversed(options), command)


# Commands


@click.group(no_args_is_help=False, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="cloth_sim_ros", prog_name="cloth-sim")
def cli() -> None:
    """Drapes garments: sewing pattern and body in, cloth at rest, log and pictures out.

    Exit code 0: done. 1: the run failed or did not come to rest. 2: bad input.
    """


@cli.command()
@_scene_options
@click.option(
    "--output",
    "-o",
    type=OutputFile([".glb", ".obj", ".ply"]),
    help="The garment: GLB (y up), OBJ or PLY (z up), in metres.",
)
@click.option("--record", type=OutputFile([".mcap"]), help="The whole run as a log (MCAP, ros2 profile).")
@click.option("--picture", type=OutputFile([".png"]), help="Front and back view (PNG).")
@click.option("--size", type=PictureSize(), default="1600x1000", show_default=True, help="Of the picture, in pixels.")
@click.option("--report", type=OutputFile([".json"]), help="Numbers of the run (JSON, SI units).")
@click.option(
    "--gate",
    is_flag=True,
    help="Judges the result: nothing through body or cloth, static, in time. Exit code 1 if it fails.",
)
def drape(
    patterns: tuple[str, ...],
    output: Path | None,
    record: Path | None,
    picture: Path | None,
    size: tuple[int, int],
    report: Path | None,
    gate: bool,
    **scene_options: Any,
) -> None:
    """Sews PATTERN together around the body and lets it come to rest.

    PATTERN is a GarmentCode pattern (JSON file) or a built-in one: tshirt, skirt, trousers, dress, rectangle. Several
    are worn over each other, the innermost first. Ctrl-C stops the run and writes what there is.
    """
    from cloth_sim_ros.run_tables import print_report

    outputs = [path for path in (output, record, picture, report) if path is not None]
    _check_inputs_are_kept((*patterns, scene_options["body"]), outputs)
    with ProgressDisplay() as display:
        loaded, simulation, parameters = _prepare(display, patterns, **scene_options)
        try:
            recorder = _recorder(record, loaded, simulation, parameters)
            with Interruption() as interruption:
                result, lost = _settle(simulation, recorder, display, interruption, gate=gate)
                _write_results(simulation, result, display, output=output, picture=picture, size=size, report=report)
        except ClothError as error:
            raise FailedRun(str(error)) from error
    _warn(result.warnings)
    print_report(result)
    for path in outputs:
        if path != record or lost is None:
            click.echo(f"wrote {path}")
    if lost is not None:
        raise FailedRun(f"recording stopped: {lost}")
    if result.gate is not None and not result.gate["passed"]:
        raise FailedRun(f"{result.garment}: the gate is not passed: {'; '.join(result.gate['failed'])}")
    if result.open_seams:
        gaps = ", ".join(f"{name} ({1000 * gap:.1f} mm)" for name, gap in result.open_seams.items())
        raise FailedRun(f"seams still open: {gaps}; check that the panels can reach each other around the body")
    if not result.settled:
        raise FailedRun(f"{result.garment}: {result.rest_reason}")


@cli.command()
@_scene_options
@click.option("--json", "as_json", is_flag=True, help="Everything as JSON, SI units.")
def explain(patterns: tuple[str, ...], as_json: bool, **scene_options: Any) -> None:
    """Says what a run of PATTERN would consist of: terms with reasons, counts, time step, cost. Nothing is run."""
    from cloth_sim_ros.run_tables import print_explanation

    with ProgressDisplay() as display:
        _, simulation, _ = _prepare(display, patterns, **scene_options)
        display.step("measuring what a step costs")
        facts = _explanation(simulation)
    if as_json:
        click.echo(json.dumps(facts, indent=2, allow_nan=False))
        return
    _warn(facts["warnings"])
    print_explanation(facts)


@cli.command()
@click.argument("log", metavar="RUN.mcap")
@click.option(
    "--output",
    "-o",
    type=OutputFile([".png", ".gif", ".mp4"]),
    required=True,
    help="PNG: the last frame. GIF, MP4: a film.",
)
@click.option("--size", type=PictureSize(), help="In pixels.  [default: 1600x1000 for PNG, 960x640 for films]")
@click.option(
    "--view",
    "views",
    multiple=True,
    default=("front", "back"),
    show_default=True,
    metavar="NAME",
    help="Side to look from: front, back, left, right or three_quarter. Given several times, they stand side by side.",
)
@click.option(
    "--frame-rate", type=Quantity("1/s", above=True), default=25.0, show_default=True, help="Frames a second of a film."
)
def render(log: str, output: Path, size: tuple[int, int] | None, views: tuple[str, ...], frame_rate: float) -> None:
    """Draws the log RUN.mcap: its end as a picture, or all of it as a film in simulated time."""
    from cloth_sim_ros.render import render_log

    with ProgressDisplay() as display:
        display.step(f"reading {log}")
        render_log(
            log,
            output,
            views=views,
            size=size,
            frame_rate=frame_rate,
            progress=functools.partial(display.share, "drawing frame {done} of {total}"),
        )
    click.echo(f"wrote {output}")


@cli.command()
@click.argument("log", metavar="RUN.mcap")
@click.option("--rate", type=Quantity("factor", above=True), default=1.0, show_default=True, help="2 is twice as fast.")
@click.option("--loop", is_flag=True, help="Starts again at the end, until Ctrl-C.")
def play(log: str, rate: float, loop: bool) -> None:
    """Publishes the log RUN.mcap on ROS topics in its own time. Needs ROS 2 (rclpy)."""
    try:
        from cloth_sim_ros.play import play_log
    except ModuleNotFoundError as error:
        raise ClothError(
            f"play: {error.name} is not installed; source a ROS 2 installation or `pip install 'cloth_sim_ros[ros]'`"
        ) from None
    with ProgressDisplay() as display:
        display.step(f"playing {log}")
        play_log(log, rate=rate, loop=loop, progress=functools.partial(display.share, "{done} s of {total} s played"))


@cli.command()
@click.argument("log", metavar="RUN.mcap")
@click.option("--verify", is_flag=True, help="Checks each byte of the log and compares all frames and reports with it.")
def replay(log: str, verify: bool) -> None:
    """Simulates the runs of the log RUN.mcap again, from what is in the log alone.

    Exit code with --verify. 0: each frame and report is identical, bit by bit. 1: one is not; the error says which
    frame and particle differ first. 2: the log is damaged; the error says where.
    """
    from cloth_sim_ros.replay import ReplayDifference, replay_log, verify_log
    from cloth_sim_ros.run_tables import print_report

    with ProgressDisplay() as display:
        display.step(f"simulating {log} again")

        def on_tick(simulation: Simulation) -> None:
            display.show(simulation.progress)

        if not verify:
            reports = replay_log(log, on_tick)
        else:
            try:
                found = verify_log(log, on_tick)
            except ReplayDifference as error:
                raise FailedRun(str(error)) from None
    if not verify:
        for report in reports:
            print_report(report)
        return
    click.echo(
        f"{log}: identical: {found.frames} frames with {found.particles} positions and {found.reports} reports of "
        f"{found.runs} run{'s' * (found.runs > 1)}, {found.simulated_time:.3f} s simulated"
        f"{f', state_sha256 {found.state_sha256}' if found.state_sha256 else ''}"
    )


@cli.command()
@click.argument("broken", metavar="BROKEN.mcap")
@click.option("--output", "-o", type=OutputFile([".mcap"]), required=True, help="The log that is made of it.")
def recover(broken: str, output: Path) -> None:
    """Saves all whole chunks of BROKEN.mcap, the log of a process that was killed: all but its last second at most.

    BROKEN.mcap is only read.
    """
    from cloth_sim_ros.log_repair import recover_log

    _check_inputs_are_kept((broken,), (output,))
    found = recover_log(broken, output)
    state = "it was whole" if found.was_whole else f"{found.lost_bytes} bytes behind or between them are lost"
    click.echo(f"wrote {output}: {found.messages} messages of {found.duration:.3f} s in {found.chunks} chunks; {state}")


@cli.command()
@_scene_options
@click.option("--output", "-o", metavar="DIR", required=True, help="Directory of the results; a rerun goes on in it.")
@click.option(
    "--spacings",
    metavar="MM,MM,...",
    help="Particle spacings to try, at least three; the finest is the reference.  [default: 40,30,25,20,15,12.5,10]",
)
@click.option(
    "--vary",
    metavar="NAME,...",
    help="Settings to vary besides the spacing: safety, contact, push, rest, drag, integrator; 'none' for none.  "
    "[default: all]",
)
@click.option("--processes", type=click.IntRange(1, 1024), help="Runs at once.  [default: one for each core]")
def tradeoff(patterns: tuple[str, ...], **options: Any) -> None:
    """Measures cost against error over settings for PATTERN, and says which is the cheapest that is good enough.

    Writes tradeoff.json, tradeoff.md and (with matplotlib) tradeoff.png. Can be stopped with Ctrl-C at any time and
    goes on with the same command. --tolerance is the error that the advice is for.
    """
    from cloth_sim_ros.tradeoff_command import run_tradeoff

    run_tradeoff(patterns, **options)


cli.add_command(stability)


# Parts of commands


def _check_inputs_are_kept(inputs: Iterable[str | None], outputs: Iterable[Path]) -> None:
    """Refuses to write over what is read."""
    read = {Path(name).resolve() for name in inputs if name is not None}
    for path in outputs:
        if path.resolve() in read:
            raise ClothError(f"'{path}' is both read and written; choose another name for the output")


def _prepare(
    display: ProgressDisplay,
    names: Sequence[str],
    *,
    body: str | None,
    fabric: str,
    quality: str | None,
    tolerance: float | None,
    gravity: float,
    air_drag: float,
    max_time: float | None,
    without: tuple[str, ...],
) -> tuple[list[Pattern], Simulation, dict[str, object]]:
    """The patterns, a simulation of their scene, and the parameters that repeat it."""
    if quality is not None and tolerance is not None:
        raise ClothError("--quality and --tolerance exclude each other; give one of them")
    display.step(f"reading {', '.join([*names, *([body] if body else [])])}")
    from cloth_core.first_start import compile_beside

    compile_beside()
    from dataclasses import asdict, replace

    from cloth_core.body import Body
    from cloth_core.fabric import Fabric
    from cloth_core.pattern import Pattern
    from cloth_core.scene import Scene
    from cloth_sim_ros.scene_inputs import SceneParameters
    from cloth_sim_ros.scheduled_simulation import ScheduledSimulation

    parameters = SceneParameters(
        fabric=fabric, quality=quality or "normal", tolerance=tolerance or 0.0, gravity=gravity, air_drag=air_drag
    )
    chosen_fabric = Fabric.preset(fabric)
    patterns = [Pattern.load(name) for name in names]
    settings = parameters.settings(*patterns)
    if max_time is not None:
        settings = replace(settings, max_time=max_time)
    chosen_body = None if body is None else Body.load(body)
    display.step("preparing the scene (the first run after an installation compiles, which takes longer)")
    scene = Scene.build(
        patterns, chosen_body, chosen_fabric, settings=settings, gravity=gravity, air_drag=air_drag, without=without
    )
    values = {**parameters.to_dict(), "settings": asdict(settings), "without": without}
    return patterns, ScheduledSimulation(scene), values


def _recorder(
    path: Path | None, patterns: Sequence[Pattern], simulation: Simulation, parameters: dict[str, object]
) -> RunRecorder | None:
    """A new log in place of the one that may lie there."""
    if path is None:
        return None
    from cloth_sim_ros.log_writer import is_being_written
    from cloth_sim_ros.run_recorder import RunRecorder

    if is_being_written(path):
        raise ClothError(f"log {path}: another process is recording into it; choose another name")
    path.unlink(missing_ok=True)
    scene = simulation.scene
    texts = [pattern.source for pattern in patterns]
    return RunRecorder(path, texts, scene.body, parameters, patterns=patterns, scene=scene)


def _settle(
    simulation: Simulation,
    recorder: RunRecorder | None,
    display: ProgressDisplay,
    interruption: Interruption,
    *,
    gate: bool,
) -> tuple[Report, LogError | None]:
    """Runs to rest, to the longest time or to Ctrl-C, and records meanwhile; judges the result if asked to.

    The second value is what ended the recording early, if anything did.
    """
    from cloth_sim_ros.log_writer import LogError

    lost: LogError | None = None

    def record(write: Callable[[RunRecorder], None]) -> None:
        nonlocal lost
        if recorder is None or lost is not None:
            return
        try:
            write(recorder)
        except LogError as error:  # a full disk is no reason to lose the drape too
            lost = error
            _warn([f"recording stopped: {error}"])

    def on_tick(simulation: Simulation) -> bool:
        record(lambda recorder: recorder.follow(simulation))
        display.show(simulation.progress)
        return interruption.asked

    display.step("sewing and draping")
    try:
        record(lambda recorder: recorder.follow(simulation))
        failure = None
        try:
            result = simulation.settle(on_tick)
        except SimulationError as error:
            if not gate:
                raise
            failure = str(error)
            result = simulation.report(f"failed: {failure}")
        display.step("measuring the result")
        if gate:
            result = _judged(simulation, result, failure)
        record(lambda recorder: recorder.finish(simulation, result))
    finally:
        record(lambda recorder: recorder.close())
    return result, lost


def _judged(simulation: Simulation, result: Report, failure: str | None) -> Report:
    """The report with the gate's verdict."""
    from dataclasses import replace

    from cloth_core.gate import frame_movement, judge

    movement = None
    if failure is None:
        try:
            movement = frame_movement(simulation)
        except SimulationError as error:
            failure = str(error)
    return replace(result, gate=judge(result, movement, failure))


def _write_results(
    simulation: Simulation,
    result: Report,
    display: ProgressDisplay,
    *,
    output: Path | None,
    picture: Path | None,
    size: tuple[int, int],
    report: Path | None,
) -> None:
    from cloth_core.mesh_files import write_file, write_mesh

    if report is not None:
        write_file(report, (result.to_json() + "\n").encode())
    if output is not None:
        write_mesh(output, *simulation.sewn_mesh())
    if picture is not None:
        from cloth_core.picture import draw
        from cloth_sim_ros.run_messages import GARMENT_COLOR

        display.step("drawing the picture")
        body = simulation.scene.body
        state = "at rest" if result.settled else "not at rest"
        draw(
            picture,
            [(*simulation.sewn_mesh(), GARMENT_COLOR[:3])],
            None if body is None else (body.vertices, body.triangles),
            size=size,
            caption=f"{result.garment} on {result.body or 'no body'}, {result.fabric}: {state} after "
            f"{result.simulated_time:.2f} s, strain up to {100 * result.max_strain:.1f} %",
        )


def _explanation(simulation: Simulation) -> dict[str, Any]:
    """`Simulation.describe` and the cost of a step, measured on copies of the start."""
    facts = simulation.describe()
    per_step = 1e-6 * sum(term["microseconds_per_step"] or 0.0 for term in facts["terms"].values())
    per_second = per_step / facts["time_step"]
    return {**facts, "seconds_per_step": per_step, "seconds_per_simulated_second": per_second}


def _warn(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(f"cloth-sim: warning: {line}", err=True)


# Errors and exit codes


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; the exit code."""
    try:
        cli.main(args=None if arguments is None else list(arguments), prog_name="cloth-sim", standalone_mode=False)
    except click.UsageError as error:
        where = "cloth-sim" if error.ctx is None else error.ctx.command_path
        return _complain(f"{error.format_message()} (see {where} --help)", BAD_INPUT)
    except (FailedRun, SimulationError) as error:
        return _complain(str(error), FAILED_RUN)
    except ClothError as error:
        return _complain(str(error), BAD_INPUT)
    except (KeyboardInterrupt, click.Abort):
        return _complain("stopped", FAILED_RUN)
    except BrokenPipeError:
        # Whoever read the output has had enough; nothing is left to be flushed at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED_RUN
    except Exception as error:  # a defect of the simulator: still one line, with the place to look at
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return _complain(f"defect at {where}: {type(error).__name__}: {error}; please report it", FAILED_RUN)
    return 0


def _complain(line: str, code: int) -> int:
    click.echo(f"cloth-sim: error: {' '.join(line.split())}", err=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
