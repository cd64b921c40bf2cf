"""Pictures and films of a log."""

import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cloth_core.errors import ClothError
from cloth_sim_ros.log_reader import LoggedFrame, LogReader
from cloth_sim_ros.log_writer import LogError

if TYPE_CHECKING:
    from cloth_core.picture import Renderer

__all__ = ["render_log"]

FloatArray = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Progress = Callable[[int, int], None]

PICTURE_SIZE = (1600, 1000)
FILM_SIZE = (800, 600)
MOST_FRAMES = {".gif": 100, ".mp4": 300}
"""Above, a film takes fewer frames a second instead of fewer seconds."""
FINAL_HOLD = 1.0
"""How long a film rests on its last frame [s]."""


def render_log(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    views: Sequence[str] = ("front", "back"),
    size: tuple[int, int] | None = None,
    frame_rate: float = 25.0,
    progress: Progress | None = None,
) -> None:
    """Draws the last frame of a log into a .png, or all of it into a .gif or .mp4 that runs in simulated time.

    Args:
        path: the log
        output: file to be written; its suffix decides what is made
        views: sides to look from, next to each other; names of `cloth_core.camera.VIEWS`
        size: width and height [pixels]; by default 1600 x 1000 for a picture and 800 x 600 for a film
        frame_rate: frames a second of a film, fewer if it would have more than 100 (GIF) or 300 (MP4)
        progress: called with the frames done and the frames in all

    Raises:
        LogError: the log cannot be read or holds no frame.
        ClothError: the output cannot be made.
    """
    target = Path(output)
    suffix = target.suffix.lower()
    if suffix not in (".png", *MOST_FRAMES):
        raise ClothError(f"{target}: pictures of type '{suffix}' are not made; use .png, .gif or .mp4")
    if not (math.isfinite(frame_rate) and 0.0 < frame_rate <= 100.0):
        raise ClothError(f"{target}: {frame_rate} frames a second; use more than 0 and at most 100")
    with LogReader(path) as log:
        if suffix == ".png":
            _write_picture(log, target, views, size or PICTURE_SIZE, progress)
        else:
            _write_film(log, target, views, size or FILM_SIZE, frame_rate, progress)


def _write_picture(
    log: LogReader, target: Path, views: Sequence[str], size: tuple[int, int], progress: Progress | None
) -> None:
    from cloth_core.picture import Renderer

    last = None
    for last in log.frames():  # noqa: B007
        pass
    if last is None:
        raise _no_frame(log)
    picture = Renderer(log.body()).render([_garment(last)], views=views, size=size)
    _replace_when_written(target, lambda part: _save_picture(picture, part))
    if progress is not None:
        progress(1, 1)


def _write_film(
    log: LogReader,
    target: Path,
    views: Sequence[str],
    size: tuple[int, int],
    frame_rate: float,
    progress: Progress | None,
) -> None:
    from cloth_core.picture import Renderer

    times, bounds = _times_and_bounds(log)
    if not times:
        raise _no_frame(log)
    duration = times[-1] - times[0]
    rate = min(frame_rate, (MOST_FRAMES[target.suffix.lower()] - 1) / max(duration, 1.0 / frame_rate))
    count = 1 + math.ceil(duration * rate)
    chosen = [_latest(times, times[0] + number / rate) for number in range(count)]
    renderer = Renderer(log.body(), occlusion_rays=0)
    pictures = _pictures(log, renderer, chosen, bounds, views, size, progress)
    save = _save_gif if target.suffix.lower() == ".gif" else _save_mp4
    _replace_when_written(target, lambda part: save(pictures, part, rate))


def _no_frame(log: LogReader) -> LogError:
    return LogError(f"log {log.path}: it holds no frame of a garment; record a run")


def _garment(frame: LoggedFrame) -> tuple[FloatArray, npt.NDArray[np.int32], tuple[float, ...]]:
    return (*frame.mesh(), frame.color[:3])


def _times_and_bounds(log: LogReader) -> tuple[list[float], FloatArray]:
    """Time of each frame [s], and the box (2, 3) [m] that holds everything, so that the camera stands still."""
    body = log.body()
    points = np.empty((0, 3)) if body is None else body[0]
    times = []
    for frame in log.frames():
        times.append(frame.time)
        corners = frame.corners.reshape(-1, 3)
        points = np.concatenate((corners, points))
        points = np.array((points.min(axis=0), points.max(axis=0)))
    return times, points


def _latest(times: list[float], moment: float) -> int:
    """Number of the last frame that is not later than `moment`; rounding shall not cost a frame."""
    return int(np.searchsorted(times, moment + 1e-9, side="right")) - 1


def _pictures(
    log: LogReader,
    renderer: "Renderer",
    chosen: list[int],
    bounds: FloatArray,
    views: Sequence[str],
    size: tuple[int, int],
    progress: Progress | None,
) -> Iterator[Picture]:
    """A picture for each chosen frame number; a number that repeats is drawn once."""
    done = 0
    for number, frame in enumerate(log.frames()):
        repeats = chosen.count(number)
        if repeats == 0:
            continue
        picture = renderer.render([_garment(frame)], views=views, size=size, frame_bounds=bounds)
        for _ in range(repeats):
            done += 1
            if progress is not None:
                progress(done, len(chosen))
            yield picture


def _save_picture(picture: Picture, path: Path) -> None:
    from PIL import Image

    Image.fromarray(picture).save(path, format="PNG")


def _save_gif(pictures: Iterator[Picture], path: Path, rate: float) -> None:
    from PIL import Image

    images = [Image.fromarray(picture).quantize(256) for picture in pictures]
    # GIF counts in hundredths of a second: the error is carried on, so that the film keeps its time.
    ends = [round(100 * (number + 1) / rate) for number in range(len(images))]
    durations = [10 * (end - start) for start, end in zip([0, *ends], ends, strict=False)]
    durations[-1] += round(1000 * FINAL_HOLD)
    images[0].save(path, format="GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)


def _save_mp4(pictures: Iterator[Picture], path: Path, rate: float) -> None:
    import imageio.v2 as imageio

    # Two pixels are the smallest block of yuv420p, the pixel format that every player knows.
    film: Any = imageio.get_writer(
        path, format="FFMPEG", fps=rate, codec="libx264", pixelformat="yuv420p", macro_block_size=2, quality=8
    )
    with film:
        for picture in pictures:
            film.append_data(picture)
        for _ in range(round(FINAL_HOLD * rate)):
            film.append_data(picture)


def _replace_when_written(target: Path, write: Callable[[Path], None]) -> None:
    """Writes beside the target and renames, so that nobody finds half a file."""
    part = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    try:
        write(part)
        os.replace(part, target)
    except OSError as error:
        raise ClothError(f"{target}: {error.strerror or error}; choose a directory that can be written") from None
    finally:
        part.unlink(missing_ok=True)
