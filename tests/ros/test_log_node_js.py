"""Logs in Node.js: @mcap/core and Foxglove's own decoders read what was simulated."""

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.run_recorder import RunRecorder
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation

PACKAGES = {
    "@mcap/core": "2.2.2",
    "@foxglove/rosmsg": "5.0.5",
    "@foxglove/rosmsg2-serialization": "3.1.0",
    "fzstd": "0.1.1",
}
LONGEST_INSTALLATION = 60
"""[s]."""


@pytest.fixture(scope="module")
def node_folder(request):
    """A folder in which Node.js finds the packages; kept from run to run in pytest's cache."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("reading with @mcap/core needs Node.js and npm, which are not installed")
    if int(subprocess.check_output(["node", "--version"], text=True).strip("v\n").split(".")[0]) < 18:
        pytest.skip("reading with @mcap/core needs Node.js 18 or newer")
    folder = Path(request.config.cache.mkdir("mcap_node_js"))
    manifest = json.dumps({"private": True, "dependencies": PACKAGES}, indent=2)
    installed = folder / "installed.json"
    if not installed.exists() or installed.read_text() != manifest:
        (folder / "package.json").write_text(manifest)
        command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--silent"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LONGEST_INSTALLATION)
        except subprocess.TimeoutExpired:
            pytest.skip(f"npm did not install @mcap/core within {LONGEST_INSTALLATION} s; is its registry reachable?")
        if done.returncode:
            reason = (done.stderr.strip() or "no reason given").splitlines()[0]
            pytest.skip(f"npm cannot install @mcap/core from its registry: {reason}")
        installed.write_text(manifest)
    shutil.copy(Path(__file__).with_name("read_log.mjs"), folder)
    return folder


def sha256(data):
    return hashlib.sha256(data).hexdigest()


def test_mcap_core_reads_every_message(node_folder, tmp_path):
    path = tmp_path / "run.mcap"
    pattern = Pattern.from_json(handkerchief(), "handkerchief")
    scene = Scene.build(pattern, Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES, "box"), quality="draft")
    simulation = ScheduledSimulation(scene)
    frames = []

    class Spy(RunRecorder):
        def frame(self, simulated_time, positions, triangles):
            frames.append(sha256(positions[triangles].tobytes()))
            super().frame(simulated_time, positions, triangles)

    with Spy(path, [pattern.source], scene.body, {}, patterns=[pattern], scene=scene) as recorder:
        recorder.follow(simulation)
        simulation.advance(0.3, recorder.follow)
        report = simulation.report()
        recorder.finish(simulation, report)

    done = subprocess.run(["node", "read_log.mjs", path], cwd=node_folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["profile"] == "ros2"
    expected = {}
    with LogReader(path) as log:
        for message in log.messages():
            expected.setdefault(message.topic, []).append([str(message.log_time), sha256(message.data)])
    assert {name: [m[:2] for m in topic["messages"]] for name, topic in content["topics"].items()} == expected

    def essences(name):
        return [message[2] for message in content["topics"][name]["messages"]]

    assert essences("/cloth_sim/garment") == frames
    assert len(frames) > 8
    assert essences("/cloth_sim/pattern") == [sha256(pattern.source.encode())]
    assert essences("/cloth_sim/body") == [sha256(BOX_VERTICES.tobytes())]
    assert essences("/cloth_sim/body_marker") == [sha256(np.ascontiguousarray(BOX_VERTICES[BOX_TRIANGLES]).tobytes())]
    assert essences("/cloth_sim/report") == [sha256(report.to_json().encode())]
    assert set(essences("/diagnostics")) == {"cloth_sim: simulation"}
    assert "durability: 1" in content["topics"]["/cloth_sim/garment"]["qos"]
