"""Pictures are held against what geometry and light say they must show, not against stored pictures."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image

from cloth_core.camera import LENS, MARGIN, VIEWS, Camera
from cloth_core.errors import ClothError
from cloth_core.picture import Renderer, draw
from cloth_core.shading import Obstacles, Surface, _rounded

RED, BLUE, GREEN = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8), (0.1, 0.7, 0.1)
FILLED = 1 - 2 * MARGIN


def ball(centre=(0, 0, 0), radius=1.0):
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return np.asarray(sphere.vertices) + centre, np.asarray(sphere.faces)


def square(y, size=1.0, centre=(0.0, 0.0), wrong_side=False):
    """An upright square that faces -y, or turns its wrong side there."""
    x, z = size / 2 * np.array([-1, 1, 1, -1]) + centre[0], size / 2 * np.array([-1, -1, 1, 1]) + centre[1]
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return np.column_stack([x, np.full(4, y), z]), triangles[:, ::-1] if wrong_side else triangles


def quick(garments, body=None, **options):
    options = {"views": ("front",), "size": (200, 200)} | options
    return Renderer(body, samples=1, occlusion_rays=0).render(garments, **options)


def share(picture, channel):
    """How strongly each pixel is of one colour: 0 on grey backdrop and body, 1 on most of a coloured cloth."""
    colour = picture.astype(float)
    others = np.delete(colour, channel, axis=-1).max(axis=-1)
    return np.clip((colour[..., channel] - others - 20) / 20, 0, 1)


def centroid(weights):
    """Centre of mass (x, y) in pixel coordinates."""
    y, x = np.indices(weights.shape) + 0.5
    return np.array([(weights * x).sum(), (weights * y).sum()]) / weights.sum()


def test_sphere_has_the_silhouette_of_its_tangent_cone():
    picture = draw(None, [(*ball(centre=(3.0, -2.0, 5.0)), RED)], views=("front",), size=(400, 300))
    red = share(picture, 0)
    assert red.sum() == pytest.approx(np.pi * (FILLED * 300 / 2) ** 2, rel=0.01)
    np.testing.assert_allclose(centroid(red), [200, 150], atol=0.2)
    assert red.max(axis=0).sum() == pytest.approx(red.max(axis=1).sum(), abs=1.5)


@pytest.mark.parametrize("view", VIEWS)
def test_points_fall_where_a_pinhole_puts_them(view):
    """With fixed bounds, a small sphere is found where a pinhole camera, written out here, projects its centre."""
    low, high, centre = np.array([-1.0, -1.2, -0.8]), np.array([1.0, 0.9, 1.1]), np.array([0.4, -0.3, 0.5])
    picture = quick([(*ball(centre, 0.2), RED)], views=(view,), size=(320, 240), frame_bounds=(low, high))

    azimuth, elevation = np.radians(VIEWS[view])
    stand = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    eye = (low + high) / 2 + LENS * np.linalg.norm(high - low) / 2 * stand
    right = np.cross(-stand, [0, 0, 1]) / np.cos(elevation)
    up = np.cross(right, -stand)

    def tangents(point):
        depth = (point - eye) @ -stand
        return np.array([(point - eye) @ right / depth, -((point - eye) @ up) / depth])

    corners = [tangents(np.where(bits, low, high)) for bits in np.ndindex(2, 2, 2)]
    least, most = np.min(corners, axis=0), np.max(corners, axis=0)
    scale = min(FILLED * np.array([320, 240]) / (most - least))
    expected = np.array([160, 120]) + scale * (tangents(centre) - (least + most) / 2)
    np.testing.assert_allclose(centroid(share(picture, 0)), expected, atol=0.6)


def test_flat_square_covers_its_projection():
    picture = draw(None, [(*square(0.0), GREEN)], views=("front",), size=(240, 300))
    green = share(picture, 1)
    side = FILLED * 240
    assert green.sum() == pytest.approx(side**2 * np.cos(np.radians(3)), rel=0.02)
    columns, rows = green.max(axis=0) > 0.5, green.max(axis=1) > 0.5
    np.testing.assert_allclose([np.flatnonzero(columns)[0], np.flatnonzero(columns)[-1] + 1], [12, 228], atol=1)
    assert rows.sum() == pytest.approx(side * np.cos(np.radians(3)), abs=2)


def test_directions_and_projection_are_inverse():
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (200, 3))
    for camera in Camera.of_views(list(VIEWS), points, points, (640, 480)):
        pixels = camera.project(points)
        depth = (points - camera.eye) @ camera.axes[2]
        again = camera.eye + depth[:, None] * camera.directions(*pixels.T)
        np.testing.assert_allclose(again, points, atol=1e-5)
        assert (pixels > 0).all()
        assert (pixels < [640, 480]).all()


@pytest.mark.parametrize(("view", "channel"), [("front", 0), ("back", 2)])
def test_front_shows_what_is_at_minus_y(view, channel):
    picture = quick([(*square(-0.2), RED), (*square(0.2), BLUE)], views=(view,))
    hidden = 2 - channel
    assert share(picture, channel).sum() > 0.7 * 200**2
    assert share(picture, hidden).sum() < 0.05 * share(picture, channel).sum()


@pytest.mark.parametrize(("view", "channel"), [("left", 0), ("right", 2)])
def test_left_is_the_left_side_of_the_body(view, channel):
    """A body that faces -y has its left hand at +x."""
    picture = quick([(*ball((0.3, 0, 0), 0.25), RED), (*ball((-0.3, 0, 0), 0.25), BLUE)], views=(view,))
    assert share(picture, channel).sum() > 50 * max(share(picture, 2 - channel).sum(), 1)


def test_views_stand_side_by_side_at_one_scale():
    garments = [(*ball((0.5, 0, 0), 0.3), RED), (*ball((-0.5, 0, 0), 0.2), BLUE)]
    picture = quick(garments, views=("front", "back"), size=(400, 200))
    front, back = picture[:190, :200], picture[:190, 200:]
    assert centroid(share(front, 0))[0] > centroid(share(front, 2))[0]
    assert centroid(share(back, 0))[0] < centroid(share(back, 2))[0]
    assert share(front, 0).sum() == pytest.approx(share(back, 0).sum(), rel=0.03)


def test_surfaces_that_cross_hide_each_other_on_one_side_each():
    """Two upright squares turned about z by +-30 degrees: left of the axis one is nearer, right of it the other."""
    vertices, triangles = square(0.0)
    turned = []
    for angle in np.radians([30, -30]):
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        turned.append(vertices @ turn.T)
    picture = quick([(turned[0], triangles, RED), (turned[1], triangles, BLUE)])[30:170]
    assert share(picture[:, 30:95], 0).min() == 1
    assert share(picture[:, 105:170], 2).min() == 1


def test_body_hides_and_is_hidden():
    body = ball()
    bounds = [[-1, -1.5, -1], [1, 1.5, 1]]
    front, behind = (quick([(*square(y, 0.6), RED)], body, frame_bounds=bounds) for y in (-1.3, 1.3))
    assert share(front, 0).sum() > 1500
    assert share(behind, 0).sum() == 0
    bare = quick([], body, frame_bounds=bounds)
    np.testing.assert_array_equal(behind, bare)
    backdrop = np.abs(bare.astype(int) - bare[:, :1]).max(axis=-1) == 0
    assert (~backdrop).sum() > 8000


def test_wrong_side_is_darker():
    right, wrong = (quick([(*square(0.0, wrong_side=side), RED)])[60:140, 60:140, 0].mean() for side in (False, True))
    assert 0.4 * right < wrong < 0.85 * right


def test_cut_edges_are_drawn_and_inner_edges_are_not():
    red = quick([(*square(0.0), RED)])[..., 0].astype(int)
    middle = red[100]
    inside = np.flatnonzero(np.abs(middle - middle[100]) > 4)
    assert set(inside[inside < 100]) & {10, 11}
    assert not set(inside) & set(range(14, 186))


def test_open_sky_under_a_disc_is_one_minus_the_form_factor():
    """A disc of radius r at height h over a point hides r^2 / (r^2 + h^2) of its cosine-weighted sky."""
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius, height = 0.7, 0.5
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(400, height)])
    vertices = np.concatenate([[[0, 0, height]], rim]).astype(np.float32)
    corner = np.arange(400)
    triangles = np.column_stack([np.zeros(400), 1 + corner, 1 + (corner + 1) % 400]).astype(np.int32)
    disc = Surface(vertices, triangles, GREEN, cloth=True)
    point, up = np.zeros((1, 3), dtype=np.float32), np.array([[0, 0, 1]], dtype=np.float32)
    expected = 1 - radius**2 / (radius**2 + height**2)
    assert Obstacles([disc]).open_sky(point, up, 20_000)[0] == pytest.approx(expected, abs=0.005)
    assert Obstacles([disc]).open_sky(point, -up, 1000)[0] == pytest.approx(1)


def test_shadow_falls_away_from_the_key_light():
    """The light stands left, above and before the picture at (-0.70, 0.75, 0.75): the shadow shifts to match."""
    wall, gap = square(0.0, 2.0), 0.3
    bounds = [[-1, -gap, -1], [1, 0, 1]]
    options = {"views": ("front",), "size": (400, 400), "frame_bounds": bounds}
    plain = draw(None, [(*wall, GREEN)], **options).astype(float)
    shaded = draw(None, [(*wall, GREEN), (*square(-gap, 0.3), RED)], **options)
    dark = np.clip(plain[..., 1] - shaded[..., 1] - 25, 0, 20) * (share(shaded, 0) == 0)
    pixels_per_metre = FILLED * 400 / 2
    red = centroid(share(shaded, 0))
    # What the red square itself hides is part of the shadow: compare the far corner of the dark patch.
    rows, columns = np.nonzero(dark > 10)
    far = np.array([np.percentile(columns, 99.5), np.percentile(rows, 99.5)])
    expected = red + pixels_per_metre * (0.15 + gap * np.array([0.70, 0.75]) / 0.75)
    np.testing.assert_allclose(far, expected, atol=8)


def test_seams_of_panels_are_shaded_as_one_surface():
    """Two half cylinders that meet in two seams have the cylinder's own normals there."""
    halves, triangles = [], []
    for start in (0.0, np.pi):
        angles = np.linspace(start, start + np.pi, 21)
        base = 42 * len(halves)
        halves.append(
            np.concatenate([np.column_stack([np.cos(angles), np.sin(angles), np.full(21, z)]) for z in (0, 1)])
        )
        low = base + np.arange(20)
        triangles += [np.column_stack([low, low + 1, low + 21]), np.column_stack([low + 1, low + 22, low + 21])]
    vertices = np.round(np.concatenate(halves), 6).astype(np.float32) + np.float32(0)
    surface = Surface(vertices, np.concatenate(triangles).astype(np.int32), RED, cloth=True)
    # Corners of 9 degrees: area-weighted normals stray by up to a third of 4.5, those of one panel by all of it.
    across = np.cross(surface.normals, vertices * [1, 1, 0])[:, 2]
    assert np.abs(across).max() < np.sin(np.radians(1.6))
    # The last vertices of one half lie on the first of the other.
    np.testing.assert_array_equal(surface.normals[[20, 41]], surface.normals[[42, 63]])


def test_panels_folded_flat_keep_a_normal_each():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, 0], [1, 0, 0], [0, 0, 1]], dtype=np.float32)
    surface = Surface(vertices, np.array([[0, 1, 2], [3, 5, 4]], dtype=np.int32), RED, cloth=True)
    np.testing.assert_allclose(surface.normals, [[0, -1, 0]] * 3 + [[0, 1, 0]] * 3)


def test_outlines_alone_are_smoothed():
    """More samples change the pixels along the outline, a circle here, and no others."""
    garments, options = [(*ball(), RED)], {"views": ("front",), "size": (120, 120)}
    rough = quick(garments, **options)
    smooth = Renderer(samples=4, occlusion_rays=0).render(garments, **options)
    radius = FILLED * 60
    changed = (np.abs(smooth.astype(int) - rough).max(axis=-1) > 3).sum()
    assert changed == pytest.approx(2 * np.pi * radius, rel=0.5)
    distance = np.hypot(*(np.indices((120, 120)) + 0.5 - 60))
    assert changed == (np.abs(smooth.astype(int) - rough).max(axis=-1) > 3)[np.abs(distance - radius) < 1.5].sum()


def test_same_input_gives_the_same_bytes(tmp_path):
    body, garments = ball(), [(*square(-1.2), RED), (*ball((0.4, -0.9, 0.5), 0.3), GREEN)]
    for name in ("first.png", "second.png"):
        draw(tmp_path / name, garments, body, size=(300, 200), caption="at rest after 2.0 s")
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def test_file_holds_the_picture_that_is_returned(tmp_path):
    picture = draw(tmp_path / "ball.png", [(*ball(), RED)], size=(160, 120))
    assert picture.shape == (120, 160, 3)
    assert picture.dtype == np.uint8
    with Image.open(tmp_path / "ball.png") as image:
        assert image.format == "PNG"
        np.testing.assert_array_equal(np.asarray(image), picture)


def test_frames_of_a_film_share_the_camera():
    """With fixed bounds a garment may move without moving the picture of the body."""
    body, bounds = ball(), [[-2, -1, -1], [2, 1, 1]]
    renderer = Renderer(body, samples=1, occlusion_rays=0)
    options = {"views": ("front",), "size": (300, 160), "frame_bounds": bounds}
    frames = [renderer.render([(*ball((x, 0, 0), 0.3), RED)], **options) for x in (-1.6, 1.6)]
    untouched = slice(90, 210)
    np.testing.assert_array_equal(frames[0][:, untouched], frames[1][:, untouched])
    assert centroid(share(frames[0], 0))[0] < 90
    assert centroid(share(frames[1], 0))[0] > 210


def test_focus_frames_a_sphere_around_a_point():
    far = ball((5.0, 0, 0))
    picture = quick([(*ball((0, 0, 2.0), 0.2), RED), (*far, BLUE)], focus=((0, 0, 2.0), 0.4))
    red = share(picture, 0)
    np.testing.assert_allclose(centroid(red), [100, 100], atol=1)
    assert red.sum() == pytest.approx(np.pi * (FILLED * 200 / 4) ** 2, rel=0.03)
    assert share(picture, 2).sum() == 0


def test_contact_shadow_darkens_the_floor_below_the_body():
    body = ball((0, 0, 1.0))
    bounds = [[-2, -2, 0], [2, 2, 2]]
    options = {"views": ("front",), "size": (300, 200), "frame_bounds": bounds}
    with_floor, without = draw(None, [], body, **options).astype(int), quick([], body, **options).astype(int)
    darker = (without - with_floor)[..., 0]
    rows = np.flatnonzero((without[:, 150] != without[:, 0]).any(axis=-1))
    below = rows[-1] + 1
    assert darker[below : below + 3, 140:160].min() > 15
    assert np.abs(darker[: rows[0] - 1]).max() == 0


def test_caption_is_written_below_within_the_size():
    garments = [(*ball(), RED)]
    plain = quick(garments, size=(300, 200))
    captioned = quick(garments, size=(300, 200), caption="a caption that is far too long for this picture, " * 2)
    assert captioned.shape == plain.shape
    ink = (captioned.max(axis=-1) < 150) & (share(captioned, 0) == 0)
    rows, columns = np.nonzero(ink)
    assert rows.min() > 170
    assert columns.min() > 2
    assert columns.max() < 297
    assert ink.sum() > 100
    assert centroid(share(captioned, 0))[1] < centroid(share(plain, 0))[1]


SHEET = (*square(0.0), RED)


@pytest.mark.parametrize(
    ("garments", "options", "reason"),
    [
        ([], {}, "nothing to draw"),
        ([(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), RED)], {}, "garment 0 has no triangles"),
        ([SHEET, (SHEET[0] * np.nan, SHEET[1], RED)], {}, "garment 1 has 4 vertices that are not finite"),
        ([(SHEET[0], SHEET[1] + 1, RED)], {}, "outside 0..3"),
        ([(SHEET[0][:, :2], SHEET[1], RED)], {}, "shape"),
        ([(*SHEET[:2], (200, 10, 10))], {}, "colour of garment 0"),
        ([SHEET], {"views": ("above",)}, "view 'above' is unknown; use front, back, left, right, three_quarter"),
        ([SHEET], {"views": ()}, "unknown"),
        ([SHEET], {"size": (0, 100)}, "0 x 100 pixels"),
        ([SHEET], {"size": (40, 20), "caption": "text"}, "no room"),
        ([SHEET], {"focus": ((0, 0, 0), -1.0)}, "focus"),
        ([SHEET], {"frame_bounds": [[0, 0, 0], [np.inf, 1, 1]]}, "frame_bounds"),
        ([SHEET], {"path": "picture.jpg"}, ".png"),
        ([SHEET], {"path": "nowhere/picture.png"}, "cannot be written"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_one_line(tmp_path, monkeypatch, garments, options, reason):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ClothError) as caught:
        draw(options.pop("path", None), garments, **({"size": (64, 64)} | options))
    assert reason in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_missing_embree_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(ClothError, match="pip install embreex"):
        draw(None, [SHEET])


def test_import_loads_no_renderer():
    code = (
        "import sys, cloth_core.picture; print([m for m in ('embreex', 'PIL', 'trimesh', 'scipy') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("slope", [20.0, 40.0, 70.0, 85.0])
def test_facets_are_rounded_for_shadows_but_not_at_a_sharp_crease(slope):
    # A roof: the normals at its ridge point up and lean away from those of its sides by their slope.
    rise = np.tan(np.radians(slope))
    corners = [[-1.0, 0, -rise], [-1.0, 3, -rise], [0.0, 0, 0], [0.0, 3, 0], [1.0, 0, -rise], [1.0, 3, -rise]]
    vertices = np.array(corners, dtype=np.float32)
    triangles = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]], dtype=np.int32)
    surface = Surface(vertices, triangles, (0.5, 0.5, 0.5), cloth=False)
    across, along = np.sin(np.radians(slope)), np.cos(np.radians(slope))
    left, up, right = [-across, 0.0, along], [0.0, 0.0, 1.0], [across, 0.0, along]
    surface.normals = np.array([left, left, up, up, right, right], dtype=np.float32)
    weights = np.full((len(triangles), 3), 1 / 3, dtype=np.float32)
    points = _rounded(surface, triangles, weights, np.ones((len(triangles), 1), dtype=np.float32))
    lifted = points - vertices[triangles].mean(axis=1)
    if slope > 60.0:
        np.testing.assert_allclose(lifted, 0.0, atol=1e-6)
    else:
        assert (lifted[:, 2] > 0.1 * rise).all()
