"""One scene in one simulator, in this process: run.py SCENE --peer NAME --n N --seconds S [--out result.json]

A short warm-up comes first (compilation, caches). The result is JSON. Repeats are made by `benchmarks/speed.py`, in
processes of their own and in turn with the others, so that a busy minute of the machine does not fall on one alone.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from peers import scenes


def value(text: str) -> Any:
    """A setting: JSON where it is that, else text."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def main() -> None:
    """Runs one case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=scenes.NAMES)
    parser.add_argument("--peer", required=True, help="cloth_sim, pypbd, pypbd_1, mujoco, mujoco_1, blender, ...")
    parser.add_argument("--n", type=int, default=64, help="particles per side")
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a simulator's own setting")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()

    module, _, variant = ("cloth_sim", "", "") if options.peer == "cloth_sim" else options.peer.partition("_")
    settings = {key: value(text) for key, text in (s.split("=", 1) for s in options.set)}
    peer = importlib.import_module(f"peers.peer_{module}")
    arguments = (variant,) if variant else ()
    peer.run(scenes.make(options.scene, options.n, 2 / scenes.FPS, settings), *arguments)
    result = peer.run(scenes.make(options.scene, options.n, options.seconds, settings), *arguments)
    del result["x"]
    result |= {"scene": options.scene, "peer": options.peer, "n": options.n, "seconds": options.seconds}
    result["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    result["load"] = os.getloadavg()[0]
    text = json.dumps(result, indent=1)
    if options.out:
        options.out.write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
