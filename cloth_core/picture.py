"""Pictures of garments and bodies, ray cast on the CPU: no display, no OpenGL, the same bytes every time.

Views from named sides stand next to each other at one scale, over a soft contact shadow and a caption.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cloth_core.camera import VIEWS, Camera
from cloth_core.errors import ClothError
from cloth_core.mesh_files import write_file
from cloth_core.shading import Surface, key_light, linear_light, open_sky, shade

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float32]
    Mesh = tuple[ArrayLike, ArrayLike]
    ColouredMesh = tuple[ArrayLike, ArrayLike, Sequence[float]]

__all__ = ["BODY_COLOUR", "Renderer", "draw"]

BODY_COLOUR = (0.80, 0.755, 0.715)
"""Colour of the body, sRGB in 0..1: a mannequin, no skin."""

_TOP, _BOTTOM, _INK = (0.955, 0.957, 0.962), (0.845, 0.848, 0.856), (0.23, 0.235, 0.26)
_GROUND_CELLS, _GROUND_RAYS, _GROUND_DARKNESS = 72, 96, 0.8
_CONTRAST = 0.035  # of the square root of light, which is about even to the eye
_RAYS_AT_A_TIME = 1 << 18
_SMALLEST, _LARGEST = 16, 16384


class Renderer:
    """Draws garments on one body, frame after frame; what depends on the body alone is made once."""

    def __init__(self, body: Mesh | None = None, *, samples: int = 3, occlusion_rays: int = 64) -> None:
        """Prepare the body, vertices [m] (n, 3) and triangles (m, 3).

        Args:
            body: what the garments are drawn on, or None.
            samples: pixels that differ from their neighbours are traced again with samples x samples rays; 1 leaves
                them as they are.
            occlusion_rays: directions, spread over the sphere, in which each vertex looks for the sky; 0 leaves out
                ambient occlusion and cast shadows, for quick frames.

        Raises:
            ClothError: the body is empty, not finite or not a mesh, or embreex is not installed.
        """
        self._samples = samples
        self._occlusion_rays = occlusion_rays
        self._body = None if body is None else Surface(*_checked("the body", *body), BODY_COLOUR, cloth=False)

    def render(
        self,
        garments: Sequence[ColouredMesh],
        *,
        views: Sequence[str] = ("front", "back"),
        size: tuple[int, int] = (1600, 1000),
        caption: str | None = None,
        focus: tuple[ArrayLike, float] | None = None,
        frame_bounds: ArrayLike | None = None,
    ) -> NDArray[np.uint8]:
        """Draw garments on the body, the views side by side at one scale.

        Args:
            garments: (vertices [m] (n, 3), triangles (m, 3), colour) of each; colour is red, green, blue in 0..1, sRGB.
            views: names out of `cloth_core.camera.VIEWS`.
            size: width and height of the whole picture [pixels].
            caption: text below the picture.
            focus: centre (3,) and radius [m] of what shall fill each view; without it everything does.
            frame_bounds: lowest and highest corner [m], shape (2, 3), of what the camera frames instead of the meshes
                themselves, so that the frames of a film share one camera.

        Returns:
            Picture, shape (height, width, 3).

        Raises:
            ClothError: nothing to draw, not finite, not a mesh, an unknown view, or an impossible size.
        """
        surfaces = [] if self._body is None else [self._body]
        for index, (vertices, triangles, colour) in enumerate(garments):
            mesh = _checked(f"garment {index}", vertices, triangles)
            rgb = _finite(f"the colour of garment {index}", colour, (3,))
            if rgb.min() < 0 or rgb.max() > 1:
                raise ClothError(f"picture: the colour of garment {index} is {tuple(colour)}; give 3 numbers in 0..1")
            surfaces.append(Surface(*mesh, rgb.tolist(), cloth=True))
        if not surfaces:
            raise ClothError("picture: nothing to draw; give at least one garment or a body")
        _check_layout(views, size)

        scene = np.concatenate([surface.vertices for surface in surfaces]).astype(np.float64)
        reach = float(np.linalg.norm(np.ptp(scene, axis=0)))
        if frame_bounds is not None:
            scene = np.stack(np.meshgrid(*_finite("frame_bounds", frame_bounds, (2, 3)).T), axis=-1).reshape(8, 3)
        frame = scene
        if focus is not None:
            centre, radius = _finite("the centre of focus", focus[0], (3,)), float(focus[1])
            if not 0 < radius < np.inf:
                raise ClothError(f"picture: the radius of focus is {radius} m; give a length above 0")
            frame = centre + radius * np.concatenate([np.eye(3), -np.eye(3)])

        for surface in surfaces:
            surface.light_sky(surfaces, self._occlusion_rays, reach)
        ground = None
        if self._body is not None and self._occlusion_rays:
            ground = _Ground.under(self._body, surfaces, reach)
        footer = _footer(views, caption, size)
        height = size[1] - len(footer)
        columns = np.linspace(0, size[0], len(views) + 1).astype(int).tolist()
        cameras = Camera.of_views(views, scene, frame, (size[0] // len(views), height))
        picture = np.empty((size[1], size[0], 3), dtype=np.uint8)
        for camera, (left, right) in zip(cameras, pairwise(columns), strict=True):
            picture[:height, left:right] = self._view(camera, surfaces, ground, (right - left, height), reach)
        picture[height:] = footer
        return picture

    def _view(
        self, camera: Camera, surfaces: list[Surface], ground: _Ground | None, size: tuple[int, int], reach: float
    ) -> NDArray[np.uint8]:
        """One view, (height, width, 3): a ray through each pixel, more where neighbours differ (Whitted, 1980)."""
        width, height = size
        down = np.linspace(0, 1, height, dtype=np.float32)[:, None]
        backdrop = linear_light((1 - down) * np.float32(_TOP) + down * np.float32(_BOTTOM))
        picture = np.repeat(backdrop[:, None], width, axis=1)
        if ground is not None:
            ground.darken(picture, camera)
        covers = [_covered(camera.project(surface.vertices)[surface.triangles], size) for surface in surfaces]
        inside = np.any(covers, axis=0)
        light = np.zeros((height, width, 4), dtype=np.float32)
        light[inside] = self._trace(camera, surfaces, covers, inside, 1, reach)
        if self._samples > 1:
            uneven = inside & _uneven(light)
            light[uneven] = self._trace(camera, surfaces, covers, uneven, self._samples, reach)
        return _encoded(picture * (1 - light[..., 3:]) + light[..., :3])

    def _trace(
        self,
        camera: Camera,
        surfaces: list[Surface],
        covers: list[NDArray[np.bool_]],
        wanted: NDArray[np.bool_],
        samples: int,
        reach: float,
    ) -> Floats:
        """Linear light and coverage (k, 4) of the k wanted pixels, each the mean over samples x samples rays.

        A surface can only be met within its cover (height, width).
        """
        rows, columns = np.nonzero(wanted)
        result = np.empty((len(rows), 4), dtype=np.float32)
        within = (np.arange(samples) + 0.5) / samples
        blockers = surfaces if self._occlusion_rays else []
        step = max(1, _RAYS_AT_A_TIME // samples**2)
        for start in range(0, len(rows), step):
            row, column = rows[start : start + step], columns[start : start + step]
            x = (column[:, None, None] + within[None, None, :] + np.zeros((1, samples, 1))).ravel()
            y = (row[:, None, None] + within[None, :, None] + np.zeros((1, 1, samples))).ravel()
            directions = camera.directions(x, y)
            nearest, depth = np.full(len(x), -1), np.full(len(x), np.inf, dtype=np.float32)
            hits = []
            for index, surface in enumerate(surfaces):
                (rays,) = np.nonzero(np.repeat(covers[index][row, column], samples**2))
                hit = surface.first_hits(camera.eye, directions[rays])
                closer = (hit["primID"] >= 0) & (hit["tfar"] < depth[rays])
                rays = rays[closer]
                nearest[rays], depth[rays] = index, hit["tfar"][closer]
                hits.append((rays, {name: values[closer] for name, values in hit.items()}))
            light = np.zeros((len(x), 4), dtype=np.float32)
            for index, (rays, hit) in enumerate(hits):
                seen = nearest[rays] == index
                rays = rays[seen]
                if len(rays):
                    hit = {name: values[seen] for name, values in hit.items()}
                    key = key_light(camera, x[rays], y[rays], samples)
                    light[rays, :3] = shade(surfaces[index], hit, directions[rays], key, camera, blockers, reach)
                    light[rays, 3] = 1
            result[start : start + step] = light.reshape(-1, samples**2, 4).mean(axis=1)
        return result


def draw(
    path: str | os.PathLike[str] | None,
    garments: Sequence[ColouredMesh],
    body: Mesh | None = None,
    *,
    views: Sequence[str] = ("front", "back"),
    size: tuple[int, int] = (1600, 1000),
    caption: str | None = None,
    focus: tuple[ArrayLike, float] | None = None,
    frame_bounds: ArrayLike | None = None,
) -> NDArray[np.uint8]:
    """Draw one picture at full quality and, given a path, write it as PNG; see `Renderer.render` for the arguments.

    Raises:
        ClothError: as `Renderer`; also if `path` does not end in .png or cannot be written.
    """
    if path is not None and Path(path).suffix.lower() != ".png":
        raise ClothError(f"{path}: pictures are written as PNG; end the name in .png")
    picture = Renderer(body).render(
        garments, views=views, size=size, caption=caption, focus=focus, frame_bounds=frame_bounds
    )
    if path is not None:
        from PIL import Image

        stream = io.BytesIO()
        Image.fromarray(picture).save(stream, "PNG")
        write_file(path, stream.getvalue())
    return picture


class _Ground(NamedTuple):
    """A square of floor with the soft shadow of what stands on it; it darkens the backdrop and hides nothing."""

    middle: Floats
    half_width: float
    level: float
    hidden: Floats

    @classmethod
    def under(cls, body: Surface, surfaces: list[Surface], reach: float) -> _Ground:
        """The floor at the body's lowest point; shadows of everything fall on it."""
        from scipy.ndimage import gaussian_filter

        low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
        half_width = float((high - low)[:2].max() / 2) + 0.3 * reach
        steps = np.linspace(-1, 1, _GROUND_CELLS, dtype=np.float32)
        x, y = (values.ravel() for values in np.meshgrid(steps, steps))
        middle = (low + high)[:2] / 2
        points = np.column_stack([half_width * x + middle[0], half_width * y + middle[1], np.full(x.size, low[2])])
        up = np.tile(np.float32([0, 0, 1]), (len(points), 1))
        hidden = 1 - open_sky(surfaces, points.astype(np.float32), up, _GROUND_RAYS, reach)
        fade = np.clip(2 - 2 * np.hypot(x, y), 0, 1)  # no rim where the square ends
        darkness = (_GROUND_DARKNESS * hidden * fade).reshape(_GROUND_CELLS, _GROUND_CELLS)
        return cls(middle, half_width, float(low[2]), gaussian_filter(darkness, 0.8).astype(np.float32))

    def darken(self, picture: Floats, camera: Camera) -> None:
        """Take the shadow's share of the light from the pixels (height, width, 3) of a backdrop."""
        from scipy.ndimage import map_coordinates

        height, width = picture.shape[:2]
        if camera.eye[2] <= self.level:
            return
        offsets = self.half_width * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners = np.column_stack([self.middle + offsets, np.full(4, self.level)])
        bounds = camera.project(corners)[:, 1]
        top, bottom = np.clip([np.floor(bounds.min()), np.ceil(bounds.max())], 0, height).astype(int).tolist()
        if top == bottom:
            return
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(top, bottom) + 0.5)
        directions = camera.directions(x.ravel(), y.ravel())
        # The camera looks from above, and in these rows every ray meets the floor.
        distance = (self.level - camera.eye[2]) / np.minimum(directions[:, 2], -1e-9)
        floor = camera.eye[:2] + distance[:, None] * directions[:, :2]
        cells = ((floor - self.middle) / self.half_width + 1) / 2 * (_GROUND_CELLS - 1)
        hidden = map_coordinates(self.hidden, [cells[:, 1], cells[:, 0]], order=1, mode="constant")
        picture[top:bottom] *= 1 - hidden.reshape(bottom - top, width, 1)


def _covered(corners: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels (height, width) in the bounding boxes of triangles with pixel coordinates (m, 3, 2)."""
    width, height = size
    left, top = np.clip(np.floor(corners.min(axis=1)), 0, size).astype(np.int64).T
    right, bottom = np.clip(np.floor(corners.max(axis=1)) + 1, 0, size).astype(np.int64).T
    # +1 and -1 at the corners of the boxes, summed over rows and columns, count the boxes over each pixel.
    cells = np.concatenate([top, bottom, top, bottom]) * (width + 1) + np.concatenate([left, right, right, left])
    signs = np.repeat([1, 1, -1, -1], len(corners))
    counts = np.bincount(cells, signs, (height + 1) * (width + 1)).reshape(height + 1, width + 1)
    covered: NDArray[np.bool_] = counts.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0.5
    return covered


def _uneven(light: Floats) -> NDArray[np.bool_]:
    """Pixels (h, w) that differ visibly from a neighbour in colour or coverage."""
    shown = np.sqrt(light)
    across = (np.abs(np.diff(shown, axis=1)) > _CONTRAST).any(axis=-1)
    down = (np.abs(np.diff(shown, axis=0)) > _CONTRAST).any(axis=-1)
    marks = np.zeros(light.shape[:2], dtype=bool)
    marks[:, 1:] |= across
    marks[:, :-1] |= across
    marks[1:] |= down
    marks[:-1] |= down
    return marks


def _footer(views: Sequence[str], caption: str | None, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The strip (k, width, 3) below the views: their names, if there are several, and the caption."""
    width, height = size
    if len(views) == 1 and not caption:
        return np.empty((0, width, 3), dtype=np.uint8)
    from PIL import Image, ImageDraw, ImageFont

    small, large = max(10, height // 62), max(11, height // 50)
    lines = [(part.strip(), large) for part in (caption or "").splitlines() if part.strip()]
    strip = round(0.6 * large) + sum(round(1.5 * part_size) for _, part_size in lines)
    strip += round(1.5 * small) if len(views) > 1 else 0
    if 3 * strip > height:
        raise ClothError(f"picture: {width} x {height} pixels leave no room for the caption; make it larger")
    ink = tuple(round(255 * part) for part in _INK)
    image = Image.new("RGB", (width, strip), tuple(round(255 * part) for part in _BOTTOM))
    pen = ImageDraw.Draw(image)
    y = 0.3 * large
    if len(views) > 1:
        font = ImageFont.load_default(small)
        for index, view in enumerate(views):
            x = (index + 0.5) * width / len(views)
            pen.text((x, y + 0.75 * small), view.replace("_", " "), fill=(125, 127, 133), font=font, anchor="mm")
        y += 1.5 * small
    for text, part_size in lines:
        font = ImageFont.load_default(part_size)
        # A line that is too long is set smaller, not cut.
        fitting = part_size * min(1.0, (1 - 2 * 0.02) * width / max(font.getlength(text), 1.0))
        font = ImageFont.load_default(max(fitting, 6.0))
        pen.text((width / 2, y + 0.75 * part_size), text, fill=ink, font=font, anchor="mm")
        y += 1.5 * part_size
    return np.asarray(image)


def _encoded(light: Floats) -> NDArray[np.uint8]:
    """The 8-bit sRGB values of linear light (IEC 61966-2-1)."""
    light = np.clip(light, 0, 1)
    values = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055)
    return (255 * values + 0.5).astype(np.uint8)


def _check_layout(views: Sequence[str], size: tuple[int, int]) -> None:
    unknown = [view for view in views if view not in VIEWS]
    if unknown or not views:
        raise ClothError(f"picture: view {unknown[0] if unknown else ''!r} is unknown; use {', '.join(VIEWS)}")
    width, height = size
    if not (_SMALLEST <= width // len(views) and width <= _LARGEST and _SMALLEST <= height <= _LARGEST):
        raise ClothError(f"picture: {width} x {height} pixels; give {_SMALLEST} to {_LARGEST} each way for each view")


def _finite(what: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ClothError(f"picture: {what} has shape {array.shape}; give finite numbers of shape {shape}")
    return array


def _checked(what: str, vertices: ArrayLike, triangles: ArrayLike) -> tuple[Floats, NDArray[np.int32]]:
    """Arrays as Embree takes them, once they are a mesh that can be drawn."""
    points, faces = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        shapes = f"vertices have shape {points.shape}, triangles {faces.shape}"
        raise ClothError(f"picture: {what}: {shapes}; give (n, 3) and (m, 3)")
    if len(faces) == 0:
        raise ClothError(f"picture: {what} has no triangles; leave it out or give some")
    broken = int((~np.isfinite(points)).any(axis=1).sum())
    if broken:
        raise ClothError(f"picture: {what} has {broken} vertices that are not finite; draw an earlier state")
    if faces.min() < 0 or faces.max() >= len(points):
        raise ClothError(f"picture: {what} has a triangle with a vertex outside 0..{len(points) - 1}; mend its indices")
    # Adding 0 turns -0 into 0, so that equal positions are equal bytes.
    return np.ascontiguousarray(points + 0.0, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.int32)
