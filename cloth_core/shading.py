"""How surfaces look in a picture: what rays meet, what light reaches them, and what colour they send back.

Light is linear and of three kinds: a soft key light with cast shadows, a fill light without, and a sky that is dimmed
by the share of it that each vertex sees (ambient occlusion, Zhukov et al., "An ambient light illumination model",
1998). Rays are traced by Embree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cloth_core.camera import Camera
from cloth_core.errors import ClothError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

__all__ = ["Obstacles", "Rays", "Surface", "linear_light", "shade"]

# Lights move with the camera; directions are (right, up, towards the viewer).
_KEY_DIRECTION, _KEY_RADIUS = (-0.70, 0.75, 0.75), 0.05
_KEY_COLOUR = np.array([0.74, 0.71, 0.67], dtype=np.float32)
_FILL_DIRECTION, _FILL_STRENGTH = (0.85, 0.15, 0.55), np.float32(0.10)
_SKY_COLOUR = np.array([0.93, 0.96, 1.0], dtype=np.float32)
_SKY_MEAN, _SKY_SLOPE = np.float32(0.32), np.float32(0.10)
_INSIDE, _EDGE = 0.50, 0.60  # share of its colour that the wrong side and the cut edge of a cloth keep
# Cosine of the angle between the normals of triangle and vertex from which on it lies at a crease.
_CREASE = 0.5
_SHEEN, _GLOSS = 0.22, 0.05  # fibres that stand up catch light at the rim of cloth; skin-like bodies shine a little
_BOUNCE = np.float32(0.14)  # share of the sky's light that reaches hidden places from surface to surface
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
_OFFSET = 3e-4  # of the scene's size: start of secondary rays, off the surface


class Surface:
    """A triangle mesh that rays can meet, with vertex normals and the light of the sky on both of its sides."""

    def __init__(self, vertices: Floats, triangles: NDArray[np.int32], colour: Sequence[float], *, cloth: bool) -> None:
        """Prepare vertices [m] (n, 3) and triangles (m, 3); `cloth` has two sides and cut edges, a body has not.

        Raises
        ------
        ClothError
            embreex is not installed.
        """
        self.vertices, self.triangles, self.cloth = vertices, triangles, cloth
        self.colour = linear_light(np.asarray(colour, dtype=np.float32))
        self.normals = _vertex_normals(vertices, triangles)
        self.edge_heights = _boundary_heights(vertices, triangles) if cloth else None
        self.sky = np.zeros((len(vertices), 2), dtype=np.float32)
        self._scene = _embree_scene((vertices, triangles))

    def first_hits(self, rays: Rays) -> dict[str, NDArray[Any]]:
        """Where rays first meet the surface: primID (-1: nowhere), tfar [m of depth], u, v and Ng of Embree."""
        origins = np.tile(rays.camera.eye.astype(np.float32), (len(rays.x), 1))
        hits: dict[str, NDArray[Any]] = self._scene.run(origins, rays.directions, output=True)
        return hits

    def light_sky(self, obstacles: Obstacles | None, rays: int) -> None:
        """Set the light of the sky on each vertex, outside and inside; without obstacles nothing hides it."""
        for side, sign in enumerate((1, -1) if self.cloth else (1,)):
            normals = np.float32(sign) * self.normals
            self.sky[:, side] = _SKY_MEAN + _SKY_SLOPE * normals[:, 2]
            if obstacles is not None:
                self.sky[:, side] *= _BOUNCE + (1 - _BOUNCE) * obstacles.open_sky(self.vertices, normals, rays)


class Obstacles:
    """Everything that stands in the way of light."""

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        self._scene = _embree_scene(*((surface.vertices, surface.triangles) for surface in surfaces))
        low = np.min([surface.vertices.min(axis=0) for surface in surfaces], axis=0)
        high = np.max([surface.vertices.max(axis=0) for surface in surfaces], axis=0)
        self._offset = np.float32(_OFFSET * np.linalg.norm(high - low))

    def hide(self, points: Floats, normals: Floats, directions: Floats) -> NDArray[np.bool_]:
        """Which rays (n, 3) from just above points (n, 3) with unit normals are stopped; one direction serves all."""
        stopped: NDArray[np.bool_] = self._scene.run(points + self._offset * normals, directions, query="OCCLUDED") >= 0
        return stopped

    def open_sky(self, points: Floats, normals: Floats, rays: int) -> Floats:
        """Cosine-weighted share (n,) of the half space over points (n, 3) with unit normals that is not hidden.

        All points look in the same `rays` directions, spread over the sphere, so that the result varies smoothly from
        vertex to vertex and from frame to frame.
        """
        seen, total = np.zeros(len(points), dtype=np.float32), np.full(len(points), 1e-6, dtype=np.float32)
        height = 1 - (2 * np.arange(rays) + 1) / rays
        radius, angle = np.sqrt(1 - height**2), np.arange(rays) * _GOLDEN_ANGLE
        for direction in np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height]).astype(np.float32):
            cosine = normals @ direction
            (facing,) = np.nonzero(cosine > 0)
            cosine = cosine[facing]
            total[facing] += cosine
            seen[facing] += cosine * ~self.hide(points[facing], normals[facing], direction[None])
        return seen / total


class Rays(NamedTuple):
    """Rays of a camera through pixel coordinates x, y (n,), samples x samples in each pixel; directions (n, 3)."""

    camera: Camera
    samples: int
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    directions: Floats

    @classmethod
    def through(cls, camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp], samples: int) -> Rays:
        """All rays of pixels (k,), one pixel after the other."""
        within = (np.arange(samples) + 0.5) / samples
        x = (columns[:, None, None] + within[None, None, :] + np.zeros((1, samples, 1))).ravel()
        y = (rows[:, None, None] + within[None, :, None] + np.zeros((1, 1, samples))).ravel()
        return cls(camera, samples, x, y, camera.directions(x, y))

    def pick(self, index: NDArray[np.intp]) -> Rays:
        """Only the rays with these indices."""
        return self._replace(x=self.x[index], y=self.y[index], directions=self.directions[index])

    def key_light(self, shadow_ray: int) -> Floats:
        """Directions (n, 3) to points of the key light, for one of the `shadow_rays`.

        The light is a disc. The rays of a pixel share out its points in a spiral, turned from pixel to pixel by
        interleaved gradient noise (Jimenez, "Next generation post processing", SIGGRAPH 2014).
        """
        axis = self.camera.to_world(_KEY_DIRECTION)
        across = np.cross(self.camera.axes[1], axis)
        across /= np.linalg.norm(across)
        column, row = np.floor(self.x), np.floor(self.y)
        inside = np.floor((self.y - row) * self.samples) * self.samples + np.floor((self.x - column) * self.samples)
        number = inside * self.shadow_rays + shadow_ray
        noise = np.modf(52.9829189 * np.modf(0.06711056 * column + 0.00583715 * row)[0])[0]
        radius = _KEY_RADIUS * np.sqrt((number + np.modf(7 * noise)[0]) / (self.samples**2 * self.shadow_rays))
        angle = 2 * np.pi * noise + number * _GOLDEN_ANGLE
        disc = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]).astype(np.float32)
        return axis + disc @ np.array([across, np.cross(axis, across)], dtype=np.float32)

    @property
    def shadow_rays(self) -> int:
        """How many rays to the key light follow each hit: at least 4 in each pixel."""
        return 4 if self.samples == 1 else 1


def shade(surface: Surface, hits: dict[str, NDArray[Any]], rays: Rays, obstacles: Obstacles | None) -> Floats:
    """Linear light (k, 3) that k hits send back along their rays; obstacles cast shadows."""
    camera = rays.camera
    key, fill = camera.to_world(_KEY_DIRECTION), camera.to_world(_FILL_DIRECTION)
    corners = surface.triangles[hits["primID"]]
    weights = np.stack([1 - hits["u"] - hits["v"], hits["u"], hits["v"]], axis=1)
    view = -rays.directions / np.linalg.norm(rays.directions, axis=1, keepdims=True)
    inside = _dot(hits["Ng"], rays.directions) > 0 if surface.cloth else np.zeros(len(corners), dtype=bool)
    normals = np.einsum("kc,kcx->kx", weights, surface.normals[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-6))
    normals[inside] *= -1

    sky = np.einsum("kc,kc->k", weights, surface.sky[corners, inside[:, None].astype(np.intp)])
    lit = np.maximum(normals @ key, 0)
    if obstacles is not None:
        (facing,) = np.nonzero(lit)
        sides = np.where(inside[facing], np.float32(-1), np.float32(1))[:, None]
        points = _rounded(surface, corners[facing], weights[facing], sides)
        shadows = np.zeros(len(facing), dtype=np.float32)
        for shadow_ray in range(rays.shadow_rays):
            shadows += obstacles.hide(points, normals[facing], rays.pick(facing).key_light(shadow_ray))
        lit[facing] *= 1 - shadows / rays.shadow_rays

    ambient = sky + _FILL_STRENGTH * (0.5 + 0.5 * (normals @ fill))
    light = ambient[:, None] * _SKY_COLOUR + lit[:, None] * _KEY_COLOUR
    colour = np.where(inside[:, None], _INSIDE * surface.colour, surface.colour)
    grazing = np.clip(1 - _dot(normals, view), 0, 1)
    if surface.edge_heights is None:
        half = view + key
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        colour = colour + (_GLOSS * np.where(lit > 0, np.maximum(_dot(normals, half), 0) ** 24, 0))[:, None]
    else:
        colour = colour * (1 + _SHEEN * grazing * grazing * grazing)[:, None]
        # A line of 1.5 pixels along cut edges and open seams.
        distances = weights * surface.edge_heights[hits["primID"]]
        colour[(distances < (0.75 / camera.scale * hits["tfar"])[:, None]).any(axis=1)] *= _EDGE
    result: Floats = (colour * light).astype(np.float32)
    return result


def linear_light(colour: Floats) -> Floats:
    """Linear light of sRGB values in 0..1 (IEC 61966-2-1)."""
    result: Floats = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return result


def _embree_scene(*meshes: tuple[Floats, NDArray[np.int32]]) -> Any:
    """Search structure of Embree over all triangles of the meshes."""
    # Imported by the first picture: simulations without one do without it.
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise ClothError("picture: the package embreex is missing; install it with pip install embreex") from error
    scene = EmbreeScene(robust=True)
    for vertices, triangles in meshes:
        TriangleMesh(scene, vertices, triangles)
    return scene


def _rounded(surface: Surface, corners: NDArray[np.int32], weights: Floats, sides: Floats) -> Floats:
    """Points (k, 3) on the round surface that the flat triangles stand for, where rays to a low light start.

    From the flat triangle itself they would meet its neighbours and draw the facets as shadow (Hanika, "Hacking the
    shadow terminator", Ray Tracing Gems II, 2021, section 4.3). `sides` (k, 1) is -1 on the inside.
    """
    vertices, normals = surface.vertices[corners], surface.normals[corners] * sides[:, None]
    flat = np.einsum("kc,kcx->kx", weights, vertices)
    below = np.minimum(np.einsum("kcx,kcx->kc", flat[:, None] - vertices, normals), 0)
    # At a crease normals lean so far that what they round would reach into the next layer.
    across = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]) * sides
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.float32(1e-12))
    below[np.einsum("kcx,kx->kc", normals, across) < _CREASE] = 0
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
