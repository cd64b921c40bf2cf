"""How surfaces look in a picture: what rays meet, what light reaches them, and what colour they send back.

Light is linear and of three kinds: a soft key light with cast shadows, a fill light without, and a sky that is dimmed
by the share of it that each vertex sees (ambient occlusion, Zhukov et al., "An ambient light illumination model",
1998). Rays are traced by Embree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloth_core.camera import Camera
from cloth_core.errors import ClothError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

__all__ = ["Surface", "key_light", "linear_light", "open_sky", "shade"]

# Lights move with the camera; directions are (right, up, towards the viewer).
_KEY_DIRECTION, _KEY_RADIUS = (-0.70, 0.75, 0.75), 0.07
_KEY_COLOUR = np.array([0.66, 0.635, 0.60], dtype=np.float32)
_FILL_DIRECTION, _FILL_STRENGTH = (0.85, 0.15, 0.55), np.float32(0.10)
_SKY_COLOUR = np.array([0.93, 0.96, 1.0], dtype=np.float32)
_SKY_MEAN, _SKY_SLOPE = np.float32(0.30), np.float32(0.10)
_INSIDE, _EDGE = 0.50, 0.60  # share of its colour that the wrong side and the cut edge of a cloth keep
_SHEEN, _GLOSS = 0.22, 0.05  # fibres that stand up catch light at the rim of cloth; skin-like bodies shine a little
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
_OFFSET = 3e-4  # of the scene's size: start of secondary rays, off the surface


class Surface:
    """A triangle mesh that rays can meet, with vertex normals and the light of the sky on both of its sides."""

    def __init__(self, vertices: Floats, triangles: NDArray[np.int32], colour: Sequence[float], *, cloth: bool) -> None:
        """Prepare vertices [m] (n, 3) and triangles (m, 3); `cloth` has two sides and cut edges, a body has not.

        Raises:
            ClothError: embreex is not installed.
        """
        # embreex is imported by the first picture: simulations without one do without it.
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise ClothError("picture: the package embreex is missing; install it with pip install embreex") from error
        self.vertices, self.triangles, self.cloth = vertices, triangles, cloth
        self.colour = linear_light(np.asarray(colour, dtype=np.float32))
        self.normals = _vertex_normals(vertices, triangles)
        self.edge_heights = _boundary_heights(vertices, triangles) if cloth else None
        self.sky = np.zeros((len(vertices), 2), dtype=np.float32)
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, vertices, triangles)

    def first_hits(self, origin: NDArray[np.float64], directions: Floats) -> dict[str, NDArray[Any]]:
        """Where rays from one point first meet the surface: primID (-1: nowhere), tfar, u, v and Ng of Embree."""
        origins = np.tile(origin.astype(np.float32), (len(directions), 1))
        hits: dict[str, NDArray[Any]] = self._scene.run(origins, directions, output=True)
        return hits

    def blocks(self, origins: Floats, directions: Floats) -> NDArray[np.bool_]:
        """Which rays meet the surface; one direction (1, 3) may serve all."""
        blocked: NDArray[np.bool_] = self._scene.run(origins, directions, query="OCCLUDED") >= 0
        return blocked

    def light_sky(self, blockers: Sequence[Surface], rays: int, reach: float) -> None:
        """Set the light of the sky on each vertex, outside and inside; without rays nothing hides it."""
        for side, sign in enumerate((1, -1) if self.cloth else (1,)):
            normals = np.float32(sign) * self.normals
            self.sky[:, side] = _SKY_MEAN + _SKY_SLOPE * normals[:, 2]
            if rays:
                self.sky[:, side] *= open_sky(blockers, self.vertices, normals, rays, reach)


def open_sky(blockers: Sequence[Surface], points: Floats, normals: Floats, rays: int, reach: float) -> Floats:
    """Cosine-weighted share (n,) of the half space over points (n, 3) with unit normals (n, 3) that is not blocked.

    All points look in the same `rays` directions, spread over the sphere, so that the result varies smoothly from
    vertex to vertex and from frame to frame. `reach` is the size of the scene [m].
    """
    seen, total = np.zeros(len(points), dtype=np.float32), np.full(len(points), 1e-6, dtype=np.float32)
    origins = points + np.float32(_OFFSET * reach) * normals
    height = 1 - (2 * np.arange(rays) + 1) / rays
    turn = np.arange(rays) * _GOLDEN_ANGLE
    radius = np.sqrt(1 - height**2)
    for direction in np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height]).astype(np.float32):
        cosine = normals @ direction
        (facing,) = np.nonzero(cosine > 0)
        free = ~_blocked(blockers, origins[facing], direction[None])
        total[facing] += cosine[facing]
        seen[facing] += cosine[facing] * free
    return seen / total


def key_light(camera: Camera, x: Floats, y: Floats, samples: int) -> Floats:
    """Directions (n, 3) to the key light from rays through pixel coordinates (n,).

    The light is a disc. The samples x samples rays of a pixel share out its points in a spiral, turned from pixel to
    pixel by interleaved gradient noise (Jimenez, "Next generation post processing", SIGGRAPH 2014).
    """
    axis = camera.to_world(_KEY_DIRECTION)
    across = np.cross(camera.axes[1], axis)
    across /= np.linalg.norm(across)
    column, row = np.floor(x), np.floor(y)
    number = np.floor((y - row) * samples) * samples + np.floor((x - column) * samples)
    noise = np.modf(52.9829189 * np.modf(0.06711056 * column + 0.00583715 * row)[0])[0]
    radius = _KEY_RADIUS * np.sqrt((number + np.modf(7 * noise)[0]) / samples**2)
    angle = 2 * np.pi * noise + number * _GOLDEN_ANGLE
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]).astype(np.float32)
    return axis + points @ np.array([across, np.cross(axis, across)], dtype=np.float32)


def shade(
    surface: Surface,
    hits: dict[str, NDArray[Any]],
    directions: Floats,
    key: Floats,
    camera: Camera,
    blockers: Sequence[Surface],
    reach: float,
) -> Floats:
    """Linear light (k, 3) that k hits send back along their rays.

    `directions` are those of the rays, `key` those to the key light, both (k, 3); `blockers` cast shadows.
    """
    corners = surface.triangles[hits["primID"]]
    weights = np.stack([1 - hits["u"] - hits["v"], hits["u"], hits["v"]], axis=1)
    view = -directions / np.linalg.norm(directions, axis=1, keepdims=True)
    inside = _dot(hits["Ng"], directions) > 0 if surface.cloth else np.zeros(len(corners), dtype=bool)
    normals = np.einsum("kc,kcx->kx", weights, surface.normals[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-6))
    normals[inside] *= -1

    sky = np.einsum("kc,kc->k", weights, surface.sky[corners, inside[:, None].astype(np.intp)])
    fill = _FILL_STRENGTH * np.maximum(0.5 + 0.5 * (normals @ camera.to_world(_FILL_DIRECTION)), 0)
    lit = np.maximum(_dot(normals, key), 0)
    if blockers:
        (facing,) = np.nonzero(lit)
        sides = np.where(inside[facing], np.float32(-1), np.float32(1))[:, None]
        points = _rounded(surface, corners[facing], weights[facing], sides)
        points += np.float32(_OFFSET * reach) * normals[facing]
        lit[facing[_blocked(blockers, points, key[facing])]] = 0

    light = (sky + fill)[:, None] * _SKY_COLOUR + lit[:, None] * _KEY_COLOUR
    colour = np.where(inside[:, None], _INSIDE * surface.colour, surface.colour)
    grazing = np.clip(1 - _dot(normals, view), 0, 1)
    if surface.edge_heights is None:
        half = view + key
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        colour = colour + (_GLOSS * np.where(lit > 0, np.maximum(_dot(normals, half), 0) ** 24, 0))[:, None]
    else:
        colour = colour * (1 + _SHEEN * grazing**3)[:, None]
        # A line of 1.5 pixels along cut edges and open seams.
        distances = weights * surface.edge_heights[hits["primID"]]
        colour[(distances < (0.75 / camera.scale * hits["tfar"])[:, None]).any(axis=1)] *= _EDGE
    result: Floats = (colour * light).astype(np.float32)
    return result


def linear_light(colour: Floats) -> Floats:
    """Linear light of sRGB values in 0..1 (IEC 61966-2-1)."""
    result: Floats = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return result


def _blocked(blockers: Sequence[Surface], origins: Floats, directions: Floats) -> NDArray[np.bool_]:
    """Which rays meet any surface; one direction (1, 3) may serve all."""
    blocked = np.zeros(len(origins), dtype=bool)
    for surface in blockers:
        (free,) = np.nonzero(~blocked)
        if len(free):
            rest = directions if len(directions) == 1 else directions[free]
            blocked[free] = surface.blocks(origins[free], rest)
    return blocked


def _rounded(surface: Surface, corners: NDArray[np.int32], weights: Floats, sides: Floats) -> Floats:
    """Points (k, 3) on the round surface that the flat triangles stand for, where rays to a low light start.

    From the flat triangle itself they would meet its neighbours and draw the facets as shadow (Hanika, "Hacking the
    shadow terminator", Ray Tracing Gems II, 2021, section 4.3). `sides` (k, 1) is -1 on the inside.
    """
    vertices, normals = surface.vertices[corners], surface.normals[corners] * sides[:, None]
    flat = np.einsum("kc,kcx->kx", weights, vertices)
    below = np.minimum(np.einsum("kcx,kcx->kc", flat[:, None] - vertices, normals), 0)
    lifted: Floats = flat - np.einsum("kc,kc,kcx->kx", weights, below, normals)
    return lifted


def _vertex_normals(vertices: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Area-weighted unit normals (n, 3); vertices at the same position, as on two sides of a seam, share theirs."""
    _, place = np.unique(vertices.view([("", np.float32)] * 3).ravel(), return_inverse=True)
    a, b, c = (vertices[triangles[:, k]].astype(np.float64) for k in range(3))
    areas = np.cross(b - a, c - a)
    own, shared = (_unit(_sums(index[triangles], areas)) for index in (np.arange(len(vertices)), place.reshape(-1)))
    shared = shared[place.reshape(-1)]
    # Where the sides of a seam are folded flat on each other, a common normal would point nowhere.
    folded = _dot(own, shared) < 0.3
    shared[folded] = own[folded]
    return shared.astype(np.float32)


def _sums(index: NDArray[Any], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of the values (m, 3) of the triangles that meet at each index in (m, 3)."""
    size = int(index.max()) + 1
    columns = [sum(np.bincount(index[:, k], values[:, axis], size) for k in range(3)) for axis in range(3)]
    return np.column_stack(columns)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
    return result


def _dot(first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    result: NDArray[Any] = np.einsum("kx,kx->k", first, second)
    return result


def _boundary_heights(vertices: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Height [m] of each triangle over its edge opposite to each corner (m, 3); NaN if that edge is shared."""
    edges = triangles[:, [[1, 2], [2, 0], [0, 1]]].astype(np.int64)
    codes = edges.min(axis=2) * len(vertices) + edges.max(axis=2)
    _, inverse, counts = np.unique(codes.ravel(), return_inverse=True, return_counts=True)
    ends = vertices[edges]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    double_areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None]
    heights = double_areas / np.maximum(lengths, 1e-12)
    result: Floats = np.where(counts[inverse].reshape(-1, 3) == 1, heights, np.nan).astype(np.float32)
    return result
