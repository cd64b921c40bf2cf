"""Pictures and films of a log: the right frames at the right times, by what is on them."""

import imageio.v2 as imageio
import numpy as np
import pytest
from PIL import Image
from small_scenes import BOX_TRIANGLES, BOX_VERTICES

from cloth_core.body import Body
from cloth_core.errors import ClothError
from cloth_sim_ros.log_writer import LogError, LogWriter
from cloth_sim_ros.render import render_log
from cloth_sim_ros.run_messages import GARMENT_COLOR
from cloth_sim_ros.run_recorder import RunRecorder

SIZE = (160, 120)
SQUARE = np.array([[-0.2, -0.3, 0.0], [0.2, -0.3, 0.0], [0.2, -0.3, 0.1], [-0.2, -0.3, 0.1]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
# A square in front of a box falls by half a metre in half a second, in uneven steps of time.
TIMES = [0.0, 0.04, 0.08, 0.2, 0.4, 0.5]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with RunRecorder(path, ["{}"], Body.from_arrays(BOX_VERTICES, BOX_TRIANGLES), {}) as recorder:
        for time in TIMES:
            recorder.frame(time, SQUARE + np.array([0.0, 0.0, 0.4 - time]), TRIANGLES)
    return path


def height_of_square(picture):
    """Mean row of the garment's pixels, those that are clearly blue."""
    pixels = np.asarray(picture)[..., :3].astype(int)
    rows = np.nonzero(pixels[..., 2] - pixels[..., 0] > 60)[0]
    assert len(rows) > 50
    return rows.mean()


def frames_of(path):
    with Image.open(path) as film:
        for number in range(film.n_frames):
            film.seek(number)
            yield film.info["duration"], np.asarray(film.convert("RGB"))


def test_the_garment_is_blue():
    assert GARMENT_COLOR[2] - GARMENT_COLOR[0] > 0.3


def test_picture_shows_the_last_frame(log, tmp_path):
    render_log(log, tmp_path / "run.png", views=("front",), size=SIZE)
    with Image.open(tmp_path / "run.png") as picture:
        assert picture.size == SIZE
        # The box reaches from -0.1 m to 0.1 m, the square has ended below it.
        assert height_of_square(picture) > 0.6 * SIZE[1]


def test_film_runs_in_simulated_time(log, tmp_path):
    done = []
    path = tmp_path / "run.gif"
    render_log(log, path, views=("front",), size=SIZE, frame_rate=20.0, progress=lambda *count: done.append(count))
    durations, pictures = zip(*frames_of(path), strict=True)
    # 0.5 s at 20 Hz, both ends included, and a second of rest.
    assert sum(durations) == 550 + 1000
    assert done == [(number, 11) for number in range(1, 12)]
    heights = [height_of_square(picture) for picture in pictures]
    starts = np.cumsum([0, *durations[:-1]]) / 1000
    shown = [max(time for time in TIMES if time <= start + 1e-6) for start in starts]
    scale = (heights[-1] - heights[0]) / TIMES[-1]
    assert scale > 50
    assert heights == pytest.approx([heights[0] + scale * time for time in shown], abs=1.5)


def test_film_as_mp4(log, tmp_path):
    path = tmp_path / "run.mp4"
    render_log(log, path, views=("front",), size=SIZE, frame_rate=20.0)
    with imageio.get_reader(path, format="FFMPEG") as film:
        facts = film.get_meta_data()
        heights = [height_of_square(picture) for picture in film]
    assert facts["codec"] == "h264"
    assert facts["pix_fmt"].startswith("yuv420p")
    assert facts["size"] == SIZE
    assert facts["fps"] == 20
    assert len(heights) == 11 + 20
    assert heights[0] < heights[6] < heights[10] == pytest.approx(heights[-1], abs=1)


def test_a_long_film_takes_fewer_frames_a_second(tmp_path):
    path = tmp_path / "long.mcap"
    with RunRecorder(path, ["{}"], None, {}) as recorder:
        for time in (0.0, 40.0):
            recorder.frame(time, SQUARE, TRIANGLES)
    done = []
    render_log(path, tmp_path / "long.gif", views=("front",), size=SIZE, progress=lambda *count: done.append(count))
    assert done[-1] == (100, 100)
    assert sum(duration for duration, _ in frames_of(tmp_path / "long.gif")) == pytest.approx(41_400, abs=10)


def test_what_cannot_be_made_is_refused(log, tmp_path):
    with pytest.raises(ClothError, match=r"type '\.jpg' are not made; use \.png, \.gif or \.mp4"):
        render_log(log, tmp_path / "run.jpg")
    with pytest.raises(ClothError, match=r"use more than 0 and at most 100"):
        render_log(log, tmp_path / "run.gif", frame_rate=0.0)
    with pytest.raises(ClothError, match="No such file or directory; choose a directory"):
        render_log(log, tmp_path / "missing" / "run.png", views=("front",), size=SIZE)
    with pytest.raises(ClothError, match="view 'top' is unknown"):
        render_log(log, tmp_path / "run.mp4", views=("top",))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["png", "gif"])
def test_a_log_without_a_garment_is_refused(tmp_path, suffix):
    LogWriter(tmp_path / "empty.mcap").close()
    with pytest.raises(LogError, match="holds no frame of a garment"):
        render_log(tmp_path / "empty.mcap", tmp_path / f"run.{suffix}")
