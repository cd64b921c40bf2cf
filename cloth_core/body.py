"""A checked triangle mesh that garments collide with, and its AABB tree, built once."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cloth_core.aabb_tree import AabbTree, build_tree
from cloth_core.closest_points import point_triangle
from cloth_core.errors import BodyError
from cloth_core.kernel import kernel
from cloth_core.mesh_topology import Representatives, representatives, unique_edges
from cloth_core.unique_rows import unique_rows

__all__ = ["Body", "builtin_bodies"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MOST_TRIANGLES = 2_000_000


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
        """Check a mesh; drop what has no area or stands twice; turn it outside out if it is inside out.

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
        out = (raw < 0) | (raw >= len(points))
        if out.any():
            bad = int(np.flatnonzero(out.any(axis=1))[0])
            raise BodyError(
                f"body '{name}', triangle {bad}: vertex {int(raw[bad][out[bad]][0])} does not exist, "
                f"there are {len(points)}; mend the mesh"
            )
        index = raw.astype(np.int32)
        repairs: dict[str, int] = {}
        a, b, c = (points[index[:, k]] for k in range(3))
        doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        longest = np.max([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
        flat = doubled <= 1e-9 * np.maximum(longest, 1e-12) ** 2
        if flat.any():
            repairs["zero-area triangles dropped"] = int(flat.sum())
            index = index[~flat]
        first = unique_rows(np.sort(index, axis=1)).first
        if len(first) < len(index):
            repairs["duplicate triangles dropped"] = len(index) - len(first)
            index = index[np.sort(first)]
        if len(index) == 0:
            raise BodyError(f"body '{name}': no triangle with an area is left; mend the mesh")
        used, renumbered = np.unique(index, return_inverse=True)
        if len(used) < len(points):
            repairs["unused vertices dropped"] = len(points) - len(used)
        points, index = np.ascontiguousarray(points[used]), renumbered.reshape(-1, 3).astype(np.int32)
        warnings = []
        _, per_triangle = unique_edges(index)
        open_sides = int((np.bincount(per_triangle.ravel()) == 1).sum())
        if open_sides:
            warnings.append(f"body '{name}': {open_sides} sides have one triangle only; the surface is open there")
        a, b, c = (points[index[:, k]] for k in range(3))
        if not open_sides and float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) < 0.0:
            repairs["triangles turned outside out"] = len(index)
            index = np.ascontiguousarray(index[:, ::-1])
        return cls(name, points, index, repairs, tuple(warnings))

    @cached_property
    def tree(self) -> AabbTree:
        """The AABB tree of the triangles; built on first use, then kept."""
        return build_tree(self.vertices, self.triangles)

    @cached_property
    def representatives(self) -> Representatives:
        """Which triangle stands for which vertex and side."""
        return representatives(self.triangles)

    def signed_distance(self, points: Floats) -> Floats:
        """Distance to the surface [m], negative inside, of points (k, 3); shape (k,).

        The sign comes from the angle-weighted normal of the closest vertex, side or face (Baerentzen and Aanaes 2005),
        which is exact for a closed mesh.
        """
        face, edge, vertex = self._normals
        return _signed_distances(
            np.ascontiguousarray(points, dtype=np.float64), self.vertices, self.triangles, self.tree,
            self.representatives.triangle_edges, face, edge, vertex,
        )  # fmt: skip

    @cached_property
    def _normals(self) -> tuple[Floats, Floats, Floats]:
        corner = self.vertices[self.triangles]
        face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        face /= np.linalg.norm(face, axis=1, keepdims=True)
        vertex = np.zeros_like(self.vertices)
        for k in range(3):
            u = corner[:, (k + 1) % 3] - corner[:, k]
            w = corner[:, (k + 2) % 3] - corner[:, k]
            cosine = (u * w).sum(1) / (np.linalg.norm(u, axis=1) * np.linalg.norm(w, axis=1))
            np.add.at(vertex, self.triangles[:, k], face * np.arccos(np.clip(cosine, -1, 1))[:, None])
        edge = np.zeros((len(self.representatives.edges), 3))
        for k in range(3):
            np.add.at(edge, self.representatives.triangle_edges[:, k], face)
        return face, edge, vertex


def builtin_bodies() -> list[str]:
    """Names of the bodies that come with the package."""
    folder = resources.files("cloth_core") / "data" / "bodies"
    return sorted(entry.name[:-4] for entry in folder.iterdir() if entry.name.endswith(".ply"))


@kernel
def _box_distance(tree: AabbTree, node: int, p: Floats) -> float:
    squared = 0.0
    for k in range(3):
        gap = max(tree.lower[node, k] - p[k], max(0.0, p[k] - tree.upper[node, k]))
        squared += gap * gap
    return squared


@kernel
def _signed_distances(
    points: Floats,
    vertices: Floats,
    triangles: Ints,
    tree: AabbTree,
    triangle_edges: Ints,
    face_normals: Floats,
    edge_normals: Floats,
    vertex_normals: Floats,
) -> Floats:
    out = np.empty(points.shape[0])
    stack = np.zeros(128, dtype=np.int32)
    normal = np.zeros(3)
    for i in range(points.shape[0]):
        p = points[i]
        best, nearest = np.inf, -1
        weights = (0.0, 0.0, 0.0)
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            if _box_distance(tree, node, p) >= best:
                continue
            t = tree.triangle[node]
            if t >= 0:
                squared, u, v, w = point_triangle(
                    p, vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
                )
                if squared < best:
                    best, nearest, weights = squared, t, (u, v, w)
                continue
            left, right = node + 1, tree.right[node]
            if _box_distance(tree, left, p) < _box_distance(tree, right, p):
                left, right = right, left
            stack[top] = left
            stack[top + 1] = right
            top += 2
        inner = 0
        corner, without = 0, 0
        for k in range(3):
            if weights[k] > 1e-9:
                inner += 1
                corner = k
            else:
                without = k
        for axis in range(3):
            if inner == 3:
                normal[axis] = face_normals[nearest, axis]
            elif inner == 1:
                normal[axis] = vertex_normals[triangles[nearest, corner], axis]
            else:  # the side opposite to the corner without weight joins the next two corners
                normal[axis] = edge_normals[triangle_edges[nearest, (without + 1) % 3], axis]
        side = 0.0
        for k in range(3):
            closest = 0.0
            for j in range(3):
                closest += weights[j] * vertices[triangles[nearest, j], k]
            side += (p[k] - closest) * normal[k]
        out[i] = np.sqrt(best) if side >= 0.0 else -np.sqrt(best)
    return out
