"""What a node loads before it serves is all that its first garment takes."""

import subprocess
import sys

SCRIPT = """
import sys
from pathlib import Path
from cloth_sim_ros.warm_up import warm_up
import cloth_sim_ros.node

def loaded():
    # Imported modules, and signatures for which kernels have been compiled or taken from the cache.
    modules = dict(sys.modules)
    kernels = {
        f"{name}.{key}: {signature}"
        for name, module in modules.items()
        if name.startswith("cloth_core.")
        for key, value in vars(module).items()
        for signature in getattr(value, "signatures", ())
    }
    return set(modules) | kernels

if sys.argv[1] == "warm":
    warm_up()
before = loaded()
from cloth_core.body import Body
from cloth_core.mesh_files import write_mesh
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import Scene
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation
scene = Scene.build(Pattern.load("tshirt"), Body.load("young"), settings=Settings(spacing=0.04))
simulation = ScheduledSimulation(scene)
simulation.tick()
simulation.advance(0.02)
simulation.report().to_json()
write_mesh(Path(sys.argv[2]) / "garment.glb", *simulation.sewn_mesh())
print(len(loaded() - before), sorted(loaded() - before)[:10])
"""


def loaded_late(how, directory):
    command = [sys.executable, "-c", SCRIPT, how, str(directory)]
    count, names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split(" ", 1)
    return int(count), names


def test_nothing_is_imported_or_compiled_while_a_node_serves(tmp_path):
    assert loaded_late("cold", tmp_path)[0] > 50  # the script does import something
    assert loaded_late("warm", tmp_path) == (0, "[]\n")
