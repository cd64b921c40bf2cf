"""Compiles on a second core what steps take, while a first start on a machine compiles what comes before them.

Both take about as long. What one process has compiled, the other one finds in the cache.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import numpy as np

from cloth_core.kernel import cache_directory

__all__ = ["compile_beside", "compile_steps", "end_with_parent", "is_first_start"]

_beside: list[subprocess.Popen[bytes]] = []


def is_first_start() -> bool:
    """Whether steps have not been compiled on this machine."""
    # An import makes the directory; numba writes this index once the function has been compiled to the end.
    return next(cache_directory("cloth_core.step").rglob("step.run_steps-*.nbi"), None) is None


def compile_beside() -> None:
    """On a first start, let another process compile what steps take; it ends with this one at the latest."""
    if not is_first_start():
        return
    try:
        cache_directory("cloth_core.step").mkdir(parents=True, exist_ok=True)
    except OSError:  # nothing can be kept: it would work for nobody
        return
    command = "from cloth_core.first_start import end_with_parent, compile_steps; end_with_parent(); compile_steps()"
    quiet = subprocess.DEVNULL
    # Kept here, or else its input would be closed.
    _beside.append(subprocess.Popen([sys.executable, "-c", command], stdin=subprocess.PIPE, stdout=quiet, stderr=quiet))


def end_with_parent() -> None:
    """End this process when its input is closed, which happens however its parent ends."""

    def wait() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


def compile_steps() -> None:
    """Compile steps, and what a search measures, by taking none of them with one particle and nothing that acts."""
    from cloth_core.contact import Contact
    from cloth_core.contact_state import ContactSettings, ContactState
    from cloth_core.runs import find_runs
    from cloth_core.sewing import SeamPull
    from cloth_core.step import ForceTerms, Workspace, run_steps
    from cloth_core.strain_limit import no_strain_limit

    one, x, v = np.ones(1), np.zeros((1, 3)), np.zeros((1, 3))
    floats, points = np.zeros(0), np.zeros((0, 3))
    pairs, triples, fours = (np.zeros((0, k), dtype=np.int32) for k in (2, 3, 4))
    terms = ForceTerms(
        mass=one, inverse_mass=one, gravity=np.zeros(3), air_drag=0.0,
        springs=find_runs(pairs, np.zeros((0, 2))), spring_damping_time=0.0,
        trellis=find_runs(fours, np.zeros((0, 1))), lines=find_runs(triples, np.zeros((0, 1))),
        twists=find_runs(fours, np.zeros((0, 1))), hinges=fours, hinge_weights=np.zeros((0, 4)),
        hinge_stiffness=floats, bending_damping_time=0.0, seam=SeamPull(pairs, floats, floats, floats, 0.0, 0.0),
        strain_limit=no_strain_limit(),
    )  # fmt: skip
    settings = ContactSettings(
        active=True, body_vertices=points, body_velocity=points, body_triangles=triples, body_way=0.0, offset=0.003,
        friction=0.0, push_speed=0.5,
    )  # fmt: skip
    run_steps(x, v, Workspace.of(1), np.zeros(1), terms, settings, ContactState.none(), 1e-4, 0, 0.0, 0.0)
    Contact(np.zeros((1, 3), dtype=np.int32), None).search(x, 0.001)
