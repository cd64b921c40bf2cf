"""On a first start another process compiles what the steps of this one will take, and never outlives it."""

import os
import subprocess
import sys

import pytest
import trimesh
from apparatus import body_of, sheet

from cloth_core import first_start
from cloth_core.contact import _narrow_phase  # the search's longest function to compile
from cloth_core.fabric import Fabric
from cloth_core.first_start import compile_beside, compile_steps, is_first_start
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation
from cloth_core.step import run_steps


def test_what_is_compiled_ahead_is_what_a_scene_takes():
    compile_steps()
    ahead = [set(function.signatures) for function in (run_steps, _narrow_phase)]
    ball = body_of(trimesh.creation.icosphere(2, radius=0.1))
    simulation = Simulation(Scene(garment=sheet(0.25, 0.25, 0.05, z=0.105), body=ball, fabric=Fabric.preset("wool")))
    simulation.tick()
    assert len(simulation.motion.contacts.planes.body_triangle) > 0
    for function, signatures in zip((run_steps, _narrow_phase), ahead, strict=True):
        assert set(function.signatures) == signatures


def test_it_ends_with_its_parent():
    wait = "from cloth_core.first_start import end_with_parent; end_with_parent(); print('up', flush=True); import time"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{wait}; time.sleep(60)"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "up\n"
    process.stdin.close()
    assert process.wait(10) == 0
    process.stdout.close()


def test_no_other_process_is_started_where_steps_are_compiled(monkeypatch):
    compile_steps()
    assert not is_first_start()
    monkeypatch.setattr(subprocess, "Popen", None)
    compile_beside()
    assert not first_start._beside


@pytest.fixture
def started(monkeypatch) -> list[list[str]]:
    """Commands of the processes that would have been started."""
    commands: list[list[str]] = []
    monkeypatch.setattr(first_start, "_beside", [])
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: commands.append(command))
    return commands


def test_an_import_compiles_nothing_so_that_the_start_after_it_is_the_first(tmp_path):
    look = "import cloth_core.step; from cloth_core.first_start import is_first_start; print(is_first_start())"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "imported")}
    asked = subprocess.run([sys.executable, "-c", look], env=environment, capture_output=True, text=True, check=True)
    assert asked.stdout == "True\n"
    assert any((tmp_path / "imported").iterdir())


def test_an_empty_cache_is_a_first_start(monkeypatch, tmp_path, started):
    monkeypatch.setattr(first_start, "cache_directory", lambda module: tmp_path / "cache")
    assert is_first_start()
    compile_beside()
    assert len(started) == 1
    assert "compile_steps()" in started[0][-1]


def test_no_other_process_is_started_where_nothing_can_be_kept(monkeypatch, tmp_path, started):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(first_start, "cache_directory", lambda module: tmp_path / "file" / "cache")
    compile_beside()
    assert not started
