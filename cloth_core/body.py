"""A checked triangle mesh that garments collide with, and its AABB tree, built once."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cloth_core.aabb_tree import AabbTree, build_tree, refit_tree
from cloth_core.body_repair import repair_mesh
from cloth_core.errors import BodyError
from cloth_core.mesh_distance import distances_to_mesh
from cloth_core.mesh_topology import Representatives, representatives
from cloth_core.winding_number import Dipoles, dipoles, winding_numbers

__all__ = ["Body", "builtin_bodies"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MOST_TRIANGLES = 2_000_000
LARGEST_COORDINATE = 1e6  # [m]; beyond it products of coordinates lose what triangles are made of


@dataclass(frozen=True)
class Body:
    """Static obstacle of the scene.

    Attributes:
        name: for messages.
        vertices: [m], z up, shape (n, 3).
        triangles: corner indices, outward normals by the right-hand rule where the mesh is closed, shape (m, 3).
        repairs: what was mended, with counts, for example {"zero-area triangles dropped": 3}.
        warnings: one line each.
    """

    name: str
    vertices: Floats
    triangles: Ints
    repairs: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    _tree_before: AabbTree | None = field(default=None, init=False, repr=False, compare=False)

    @classmethod
    def load(cls, source: str | Path) -> Body:
        """Read a mesh file (PLY, OBJ, STL, GLB) or take a built-in body by its name.

        Raises:
            BodyError: no such file or name, or the mesh cannot be used.
        """
        text = str(source)
        if text in builtin_bodies():
            with resources.as_file(resources.files("cloth_core") / "data" / "bodies" / f"{text}.ply") as path:
                return cls._read(path, text)
        path = Path(source)
        if not path.suffix and not path.exists():
            raise BodyError(f"body '{text}': not known; use one of {', '.join(builtin_bodies())} or a mesh file")
        return cls._read(path, path.stem)

    @classmethod
    def _read(cls, path: Path, name: str) -> Body:
        from cloth_core.mesh_files import read_mesh

        vertices, triangles = read_mesh(path)
        return cls.from_arrays(vertices, triangles, name)

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, triangles: ArrayLike, name: str = "body") -> Body:
        """Check a mesh, and repair it (`body_repair`) with a count of what was done.

        Args:
            vertices: [m], shape (n, 3).
            triangles: corner indices, shape (m, 3).

        Raises:
            BodyError: wrong shapes, a coordinate that is not finite, an index out of range, or nothing left.
        """
        try:
            points = np.array(vertices, dtype=np.float64)
        except (TypeError, ValueError):
            raise BodyError(f"body '{name}': vertices are no table of numbers; give (n, 3)") from None
        try:
            raw = np.array(triangles)
        except ValueError:
            raise BodyError(f"body '{name}': triangles are no table of indices; give (m, 3)") from None
        if points.ndim != 2 or points.shape[1:] != (3,) or len(points) == 0:
            raise BodyError(f"body '{name}': vertices have shape {points.shape}; give (n, 3) with n >= 3")
        if raw.ndim != 2 or raw.shape[1:] != (3,) or len(raw) == 0:
            raise BodyError(f"body '{name}': triangles have shape {raw.shape}; give (m, 3) with m >= 1")
        if raw.dtype.kind not in "iu":
            raise BodyError(f"body '{name}': triangle indices are {raw.dtype}; give whole numbers")
        if len(raw) > MOST_TRIANGLES:
            raise BodyError(f"body '{name}': {len(raw)} triangles, at most {MOST_TRIANGLES}; simplify the mesh")
        if not np.isfinite(points).all():
            bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise BodyError(f"body '{name}', vertex {bad}: {points[bad].tolist()} is not finite; mend the mesh")
        if np.abs(points).max() > LARGEST_COORDINATE:
            bad = int(np.abs(points).max(axis=1).argmax())
            raise BodyError(
                f"body '{name}', vertex {bad}: {points[bad].tolist()} lies more than {LARGEST_COORDINATE:g} m from the "
                "origin; give metres"
            )
        out = (raw < 0) | (raw >= len(points))
        if out.any():
            bad = int(np.flatnonzero(out.any(axis=1))[0])
            raise BodyError(
                f"body '{name}', triangle {bad}: vertex {int(raw[bad][out[bad]][0])} does not exist, "
                f"there are {len(points)}; mend the mesh"
            )
        mesh = repair_mesh(points, np.ascontiguousarray(raw, dtype=np.int32))
        if len(mesh.triangles) == 0:
            raise BodyError(f"body '{name}': no triangle with an area is left; mend the mesh")
        warnings = tuple(f"body '{name}': {line}" for line in mesh.warnings)
        return cls(name, mesh.vertices, mesh.triangles, mesh.repairs, warnings)

    @cached_property
    def tree(self) -> AabbTree:
        """The AABB tree of the triangles; built on first use, or refitted if the body has moved, then kept."""
        if self._tree_before is None:
            return build_tree(self.vertices, self.triangles)
        tree = AabbTree(**{name: part.copy() for name, part in self._tree_before._asdict().items()})
        refit_tree(tree, self.vertices, self.triangles, 0.0)
        return tree

    def moved(self, vertices: Floats) -> Body:
        """The same body with its vertices elsewhere [m], shape (n, 3), finite."""
        body = Body(self.name, np.ascontiguousarray(vertices), self.triangles, self.repairs, self.warnings)
        # On the way to a place at which something is searched, most bodies are never asked for their tree.
        before = self.tree if self._tree_before is None else self.__dict__.get("tree", self._tree_before)
        object.__setattr__(body, "_tree_before", before)
        # What a cached property would compute at its first use.
        body.__dict__["representatives"] = self.representatives
        return body

    @cached_property
    def lowest(self) -> float:
        """Height of the lowest vertex [m]."""
        return float(self.vertices[:, 2].min())

    @cached_property
    def representatives(self) -> Representatives:
        """Which triangle stands for which vertex and side."""
        return representatives(self.triangles)

    def winding_number(self, points: Floats) -> Floats:
        """How often the surface goes round each of the points (k, 3) [m], to about 0.01; shape (k,).

        1 inside and 0 outside of a closed surface; more where shells overlap; between 0 and 1 about a hole.
        """
        where = np.ascontiguousarray(points, dtype=np.float64)
        return winding_numbers(where, self.vertices, self.triangles, self.tree, self._dipoles)

    def signed_distance(self, points: Floats) -> Floats:
        """Distance to the nearest triangle [m], negative inside, of points (k, 3) [m]; shape (k,).

        Inside is where the surface goes round a point by more than a half, so that holes, several shells and shells
        that overlap all have an inside: a hole is closed by a surface that spans it smoothly.
        """
        where = np.ascontiguousarray(points, dtype=np.float64)
        distance = distances_to_mesh(where, self.vertices, self.triangles, self.tree)
        return np.where(self.winding_number(where) > 0.5, -distance, distance)

    @cached_property
    def _dipoles(self) -> Dipoles:
        return dipoles(self.vertices, self.triangles, self.tree)


def builtin_bodies() -> list[str]:
    """Names of the bodies that come with the package."""
    folder = resources.files("cloth_core") / "data" / "bodies"
    return sorted(entry.name[:-4] for entry in folder.iterdir() if entry.name.endswith(".ply"))
