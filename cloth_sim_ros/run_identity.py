"""Which pattern, body and values a run was made of, and by which code: for who simulates it again."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from importlib import metadata, resources
from typing import Any

from cloth_core.body import Body
from cloth_core.pattern import Pattern
from cloth_core.scene import Scene
from cloth_sim_ros.messages import encode_mesh

__all__ = ["checksum", "run_identity", "versions"]

FORMAT = 1
"""Of the log's record; raised when logs of before can no longer be repeated."""


def checksum(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def run_identity(
    scene: Scene, patterns: Sequence[Pattern], body: Body | None, body_message: bytes | None, start: int
) -> dict[str, Any]:
    """JSON values for the log, under the key `replay` of its parameters.

    Args:
        scene: of the run
        patterns: that the scene was built from, in order
        body: that the scene was built from
        body_message: `shape_msgs/Mesh` in the log that the body was made from; None if it is the body's own mesh
        start: stamp of the run's start [ns since 1970]
    """
    if body is not None and body_message is None:
        body_message = encode_mesh(body.vertices, body.triangles)
    return {
        "format": FORMAT,
        "start": start,
        "patterns": [{"name": p.name, "sha256": checksum(p.source.encode("utf-8"))} for p in patterns],
        "body": None if body is None or body_message is None else {"name": body.name, "sha256": checksum(body_message)},
        "fabric": asdict(scene.fabric),
        "settings": asdict(scene.settings),
        "gravity": -scene.gravity[2],
        "air_drag": scene.air_drag,
        "pins": scene.pins.tolist(),
        "without": list(scene.without),
        "versions": versions(),
    }


@cache
def versions() -> dict[str, str]:
    """Of all that the bits of a result depend on: this package and its very source, what it calls, the processor."""
    import llvmlite.binding

    return {
        "cloth_core": _source_checksum(),
        **{name: _version(name) for name in ("cloth_sim_ros", "numpy", "numba", "scipy", "shapely")},
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": llvmlite.binding.get_host_cpu_name(),
    }


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # run from a folder that nothing was installed from
        return "unknown"


def _source_checksum() -> str:
    digest = hashlib.sha256()
    for file in sorted(resources.files("cloth_core").iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".py"):
            digest.update(f"{file.name}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]
