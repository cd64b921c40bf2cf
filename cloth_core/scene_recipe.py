"""How to build a scene at any settings: what a comparison of settings keeps fixed, as plain data."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from cloth_core.body import Body
from cloth_core.fabric import Fabric
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings
from cloth_core.scene import STANDARD_GRAVITY, Scene

__all__ = ["SceneRecipe"]


@dataclass(frozen=True)
class SceneRecipe:
    """A scene but for its numerical settings.

    Attributes:
        patterns: files or names of built-in ones.
        body: a file or the name of a built-in one, or None.
        fabric: name of a preset.
        gravity: downward [m/s^2].
        air_drag: k_a [1/s].
        pinned: points in space [m]; at each the nearest particle of the start is held, whatever the spacing.
        without: terms that are switched off.
    """

    patterns: tuple[str, ...]
    body: str | None = None
    fabric: str = "cotton_poplin"
    gravity: float = STANDARD_GRAVITY
    air_drag: float = 1.0
    pinned: tuple[tuple[float, float, float], ...] = ()
    without: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """For tables: garment, body and fabric."""
        without = f", without {' and '.join(self.without)}" if self.without else ""
        return f"{' + '.join(self.patterns)} on {self.body or 'no body'}, {self.fabric}{without}"

    def build(self, settings: Settings, seed: int = 0) -> Scene:
        """The scene at these settings.

        Args:
            settings: numerical settings.
            seed: above 0, each particle starts 0.1 mm away from its place, in a direction drawn with this seed.

        Raises:
            ClothError: it cannot be built.
        """
        scene = Scene.build(
            [Pattern.load(name) for name in self.patterns],
            _body(self.body) if self.body is not None else None,
            Fabric.preset(self.fabric),
            settings=settings,
            gravity=self.gravity,
            air_drag=self.air_drag,
            without=self.without,
        )
        garment = scene.garment
        pins = [int(((garment.start - np.asarray(p)) ** 2).sum(axis=1).argmin()) for p in self.pinned]
        if pins:
            scene = replace(scene, pins=np.unique(np.asarray(pins, dtype=np.int32)))
        return scene.disturbed(seed)

    def digest(self) -> str:
        """Hash of what the scene is made of: the contents of the files and the fabric's figures, not their names.

        Raises:
            ClothError: something cannot be read.
        """
        body = None
        if self.body is not None:
            mesh = _body(self.body)
            body = hashlib.sha256(mesh.vertices.tobytes() + mesh.triangles.tobytes()).hexdigest()
        contents = {
            "patterns": [Pattern.load(name).source for name in self.patterns],
            "body": body,
            "fabric": asdict(Fabric.preset(self.fabric)),
            "gravity": self.gravity,
            "air_drag": self.air_drag,
            "pinned": self.pinned,
            "without": self.without,
        }
        return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        return asdict(self)


@cache
def _body(name: str) -> Body:
    """Read once in each process: a series of runs is of few bodies."""
    return Body.load(name)
