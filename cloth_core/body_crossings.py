"""Where cloth and a body pass through each other: sides of the one through triangles of the other.

A tip of the body that is finer than the cloth's mesh comes through a triangle without any side of the cloth meeting it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.intersections import crossing_pairs

__all__ = ["BodyCrossings"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class BodyCrossings(NamedTuple):
    """All crossings, by the exact tests of `cloth_core.intersections`.

    Attributes:
        cloth_sides: of the cloth, (e, 2); through_body: index of a side and of a body triangle that it crosses, (k, 2).
        body_sides: of the body, (f, 2); through_cloth: index of a side and of a cloth triangle that it crosses, (j, 2).
    """

    cloth_sides: Ints
    through_body: Ints
    body_sides: Ints
    through_cloth: Ints

    @classmethod
    def of(cls, x: Floats, triangles: Ints, body: Body) -> BodyCrossings:
        """Those of cloth at x (n, 3) [m] with triangles (m, 3) and a body."""
        return cls(
            *crossing_pairs(x, triangles, body.vertices, body.triangles, body.tree),
            *crossing_pairs(body.vertices, body.triangles, x, triangles),
        )

    @property
    def cloth_sides_through_body(self) -> int:
        """How many sides of the cloth cross the body."""
        return len(np.unique(self.through_body[:, 0]))

    @property
    def body_sides_through_cloth(self) -> int:
        """How many sides of the body cross the cloth."""
        return len(np.unique(self.through_cloth[:, 0]))

    @property
    def number(self) -> int:
        """How many sides cross, of either."""
        return self.cloth_sides_through_body + self.body_sides_through_cloth
