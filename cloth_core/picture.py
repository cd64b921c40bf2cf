"""Pictures of garments and bodies, ray cast on the CPU: no display, no OpenGL, the same bytes every time.

Views from named sides stand next to each other at one scale, over a soft contact shadow and a caption.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cloth_core.camera import VIEWS, Camera
from cloth_core.errors import ClothError
from cloth_core.mesh_files import write_file
from cloth_core.shading import Obstacles, Rays, Surface, linear_light, shade

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float32]
    Mesh = tuple[ArrayLike, ArrayLike]
    ColouredMesh = tuple[ArrayLike, ArrayLike, Sequence[float]]

__all__ = ["BODY_COLOUR", "Renderer", "draw"]

BODY_COLOUR = (0.83, 0.785, 0.745)
"""Colour of the body, sRGB in 0..1: a mannequin, no skin."""

_TOP = np.array([0.955, 0.957, 0.962], dtype=np.float32)
_BOTTOM = np.array([0.845, 0.848, 0.856], dtype=np.float32)
_INK, _FAINT_INK = (59, 60, 66), (125, 127, 133)
_GROUND_CELLS, _GROUND_RAYS, _GROUND_DARKNESS = 56, 256, 0.85
_CONTRAST = 0.035  # of the square root of light, which is about even to the eye
_RAYS_AT_A_TIME = 1 << 18
_SMALLEST, _LARGEST, _NAMED_FROM = 16, 16384, 180  # pixels


class Renderer:
    """Draws garments on one body, frame after frame; what depends on the body alone is made once."""

    def __init__(self, body: Mesh | None = None, *, samples: int = 3, occlusion_rays: int = 64) -> None:
        """Prepare the body, vertices [m] (n, 3) and triangles (m, 3).

        Parameters
        ----------
        body
            what the garments are drawn on, or None.
        samples
            pixels that differ from their neighbours are traced again with samples x samples rays; 1 leaves
            them as they are.
        occlusion_rays
            directions, spread over the sphere, in which each vertex looks for the sky; 0 leaves out
            ambient occlusion and cast shadows, for quick frames.

        Raises
        ------
        ClothError
            the body is empty, not finite or not a mesh, or embreex is not installed.
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

        Parameters
        ----------
        garments
            (vertices [m] (n, 3), triangles (m, 3), colour) of each; colour is red, green, blue in 0..1, sRGB.
        views
            names out of `cloth_core.camera.VIEWS`.
        size
            width and height of the whole picture [pixels].
        caption
            text below the picture.
        focus
            centre (3,) and radius [m] of what shall fill each view; without it everything does.
        frame_bounds
            lowest and highest corner [m], shape (2, 3), of what the camera frames instead of the meshes
            themselves, so that the frames of a film share one camera.

        Returns
        -------
        Picture, shape (height, width, 3).

        Raises
        ------
        ClothError
            nothing to draw, not finite, not a mesh, an unknown view, or an impossible size.
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
        if frame_bounds is not None:
            scene = np.stack(np.meshgrid(*_finite("frame_bounds", frame_bounds, (2, 3)).T), axis=-1).reshape(8, 3)
        frame = scene
        if focus is not None:
            centre, radius = _finite("the centre of focus", focus[0], (3,)), float(focus[1])
            if not 0 < radius < np.inf:
                raise ClothError(f"picture: the radius of focus is {radius} m; give a length above 0")
            frame = centre + radius * np.concatenate([np.eye(3), -np.eye(3)])

        obstacles = Obstacles(surfaces) if self._occlusion_rays else None
        for surface in surfaces:
            surface.light_sky(obstacles, self._occlusion_rays)
        ground = None if self._body is None or obstacles is None else _Ground.under(self._body, obstacles)
        footer = _footer(views, caption, size)
        height = size[1] - len(footer)
        columns = np.linspace(0, size[0], len(views) + 1).astype(int).tolist()
        cameras = Camera.of_views(views, scene, frame, (size[0] // len(views), height))
        picture = np.empty((size[1], size[0], 3), dtype=np.uint8)
        for camera, (left, right) in zip(cameras, pairwise(columns), strict=True):
            picture[:height, left:right] = self._view(camera, surfaces, obstacles, ground, (right - left, height))
        picture[height:] = footer
        return picture

    def _view(
        self,
        camera: Camera,
        surfaces: list[Surface],
        obstacles: Obstacles | None,
        ground: _Ground | None,
        size: tuple[int, int],
    ) -> NDArray[np.uint8]:
        """One view, (height, width, 3): a ray through each pixel, more where neighbours differ (Whitted, 1980)."""
        width, height = size
        down = np.linspace(0, 1, height, dtype=np.float32)[:, None]
        backdrop = linear_light((1 - down) * _TOP + down * _BOTTOM)
        picture = np.repeat(backdrop[:, None], width, axis=1)
        if ground is not None:
            ground.darken(picture, camera)
        covers = [_covered(camera.project(surface.vertices)[surface.triangles], size) for surface in surfaces]
        inside = np.any(covers, axis=0)
        light = np.zeros((height, width, 4), dtype=np.float32)
        light[inside] = self._trace(camera, surfaces, obstacles, covers, inside, 1)
        if self._samples > 1:
            uneven = inside & _uneven(light)
            light[uneven] = self._trace(camera, surfaces, obstacles, covers, uneven, self._samples)
        return _encoded(picture * (1 - light[..., 3:]) + light[..., :3])

    def _trace(
        self,
        camera: Camera,
        surfaces: list[Surface],
        obstacles: Obstacles | None,
        covers: list[NDArray[np.bool_]],
        wanted: NDArray[np.bool_],
        samples: int,
    ) -> Floats:
        """Linear light and coverage (k, 4) of the k wanted pixels, each the mean over samples x samples rays.

        A surface can only be met within its cover (height, width).
        """
        rows, columns = np.nonzero(wanted)
        result = np.empty((len(rows), 4), dtype=np.float32)
        step = max(1, _RAYS_AT_A_TIME // samples**2)
        for start in range(0, len(rows), step):
            row, column = rows[start : start + step], columns[start : start + step]
            rays = Rays.through(camera, row, column, samples)
            nearest, depth = np.full(len(rays.x), -1), np.full(len(rays.x), np.inf, dtype=np.float32)
            hits = []
            for index, surface in enumerate(surfaces):
                (near,) = np.nonzero(np.repeat(covers[index][row, column], samples**2))
                hit = surface.first_hits(rays.pick(near))
                closer = (hit["primID"] >= 0) & (hit["tfar"] < depth[near])
                near = near[closer]
                nearest[near], depth[near] = index, hit["tfar"][closer]
                hits.append((near, {name: values[closer] for name, values in hit.items()}))
            light = np.zeros((len(rays.x), 4), dtype=np.float32)
            for index, (near, hit) in enumerate(hits):
                seen = nearest[near] == index
                if seen.any():
                    own = {name: values[seen] for name, values in hit.items()}
                    light[near[seen], :3] = shade(surfaces[index], own, rays.pick(near[seen]), obstacles)
                    light[near[seen], 3] = 1
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

    Raises
    ------
    ClothError
        as `Renderer`; also if `path` does not end in .png or cannot be written.
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
    def under(cls, body: Surface, obstacles: Obstacles) -> _Ground:
        """The floor at the body's lowest point; shadows of everything fall on it."""
        from scipy.ndimage import gaussian_filter

        low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
        half_width = float((high - low)[:2].max() / 2) + 0.17 * float(high[2] - low[2])
        steps = np.linspace(-1, 1, _GROUND_CELLS, dtype=np.float32)
        x, y = (values.ravel() for values in np.meshgrid(steps, steps))
        middle = (low + high)[:2] / 2
        points = np.column_stack([half_width * x + middle[0], half_width * y + middle[1], np.full(x.size, low[2])])
        up = np.tile(np.array([0, 0, 1], dtype=np.float32), (len(points), 1))
        hidden = 1 - obstacles.open_sky(points.astype(np.float32), up, _GROUND_RAYS)
        fade = np.clip(1.4 - 1.4 * np.hypot(x, y), 0, 1)  # no rim where the square ends
        darkness = (_GROUND_DARKNESS * hidden * fade).reshape(_GROUND_CELLS, _GROUND_CELLS)
        return cls(middle, half_width, float(low[2]), gaussian_filter(darkness, 1.0).astype(np.float32))

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
    a, b, c = (corners[:, k] for k in range(3))
    left, top = np.clip(np.minimum(np.minimum(a, b), c), 0, size).astype(np.int64).T
    right, bottom = np.clip(np.maximum(np.maximum(a, b), c) + 1, 0, size).astype(np.int64).T
    # +1 and -1 at the corners of the boxes, summed over rows and columns, count the boxes over each pixel.
    cells = np.concatenate([top, bottom, top, bottom]) * (width + 1) + np.concatenate([left, right, right, left])
    signs = np.repeat([1, 1, -1, -1], len(corners))
    counts = np.bincount(cells, signs, (height + 1) * (width + 1)).astype(np.int32)
    covered: NDArray[np.bool_] = counts.reshape(height + 1, width + 1).cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
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
    """The strip (k, width, 3) below the views: their names, if there are several and there is room, and the caption."""
    width, height = size
    named = len(views) > 1 and height >= _NAMED_FROM
    if not named and not caption:
        return np.empty((0, width, 3), dtype=np.uint8)
    from PIL import Image, ImageDraw, ImageFont

    small, large = max(10, height // 62), max(11, height // 50)
    lines = [line.strip() for line in (caption or "").splitlines() if line.strip()]
    names_height = 1.5 * small if named else 0.0
    strip = round(0.6 * large + names_height + 1.5 * large * len(lines))
    if 3 * strip > height:
        raise ClothError(f"picture: {width} x {height} pixels leave no room for the caption; make it larger")
    image = Image.new("RGB", (width, strip), tuple(np.rint(255 * _BOTTOM).astype(int).tolist()))
    pen = ImageDraw.Draw(image)
    if named:
        font = ImageFont.load_default(small)
        for index, view in enumerate(views):
            place = ((index + 0.5) * width / len(views), 0.3 * large + names_height / 2)
            pen.text(place, view.replace("_", " "), fill=_FAINT_INK, font=font, anchor="mm")
    for index, line in enumerate(lines):
        # A line that is too long is set smaller, not cut.
        length = ImageFont.load_default(large).getlength(line)
        font = ImageFont.load_default(max(large * min(1.0, 0.96 * width / length), 6.0))
        place = (width / 2, 0.3 * large + names_height + 1.5 * large * (index + 0.5))
        pen.text(place, line, fill=_INK, font=font, anchor="mm")
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
