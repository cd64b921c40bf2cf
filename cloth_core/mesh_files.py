"""Triangle meshes from and to files: garments as GLB, OBJ or PLY, bodies from PLY, OBJ, STL or GLB.

Inside the simulator the world is metres with z up. glTF demands y up, so a GLB is turned on its way out and back on its
way in; the other formats have no rule about axes and hold z up as it is. Files are written whole or not at all.
"""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cloth_core.errors import BodyError, ClothError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["READABLE", "WRITABLE", "read_mesh", "write_file", "write_mesh"]

READABLE = (".ply", ".obj", ".stl", ".glb")
"""File name endings that `read_mesh` takes."""

WRITABLE = (".glb", ".obj", ".ply")
"""File name endings that `write_mesh` takes."""

# These formats hold a vertex more than once: STL once per triangle, OBJ and GLB along the cuts of texture and normals.
_SPLIT_VERTICES = (".obj", ".stl", ".glb")

# z up -> y up: x stays, the old z becomes y, the old -y becomes z (a proper rotation by -90 degrees about x).
_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def write_file(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file whole or not at all: under another name first, then renamed over `path`.

    Raises
    ------
    ClothError
        the file cannot be written.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        try:
            temporary.write_bytes(content)
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise ClothError(
            f"{target}: cannot be written ({reason}); choose a folder that exists and is writable"
        ) from error


def write_mesh(
    path: str | os.PathLike[str], vertices: ArrayLike, triangles: ArrayLike, *, rest: ArrayLike | None = None
) -> None:
    """Write a triangle mesh; the order of vertices and triangles is kept, coordinates are rounded to single precision.

    Parameters
    ----------
    path
        file to write; its ending chooses the format: .glb (binary glTF, y up, two-sided material), or .obj or
        .ply (binary), both z up.
    vertices
        positions [m], shape (n, 3), z up.
    triangles
        vertex indices, shape (m, 3), counter-clockwise seen from outside.
    rest
        flat rest positions [m], shape (n, 2), written as texture coordinates (in a GLB as (u, 1 - v), since its
        v axis points down).

    Raises
    ------
    ClothError
        the ending is unknown, the arrays do not fit together, or the file cannot be written.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in WRITABLE:
        raise ClothError(f"{target}: unknown mesh format '{target.suffix}'; use one of {', '.join(WRITABLE)}")
    points = np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(triangles)
    _check_arrays(target, points, faces)
    texture = None if rest is None else np.asarray(rest, dtype=np.float64)
    if texture is not None and texture.shape != (len(points), 2):
        raise ClothError(
            f"{target}: rest has shape {texture.shape}, not ({len(points)}, 2); give one flat position per vertex"
        )

    import trimesh

    mesh: Any = trimesh.Trimesh(points @ _TO_Y_UP.T if suffix == ".glb" else points, faces, process=False)
    visual: Any = trimesh.visual
    if suffix == ".ply":
        if texture is not None:
            mesh.vertex_attributes["s"] = texture[:, 0].astype(np.float32)
            mesh.vertex_attributes["t"] = texture[:, 1].astype(np.float32)
        content: bytes = mesh.export(file_type="ply", encoding="binary", vertex_normal=False)
    elif suffix == ".obj":
        if texture is not None:
            mesh.visual = visual.TextureVisuals(uv=texture)
        text: str = mesh.export(
            file_type="obj", header=None, include_normals=False, include_color=False, write_texture=False
        )
        # The exporter names a material library that is not written; readers would complain about it.
        lines = (line for line in text.splitlines() if not line.startswith(("mtllib", "usemtl")))
        content = ("\n".join(lines) + "\n").encode()
    else:
        material = visual.material.PBRMaterial(
            name="cloth",
            baseColorFactor=[0.72, 0.74, 0.80, 1.0],
            metallicFactor=0.0,
            roughnessFactor=0.9,
            doubleSided=True,
        )
        mesh.visual = visual.TextureVisuals(uv=texture, material=material)
        content = mesh.export(file_type="glb", include_normals=True)
    write_file(target, content)


def read_mesh(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Read a triangle mesh, usually a body, from a local PLY, OBJ, STL or GLB file.

    Polygons are cut into triangles and the parts of a GLB scene joined. A GLB is turned from y up to z up. Vertices at
    the very same position are merged where the format splits them (STL, OBJ, GLB), so that neighbouring triangles share
    them; their order of appearance is kept.

    Returns
    -------
    vertices [m] (n, 3) float64, z up, and triangles (m, 3) int32. Nothing else is repaired or judged here.

    Raises
    ------
    BodyError
        the ending is unknown, the file is missing or broken, or holds no triangles.
    """
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix not in READABLE:
        raise BodyError(f"{source}: unknown mesh format '{source.suffix}'; use one of {', '.join(READABLE)}")
    try:
        content = source.read_bytes()
    except OSError as error:
        raise BodyError(
            f"{source}: cannot be read ({error.strerror or type(error).__name__}); give an existing file"
        ) from error

    points, faces = _parse(source, suffix, content)
    if len(faces) == 0:
        raise BodyError(f"{source}: holds no triangles; export the body as a surface mesh")
    if faces.min() < 0 or faces.max() >= len(points):
        raise BodyError(f"{source}: a triangle names a vertex outside 0..{len(points) - 1}; export the file again")
    if suffix == ".glb":
        points = points @ _TO_Y_UP
    if suffix in _SPLIT_VERTICES:
        points, faces = _merge_equal(points, faces)
    return np.ascontiguousarray(points), np.ascontiguousarray(faces, dtype=np.int32)


def _parse(source: Path, suffix: str, content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and triangles as the file has them; whatever the parser raises becomes one BodyError."""
    import trimesh

    # Only bytes are handed over, with no resolver: nothing that the file refers to, local or remote, is opened.
    options: dict[str, Any] = {"file_type": suffix[1:], "process": False}
    if suffix == ".obj":
        options |= {"skip_materials": True, "maintain_order": True}
    elif suffix == ".ply":
        options["fix_texture"] = False  # texture coordinates would split vertices
    try:
        with warnings.catch_warnings():  # NumPy's, for vertices that no triangle uses
            warnings.simplefilter("ignore", RuntimeWarning)
            scene = trimesh.load_scene(io.BytesIO(content), **options)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
        if not parts:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
        mesh: Any = parts[0] if len(parts) == 1 else trimesh.util.concatenate(parts)
        return np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3), np.array(mesh.faces, dtype=np.int64).reshape(
            -1, 3
        )
    except Exception as error:  # parsers raise anything from KeyError to struct.error on a broken file
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise BodyError(
            f"{source}: not a readable {suffix[1:].upper()} mesh ({reason}); export the file again"
        ) from error


def _merge_equal(
    points: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Join vertices with equal coordinates; the first of each keeps its place in the order."""
    from cloth_core.equal_rows import first_of_equal

    first = first_of_equal(np.ascontiguousarray(points + 0.0).view(np.uint64))
    kept = first == np.arange(len(points))
    return points[kept], (np.cumsum(kept) - 1)[first][faces]


def _check_arrays(target: Path, points: NDArray[np.float64], faces: NDArray[Any]) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ClothError(
            f"{target}: vertices have shape {points.shape} and triangles {faces.shape}; give (n, 3) and (m, 3)"
        )
    if len(faces) == 0:
        raise ClothError(f"{target}: the mesh has no triangles; nothing was written")
    if not np.isfinite(points).all():
        raise ClothError(
            f"{target}: {int((~np.isfinite(points)).any(1).sum())} vertices are not finite; nothing was written"
        )
    if faces.min() < 0 or faces.max() >= len(points):
        raise ClothError(f"{target}: a triangle names a vertex outside 0..{len(points) - 1}; nothing was written")
