"""From pattern to particles: masses, matched seams, shared corner points, darts, numbering, several garments."""

import math
from dataclasses import fields

import numpy as np
import pytest
from apparatus import panel, pattern, plain_fabric, rectangle

from cloth_core.errors import GarmentError, SceneError
from cloth_core.fabric import Fabric
from cloth_core.garment import Garment, merged_numbers
from cloth_core.model import Model
from cloth_core.pattern import Pattern, builtin_patterns
from cloth_core.scene import Scene


def tube(**changes) -> Pattern:
    """Front and back, 0.4 by 0.3 m, sewn along their upright edges."""
    panels = {
        "front": rectangle(0.4, 0.3, at=(0, 1, 0.2)),
        "back": rectangle(0.4, 0.3, at=(0, 1, -0.2), turned=(0, 180, 0)),
    }
    return pattern(panels | changes, [(("front", 1), ("back", 3)), (("front", 3), ("back", 1))], name="tube")


def star(count: int = 5) -> Pattern:
    """Wedges around one point; each is sewn to the next along a leg, so that `count` seams meet in the middle."""
    panels, stitches = {}, []
    for k in range(count):
        a, b = (
            0.3 * np.array([math.cos(w), math.sin(w)]) for w in (2 * math.pi * k / count, 2 * math.pi * (k + 1) / count)
        )
        panels[f"wedge_{k}"] = panel([(0, 0), a.tolist(), b.tolist()])
        stitches.append(((f"wedge_{k}", 2), (f"wedge_{(k + 1) % count}", 0)))
    return pattern(panels, stitches, name="star")


def darted() -> Pattern:
    """A square with a dart from its lower edge; its tip is the vertex (0.2, 0.15) that both dart edges share."""
    corners = [(0, 0), (0.17, 0), (0.2, 0.15), (0.23, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)]
    return pattern({"piece": panel(corners)}, [(("piece", 1), ("piece", 2))], name="darted")


# ---- mass


@pytest.mark.parametrize("name", builtin_patterns())
@pytest.mark.parametrize("sewn", [False, True])
def test_masses_add_up_to_area_times_density(name, sewn):
    loaded = Pattern.load(name)
    garment = Garment.from_pattern(loaded, 0.025)
    fabric = Fabric.preset("wool")
    model = Model(Scene(garment=garment, fabric=fabric), closed=garment.seams if sewn else ())
    assert (model.mass > 0).all()
    assert model.mass.sum() == pytest.approx(garment.areas.sum() * fabric.area_density, rel=1e-12)
    # And the area is the pattern's but for what the sampling of curved edges cuts off.
    exact = sum(abs(p.area) for p in loaded.panels.values())
    assert garment.areas.sum() == pytest.approx(exact, rel=4e-3)


def test_masses_of_a_rectangle_are_its_area_times_density_exactly():
    garment = Garment.from_pattern(tube(), 0.02)
    model = Model(Scene(garment=garment, fabric=plain_fabric(area_density=0.25)))
    assert model.mass.sum() == pytest.approx(2 * 0.4 * 0.3 * 0.25, rel=1e-12)
    inner = np.setdiff1d(np.arange(garment.particle_count), np.concatenate(garment.outline))
    # A particle of the grid carries a quarter of each of its four cells, whichever way these are cut into triangles.
    np.testing.assert_allclose(model.mass[inner], 0.25 * 0.02**2, rtol=1e-9)


def test_mass_of_a_sewn_particle_is_the_sum_of_its_parts():
    garment = Garment.from_pattern(star(), 0.03)
    scene = Scene(garment=garment, fabric=plain_fabric())
    apart, sewn = Model(scene), Model(scene, closed=garment.seams)
    together = np.bincount(garment.merged_indices, weights=apart.mass)
    np.testing.assert_allclose(sewn.mass, together, rtol=1e-12)


# ---- seams


@pytest.mark.parametrize("name", [n for n in builtin_patterns() if n != "rectangle"])
def test_seam_points_match_one_to_one(name):
    loaded = Pattern.load(name)
    garment = Garment.from_pattern(loaded, 0.02)
    assert len(garment.seams) == len(loaded.stitches) > 0
    for seam, stitch in zip(garment.seams, loaded.stitches, strict=True):
        assert len(seam.first) == len(seam.second) >= 2
        for points, side in ((seam.first, stitch.first), (seam.second, stitch.second)):
            assert len(set(points.tolist())) == len(points)
            number = garment.panel_names.index(side.panel)
            assert (garment.panel_of_particle[points] == number).all()
            outline = garment.outline[number].tolist()
            assert set(points.tolist()) <= set(outline)
            edge = loaded.panels[side.panel].edges[side.edge]
            # Along the edge, at equal distances, from end to end.
            expected = edge.sample(len(points))
            found = garment.rest[points]
            forwards = np.allclose(found, expected, atol=1e-9)
            assert forwards or np.allclose(found, expected[::-1], atol=1e-9)
        assert garment.merged_indices[seam.first].tolist() == garment.merged_indices[seam.second].tolist()


def test_start_meets_end_unless_right_wrong():
    def ends(*flag):
        garment = Garment.from_pattern(
            pattern({"a": rectangle(0.2, 0.2), "b": rectangle(0.2, 0.2, at=(0, 0, 1))}, [(("a", 1), ("b", 1), *flag)]),
            0.1,
        )
        seam = garment.seams[0]
        return garment.rest[seam.first].tolist(), garment.rest[seam.second].tolist()

    first, second = ends()
    np.testing.assert_allclose(first, second[::-1], atol=1e-12)
    first, second = ends("right_wrong")
    np.testing.assert_allclose(first, second, atol=1e-12)


@pytest.mark.parametrize(("short", "long"), [(0.4, 0.5), (0.3, 0.41), (0.2, 0.4)])
def test_seam_edges_of_different_length_take_the_count_of_the_longer(short, long):
    spacing = 0.02
    garment = Garment.from_pattern(
        pattern({"a": rectangle(0.3, short), "b": rectangle(0.3, long, at=(0, 0, 1))}, [(("a", 1), ("b", 3))]), spacing
    )
    seam = garment.seams[0]
    assert len(seam.first) == len(seam.second) == math.ceil(long / spacing - 1e-9) + 1
    for points, length in ((seam.first, short), (seam.second, long)):
        steps = np.linalg.norm(np.diff(garment.rest[points], axis=0), axis=1)
        assert steps == pytest.approx(length / (len(points) - 1), rel=1e-9)


def test_five_seams_that_meet_in_one_point_are_merged_once():
    spacing = 0.03
    garment = Garment.from_pattern(star(5), spacing)
    middle = [
        int(np.flatnonzero((garment.panel_of_particle == k) & (np.abs(garment.rest).max(axis=1) < 1e-12))[0])
        for k in range(5)
    ]
    assert len(set(garment.merged_indices[middle])) == 1
    # Each leg of 10 parts is one row of particles then, and the middle one particle.
    rows = [set(garment.merged_indices[s.first].tolist()) for s in garment.seams]
    assert all(len(r) == 11 for r in rows)
    shared = set.intersection(*rows)
    assert shared == {int(garment.merged_indices[middle[0]])}
    inner = garment.particle_count - sum(len(s.first) + len(s.second) for s in garment.seams) + 5
    assert garment.merged_indices.max() + 1 == inner + 5 * 10 + 1


def test_t_junction_of_three_panels_is_one_particle():
    # Two panels side by side, sewn together, and both sewn to a third one below: they meet in one point.
    panels = {
        "left": rectangle(0.2, 0.2, at=(-0.1, 0.1, 0)),
        "right": rectangle(0.2, 0.2, at=(0.1, 0.1, 0)),
        "below": panel([(-0.2, 0), (-0.2, -0.2), (0.2, -0.2), (0.2, 0), (0, 0)]),
    }
    stitches = [(("left", 1), ("right", 3)), (("left", 0), ("below", 4)), (("right", 0), ("below", 3))]
    garment = Garment.from_pattern(pattern(panels, stitches), 0.05)
    plane = np.round(garment.start[:, [0, 2]], 9)
    for point in np.unique(plane, axis=0):
        here = (plane == point).all(axis=1)
        assert len(set(garment.merged_indices[here].tolist())) == 1, point  # all that coincide in this plane are sewn
    assert len(set(garment.merged_indices.tolist())) == len(np.unique(plane, axis=0))


def test_dart_closes_on_its_own_panel_and_keeps_its_tip():
    garment = Garment.from_pattern(darted(), 0.02)
    seam = garment.seams[0]
    same = seam.first == seam.second
    assert same.sum() == 1  # the tip is sewn to itself
    np.testing.assert_allclose(garment.rest[seam.first[same]], [[0.2, 0.15]], atol=1e-12)
    # Matched by their distance from the tip.
    tip = np.array([0.2, 0.15])
    np.testing.assert_allclose(
        np.linalg.norm(garment.rest[seam.first] - tip, axis=1),
        np.linalg.norm(garment.rest[seam.second] - tip, axis=1),
        atol=1e-9,
    )
    assert garment.merged_indices.max() + 1 == garment.particle_count - (len(seam.first) - 1)
    model = Model(Scene(garment=garment, fabric=plain_fabric()), closed=garment.seams)
    assert (model.springs.rest_length > 0).all()


def test_sleeve_of_a_single_cell_around_is_refused():
    # Sewn to a tube, its opposite corners would be one particle and its triangles lines; a finer one is fine.
    sleeve = pattern({"sleeve": rectangle(0.1, 0.1)}, [(("sleeve", 1), ("sleeve", 3))])
    with pytest.raises(
        GarmentError, match=r"panel 'sleeve': the stitches would join two corners of one triangle at 100"
    ):
        Garment.from_pattern(sleeve, 0.1)
    assert Garment.from_pattern(sleeve, 0.03).merged_indices.max() + 1 == 5 * 4


# ---- numbering


@pytest.mark.parametrize("name", ["tshirt", "dress"])
def test_numbering_is_a_fixed_rule(name):
    one, two = (Garment.from_pattern(Pattern.load(name), 0.025) for _ in range(2))
    for field in fields(Garment):
        a, b = getattr(one, field.name), getattr(two, field.name)
        if field.name == "seams":
            assert [(s.name, s.first.tolist(), s.second.tolist()) for s in a] == [
                (s.name, s.first.tolist(), s.second.tolist()) for s in b
            ]
        elif field.name == "outline":
            assert [o.tolist() for o in a] == [o.tolist() for o in b]
        else:
            np.testing.assert_array_equal(a, b)


def test_panels_are_numbered_in_the_patterns_order():
    garment = Garment.from_pattern(Pattern.load("tshirt"), 0.03)
    assert garment.panel_names == tuple(Pattern.load("tshirt").panels)
    assert (np.diff(garment.panel_of_particle) >= 0).all()
    assert (np.diff(garment.panel_of_triangle) >= 0).all()
    assert (garment.panel_of_particle[garment.triangles] == garment.panel_of_triangle[:, None]).all()


def test_merged_numbers_follow_the_lowest_member():
    from cloth_core.garment import Seam

    def seam(a, b):
        return Seam("s", np.array(a, dtype=np.int32), np.array(b, dtype=np.int32))

    assert merged_numbers(5, ()).tolist() == [0, 1, 2, 3, 4]
    assert merged_numbers(6, (seam([1, 4], [3, 5]),)).tolist() == [0, 1, 2, 1, 3, 3]
    assert merged_numbers(5, (seam([4], [2]), seam([2], [0]))).tolist() == [0, 1, 0, 2, 0]
    assert merged_numbers(3, (seam([1], [1]),)).tolist() == [0, 1, 2]


def test_triangles_face_outwards_at_the_start():
    garment = Garment.from_pattern(Pattern.load("tshirt"), 0.03)
    corner = garment.start[garment.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(normal, garment.panel_normals[garment.panel_of_triangle], atol=1e-9)


def test_start_is_the_rest_shape_placed_in_space():
    garment = Garment.from_pattern(tube(), 0.05)
    for k in range(2):
        own = garment.panel_of_particle == k
        a, b = garment.rest[own], garment.start[own]
        np.testing.assert_allclose(
            np.linalg.norm(a[:, None] - a[None], axis=2), np.linalg.norm(b[:, None] - b[None], axis=2), atol=1e-12
        )
    np.testing.assert_allclose(garment.start[garment.panel_of_particle == 0][:, 1], -0.2, atol=1e-12)  # the front: -y


# ---- several garments, and refusals


def test_joined_garments_keep_their_parts():
    shirt, skirt = Garment.from_pattern(tube(), 0.05), Garment.from_pattern(star(), 0.05)
    both = Garment.joined([shirt, skirt])
    n, m = shirt.particle_count, len(shirt.triangles)
    assert both.particle_count == n + skirt.particle_count
    assert both.panel_names == ("tube/front", "tube/back", *(f"star/wedge_{k}" for k in range(5)))
    np.testing.assert_array_equal(both.triangles[:m], shirt.triangles)
    np.testing.assert_array_equal(both.triangles[m:], skirt.triangles + n)
    np.testing.assert_array_equal(both.panel_of_particle[n:], skirt.panel_of_particle + 2)
    np.testing.assert_array_equal(both.start[n:], skirt.start)
    assert both.merged_indices.max() == shirt.merged_indices.max() + skirt.merged_indices.max() + 1
    assert not set(both.merged_indices[:n].tolist()) & set(both.merged_indices[n:].tolist())
    assert len(both.seams) == 7
    np.testing.assert_array_equal(both.merged_indices, merged_numbers(both.particle_count, both.seams))
    for kind in ("quads", "rows", "columns"):
        assert len(getattr(both, kind)) == len(getattr(shirt, kind)) + len(getattr(skirt, kind))
    assert [o.tolist() for o in both.outline[2:]] == [(o + n).tolist() for o in skirt.outline]
    assert both.areas.sum() == pytest.approx(shirt.areas.sum() + skirt.areas.sum())
    assert Garment.joined([shirt]) is shirt


@pytest.mark.parametrize("spacing", [0.0, -0.01, math.nan, math.inf])
def test_impossible_spacing_is_refused(spacing):
    with pytest.raises(GarmentError, match=r"pattern 'tube': particle spacing .* give a positive length"):
        Garment.from_pattern(tube(), spacing)


def test_too_many_particles_are_refused_before_anything_is_made():
    with pytest.raises(GarmentError, match=r"particles at 0.1 mm spacing, at most 2000000 are possible"):
        Garment.from_pattern(tube(), 1e-4)


def test_sliver_gives_a_warning_with_the_panels_name():
    # A needle of 4 degrees.
    garment = Garment.from_pattern(pattern({"needle": panel([(0, 0), (0.5, 0), (0.5, 0.035)])}), 0.03)
    assert any(w.startswith("panel 'needle': its narrowest triangle has an angle of") for w in garment.warnings)
    ordinary = Garment.from_pattern(tube(), 0.03)
    assert ordinary.warnings == ()


def test_spacing_larger_than_a_panel_still_gives_cloth():
    garment = Garment.from_pattern(tube(), 1.0)
    assert garment.particle_count == 8
    assert garment.areas.sum() == pytest.approx(0.24)


def test_panel_without_cloth_is_no_scene():
    # A particle that no triangle holds cannot come out of a pattern; if it did, it would be named.
    from dataclasses import replace

    garment = Garment.from_pattern(tube(), 0.1)
    first = garment.triangles[(garment.triangles != 0).all(axis=1)]
    bare = replace(
        garment, triangles=first, in_quad=np.zeros(len(first), dtype=bool), quads=garment.quads[:0],
        panel_of_triangle=garment.panel_of_triangle[: len(first)],
    )  # fmt: skip
    with pytest.raises(SceneError, match=r"panel 'front', particle 0: has no cloth around it and no mass"):
        Model(Scene(garment=bare, fabric=plain_fabric()))
