"""Sewing patterns: flat panels with curved outlines, and the stitches between their edges.

Units are metres and the world has z up (REP 103), whatever the file says; `pattern_reader` does the conversion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cloth_core.curves import Curve
from cloth_core.errors import PatternError

__all__ = ["MAX_TEXT_BYTES", "Edge", "Panel", "Pattern", "Stitch", "StitchSide", "builtin_patterns"]

MAX_TEXT_BYTES = 4 * 1024 * 1024  # published patterns have 20 to 200 kB

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Edge:
    """One side of a panel's outline, from vertex `start` to vertex `end`.

    `curve` is in panel coordinates [m]. `file_index` is the edge's place in the file: it differs from the place in
    `Panel.edges` where the loop was re-ordered, and it is what messages to the user name.
    """

    start: int
    end: int
    curve: Curve
    label: str | None = None
    file_index: int = 0

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return self.curve.length

    def sample(self, count: int) -> FloatArray:
        """`count` points at equal distances along the edge, both ends included exactly, shape (count, 2) [m]."""
        return self.curve.sample(count)


@dataclass(frozen=True, eq=False)
class Panel:
    """A flat piece of cloth: `vertices` (n, 2) [m], and the `edges` of its outline in order, head to tail.

    `rotation` (3, 3) and `translation` (3,) [m] place it in the world: rotation @ (x, y, 0) + translation.
    """

    name: str
    vertices: FloatArray
    edges: tuple[Edge, ...]
    rotation: FloatArray
    translation: FloatArray
    label: str | None = None

    def to_world(self, points: ArrayLike) -> FloatArray:
        """World positions (k, 3) [m] of `points` (k, 2) [m] of the panel."""
        world: FloatArray = np.asarray(points, dtype=float) @ self.rotation[:, :2].T + self.translation
        return world

    @cached_property
    def area(self) -> float:
        """Area within the curved outline [m^2], exact by Green's theorem; negative where the outline runs clockwise."""
        return sum(edge.curve.area_term for edge in self.edges)

    @property
    def normal(self) -> FloatArray:
        """World direction (3,) of the outer side: local +z where the outline runs counter-clockwise, else -z."""
        return np.asarray(self.rotation[:, 2] if self.area > 0.0 else -self.rotation[:, 2])


@dataclass(frozen=True)
class StitchSide:
    """One of the two edges of a stitch: an index into `Panel.edges` of the panel of that name."""

    panel: str
    edge: int


@dataclass(frozen=True)
class Stitch:
    """A seam between two edges: the start of one meets the end of the other; with `right_wrong` start meets start."""

    first: StitchSide
    second: StitchSide
    right_wrong: bool = False

    @property
    def start_meets_end(self) -> bool:
        """True where the start of the first edge is sewn to the end of the second, false where start meets start."""
        return not self.right_wrong


@dataclass(frozen=True, eq=False)
class Pattern:
    """A checked sewing pattern; `panels` in the file's `panel_order`, `source` is the JSON text it was read from.

    Of a file that is a list of patterns `layers` has each, the innermost garment first; panels and stitches are theirs.
    """

    name: str
    panels: Mapping[str, Panel]
    stitches: tuple[Stitch, ...]
    warnings: tuple[str, ...] = ()
    source: str = field(default="", repr=False)
    layers: tuple[Pattern, ...] = ()

    @property
    def area(self) -> float:
        """Of all panels [m^2]."""
        return sum(abs(panel.area) for panel in self.panels.values())

    file_suffix: ClassVar[str] = "_specification"  # that GarmentCode adds to the name of a pattern file

    @classmethod
    def from_json(cls, text: str | bytes, name: str = "pattern") -> Pattern:
        """Read a GarmentCode pattern. PatternError, naming panel, edge or stitch, for whatever is wrong with it."""
        from cloth_core.pattern_reader import read_pattern

        return read_pattern(text, name)

    @classmethod
    def load(cls, path_or_name: str | Path) -> Pattern:
        """Read the built-in pattern of that name, or a file. PatternError if there is none or it is malformed."""
        if path_or_name in builtin_patterns():
            text = resources.files("cloth_core").joinpath(f"data/patterns/{path_or_name}.json").read_bytes()
            return cls.from_json(text, str(path_or_name))
        path = Path(path_or_name)
        text = _read_file(path)
        try:
            return cls.from_json(text, path.stem.removesuffix(cls.file_suffix) or path.stem)
        except PatternError as error:
            raise PatternError(f"{path}: {error}") from None


def builtin_patterns() -> list[str]:
    """Names of the patterns that come with the package, sorted."""
    directory = resources.files("cloth_core").joinpath("data/patterns")
    if not directory.is_dir():
        return []
    return sorted(entry.name.removesuffix(".json") for entry in directory.iterdir() if entry.name.endswith(".json"))


def _read_file(path: Path) -> bytes:
    shown = repr(str(path)[:200])
    try:
        if not path.exists():
            names = ", ".join(builtin_patterns()) or "none"
            raise PatternError(f"no pattern file or built-in pattern {shown}; built-in patterns: {names}")
        if not path.is_file():
            raise PatternError(f"{shown} is not a file; give the path of a pattern JSON file")
        with path.open("rb") as file:
            text = file.read(MAX_TEXT_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise PatternError(f"cannot read {shown}: {getattr(error, 'strerror', None) or error}") from None
    if len(text) > MAX_TEXT_BYTES:
        raise PatternError(f"{shown} has more than {MAX_TEXT_BYTES // 1024**2} MiB; a pattern file is far smaller")
    return text
