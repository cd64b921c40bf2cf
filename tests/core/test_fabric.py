"""Fabrics: presets with a source for every figure, their order, and refusals."""

import math
from dataclasses import fields

import pytest

from cloth_core.errors import FabricError
from cloth_core.fabric import Fabric, fabric_presets, fabric_sources

NUMBERS = [f.name for f in fields(Fabric) if f.name != "name"]


def test_at_least_eight_presets_and_those_asked_for():
    presets = set(fabric_presets())
    assert len(presets) >= 8
    assert {"silk", "cotton_poplin", "denim", "wool", "jersey", "polyester", "leather"} <= presets
    assert any("paper" in name for name in presets)


@pytest.mark.parametrize("name", fabric_presets())
def test_every_figure_of_a_preset_names_its_source(name):
    fabric, sources = Fabric.preset(name), fabric_sources(name)
    assert fabric.name == name
    defaults = {f.name: f.default for f in fields(Fabric)}
    for key in NUMBERS:
        if key in sources:
            assert len(sources[key].split()) >= 2, key
        else:  # not in the preset: then it is the common default and no figure of this fabric
            assert getattr(fabric, key) == defaults[key]
    assert {
        "area_density",
        "structural_warp",
        "structural_weft",
        "shear",
        "bending",
        "friction",
        "strain_limit",
    } <= set(sources)
    assert set(sources) <= set(NUMBERS)


def test_presets_of_real_cloth_lie_within_what_has_been_measured():
    # Over 618 fabrics (5 to 95 %) area density is 30 to 494 g/m2 and warp bending 1.1 to 116 uN m; in use cloth
    # stretches by 2 to 8 %. Knits and leather may lie beyond.
    for name in ("silk", "cotton_poplin", "wool", "polyester", "denim"):
        fabric = Fabric.preset(name)
        assert 0.030 <= fabric.area_density <= 0.494, name
        assert 1.1e-6 <= fabric.bending <= 116e-6, name
        assert 0.02 <= fabric.strain_limit <= 0.08, name
        assert 0.2 <= fabric.friction <= 0.6, name
        # By KES 0.2 gf/(cm deg) for the limpest silks to 3.4 for denim.
        assert 0.2 * 56.19 <= fabric.shear <= 3.4 * 56.19, name
        assert 1e-4 <= fabric.thickness <= 2e-3, name


def test_presets_are_ordered_as_cloth_is():
    silk, poplin, denim = (Fabric.preset(n) for n in ("silk", "cotton_poplin", "denim"))
    assert silk.area_density < poplin.area_density < denim.area_density
    assert silk.bending < poplin.bending < denim.bending
    assert silk.friction < poplin.friction < denim.friction


def test_the_papers_own_fabric_has_its_numbers():
    paper = Fabric.preset(next(n for n in fabric_presets() if "paper" in n))
    assert paper.strain_limit == 0.05  # elongation at most 5 %
    # k = 10 and m = 1 cannot hold in SI together with g = 10: the preset says how it is scaled.
    assert any("k = 10" in text or "scaled" in text for text in fabric_sources(paper.name).values())


@pytest.mark.parametrize("name", ["silk2", "", "Silk", "../silk", "description"])
def test_unknown_preset_is_refused_with_a_list_of_the_known(name):
    with pytest.raises(FabricError) as caught:
        Fabric.preset(name)
    assert f"fabric '{name}': not known" in str(caught.value)
    assert "cotton_poplin" in str(caught.value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0, 1e30, "soft", None, True])
@pytest.mark.parametrize("key", NUMBERS)
def test_value_that_is_no_plausible_number_is_refused_with_its_name(key, value):
    with pytest.raises(FabricError) as caught:
        Fabric.preset("wool", **{key: value})
    assert str(caught.value).startswith(f"fabric 'wool', {key}: ")
    assert "SI units" in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value"), [("area_density", 0.0), ("area_density", 168.0), ("bending", 13.9), ("thickness", 0.5)]
)
def test_figures_in_other_units_are_refused(key, value):
    # Nothing, g/m2 for kg/m2, uN m for N m, mm for m.
    with pytest.raises(FabricError, match=f"fabric 'wool', {key}: .* lies outside"):
        Fabric.preset("wool", **{key: value})


def test_single_parameters_can_be_changed_and_unknown_ones_are_refused():
    changed = Fabric.preset("wool", friction=0.1)
    assert changed.friction == 0.1
    assert changed.bending == Fabric.preset("wool").bending
    with pytest.raises(FabricError, match="no parameter 'stickiness'; use one of area_density"):
        Fabric.preset("wool", stickiness=1.0)
