"""The node and a DDS stack that has nothing to do with ROS: Cyclone DDS sends the inputs and receives the results."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from node_client import NodeProcess
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_core.simulation import Simulation

pytest.importorskip("cyclonedds", reason="cyclonedds has wheels for Linux on x86-64 alone")

PEER = Path(__file__).with_name("cyclone_peer.py")


def sha256(points):
    return hashlib.sha256(np.ascontiguousarray(points).tobytes()).hexdigest()


def test_cyclone_dds_sends_a_scene_and_receives_the_drape_also_as_a_late_joiner(tmp_path):
    pattern, body = tmp_path / "pattern.json", tmp_path / "body.npz"
    pattern.write_text(handkerchief())
    np.savez(body, vertices=BOX_VERTICES, triangles=BOX_TRIANGLES)
    first, late = tmp_path / "first.json", tmp_path / "late.json"
    # The peer is there first, so that the node, too, is a late joiner.
    peer = subprocess.Popen([sys.executable, PEER, first, pattern, body], stdout=subprocess.PIPE, text=True)
    assert peer.stdout.readline() == "published\n"
    node = NodeProcess(tmp_path, auto_start=True)
    try:
        assert peer.wait(150) == 0
        assert subprocess.run([sys.executable, PEER, late], timeout=150).returncode == 0
        assert node.end() == 0
    finally:
        peer.kill()
        peer.wait()
        peer.stdout.close()
        node.kill()

    simulation = Simulation(
        Scene.build(Pattern.from_json(handkerchief()), Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES), quality="draft")
    )
    while not simulation.settled:
        simulation.tick()
    received, received_late = json.loads(first.read_text()), json.loads(late.read_text())
    assert received["report"]["state_sha256"] == simulation.state_hash()
    assert received["garment"] == sha256(simulation.positions[simulation.triangles])
    assert received["body_marker"] == sha256(BOX_VERTICES[BOX_TRIANGLES])
    assert received["garment_fields"] == ["map", "garment", 0, 11, 0]
    assert received["color"] == pytest.approx([0.80, 0.70, 0.62, 1.0])
    assert received["frames"] > 1
    assert received_late["frames"] == 1
    assert received_late | {"frames": 0} == received | {"frames": 0}
