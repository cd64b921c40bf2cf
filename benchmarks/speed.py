"""Ours and other simulators on the same scenes: `python benchmarks/speed.py [-o docs/speed.md]`; one run, one page.

Every case runs in a process of its own; in each round all cases come once, so that a busy minute does not fall on one
simulator alone. Others run with the interpreter of an environment of their own (`make peers` makes .venv-peers); those
that it lacks are left out. Raw results are kept in --results; with --page-only only the page is written from them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from speed_page import write_page

HERE = Path(__file__).parent
OURS = "cloth_sim"
SCENES = ("hang", "sphere", "selfcontact")
# What has no contact of cloth with cloth.
WITHOUT_SELF_CONTACT = ("pypbd", "pypbd_1")


def main() -> None:
    """Runs all cases and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/speed.md"))
    parser.add_argument("--results", type=Path, default=Path("build/speed.json"))
    parser.add_argument("--page-only", action="store_true")
    parser.add_argument(
        "--again",
        default="",
        help="measure only these again: limit, growth, profile, drape, first; sphere/32, all at that size",
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--peers", default="pypbd,pypbd_1,mujoco", help="others, comma between; see peers/README.md")
    parser.add_argument("--peer-python", type=Path, default=Path(".venv-peers/bin/python"))
    parser.add_argument("--sizes", default="32,64", help="particles per side for the others")
    parser.add_argument("--our-sizes", default="32,64,128,200")
    parser.add_argument("--our-contact-sizes", default="32,64,128,200", help="the same where there is contact")
    parser.add_argument("--spacings", default="0.02,0.015,0.01", help="of the T-shirt [m]")
    parser.add_argument("--growth", default="32,64,128,256,512")
    parser.add_argument("--timeout", type=float, default=400.0, help="longest case [s]")
    options = parser.parse_args()
    if options.again:
        results = json.loads(options.results.read_text())
        again = options.again.split(",")
        for part in (part for part in again if "/" in part):
            results["cases"] = [case for case in results["cases"] if f"{case['scene']}/{case['n']}" != part]
            results.setdefault("again", {})[part] = time.strftime("%Y-%m-%d %H:%M")
            measure_cases(results, options, [case for case in cases_of(options) if f"{case[0]}/{case[2]}" == part])
        parts = measure_parts(results, options, [part for part in again if "/" not in part])
        results["again"] = {**results.get("again", {}), **parts}
        options.results.write_text(json.dumps(results, indent=1))
    elif not options.page_only:
        options.results.parent.mkdir(parents=True, exist_ok=True)
        options.results.write_text(json.dumps(measure(options), indent=1))
    write_page(json.loads(options.results.read_text()), options.output)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All results as JSON types."""
    results: dict[str, Any] = {
        "machine": f"{os.cpu_count()} cores, {processor()}, {platform.system()}, Python {platform.python_version()}",
        "began": time.strftime("%Y-%m-%d %H:%M"),
        "load": [os.getloadavg()[0]],
        "cases": [],
    }
    cases = cases_of(options)
    compile_ours()
    measure_cases(results, options, cases)
    measure_parts(results, options, ("limit", "growth", "profile", "drape", "first"))
    return results


def cases_of(options: argparse.Namespace) -> list[tuple[str, str, int]]:
    """Scene, simulator and particles per side of each case."""
    sizes = {scene: options.our_sizes if scene == "hang" else options.our_contact_sizes for scene in SCENES}
    cases = [(scene, OURS, int(n)) for scene in SCENES for n in sizes[scene].split(",")]
    others = [peer for peer in options.peers.split(",") if peer]
    if others and not options.peer_python.exists():
        print(f"{options.peer_python}: not there; run `make peers` to compare with others")
        others = []
    for peer in others:
        for scene in SCENES:
            if scene != "selfcontact" or peer not in WITHOUT_SELF_CONTACT:
                cases += [(scene, peer, int(n)) for n in options.sizes.split(",")]
    cases.sort(key=lambda case: (SCENES.index(case[0]), case[2]))
    cases += [("fall", peer, 64) for peer in (OURS, *others)]
    return cases


def compile_ours() -> None:
    """Runs ours once in each scene: what has not been compiled yet would count as time of the first case."""
    for scene in SCENES:
        run(
            [sys.executable, str(HERE / "peers" / "run.py"), scene, "--peer", OURS, "--n", "32", "--seconds", "2"],
            600.0,
        )


def measure_cases(results: dict[str, Any], options: argparse.Namespace, cases: list[tuple[str, str, int]]) -> None:
    """Measures the cases into the results."""
    too_slow = set()
    for number in range(options.rounds):
        for scene, peer, n in cases:
            if (scene, peer, n) in too_slow:
                continue
            seconds = "0.25" if scene == "fall" else "2"
            python = sys.executable if peer == OURS else str(options.peer_python)
            command = [python, str(HERE / "peers" / "run.py"), scene, "--peer", peer, "--n", str(n)]
            case = {"scene": scene, "peer": peer, "n": n}
            found = run([*command, "--seconds", seconds], options.timeout)
            if isinstance(found, str):
                too_slow.add((scene, peer, n))
                found = {**case, "failed": found}
            results["cases"].append(found)
            print(f"round {number + 1}: {scene} {peer} {n}: {found.get('processor_per_second', found.get('failed'))}")


def measure_parts(results: dict[str, Any], options: argparse.Namespace, parts: Sequence[str]) -> dict[str, str]:
    """Measures our own parts into the results; when each was begun."""
    arguments = {
        "limit": [["limit"]],
        "growth": [["growth", n] for n in options.growth.split(",")],
        "profile": [["profile"]],
        "drape": [["drape", spacing] for spacing in options.spacings.split(",")],
        "first": [["first"]],
    }
    began = {}
    for key in parts:
        began[key] = time.strftime("%Y-%m-%d %H:%M")
        results[key] = []
        for each in arguments[key]:
            found = run([sys.executable, str(HERE / "step_speed.py"), *each], options.timeout)
            results[key].append({"failed": found, "value": each[-1]} if isinstance(found, str) else found)
            print(" ".join(each), "" if not isinstance(found, str) else found)
            results["load"].append(os.getloadavg()[0])
    return began


def run(command: list[str], timeout: float) -> dict[str, Any] | str:
    """The JSON that a command prints, or why there is none."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return f"stopped after {timeout:g} s"
    if done.returncode != 0:
        return (done.stderr.strip().splitlines() or ["no message"])[-1]
    text = done.stdout
    found: dict[str, Any] = json.loads(text[text.index("{") :])
    return found


def processor() -> str:
    """The processor's name."""
    for line in Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else ():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.processor()


if __name__ == "__main__":
    main()
