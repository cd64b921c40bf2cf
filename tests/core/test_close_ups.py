"""Regions for close-ups on the built-in bodies, and the table of contact that is made with them."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from cloth_core.body import Body, builtin_bodies
from cloth_core.camera import VIEWS
from cloth_core.close_ups import close_ups

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "contact_table.py"


@pytest.fixture(scope="module")
def contact_table():
    spec = importlib.util.spec_from_file_location("contact_table", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["contact_table"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["contact_table"]


def regions_of(body: Body, lowest: float, highest: float) -> dict:
    """For a garment that lies on the body like a skin between two heights [m]."""
    inside = (body.vertices[body.triangles, 2] > lowest) & (body.vertices[body.triangles, 2] < highest)
    used, triangles = np.unique(body.triangles[inside.all(axis=1)], return_inverse=True)
    found = close_ups((body.vertices, body.triangles), (body.vertices[used], triangles.reshape(-1, 3)))
    assert all(set(region.views) <= set(VIEWS) and 0.05 < region.radius < 0.6 for region in found)
    return {region.name: region for region in found}


@pytest.mark.parametrize("name", builtin_bodies())
def test_regions_are_where_they_are_on_a_woman(name):
    body = Body.load(name)
    height = np.ptp(body.vertices[:, 2])
    regions = regions_of(body, 0.44, 0.86 * height)
    assert list(regions) == ["armpit", "waist", "neck", "hem"]
    shares = {key: region.centre[2] / height for key, region in regions.items()}
    assert 0.70 < shares["armpit"] < 0.80
    assert 0.58 < shares["waist"] < 0.70
    assert 0.78 < shares["neck"] < 0.87
    assert regions["hem"].centre[2] == pytest.approx(0.44, abs=0.06)  # the dress ends there
    assert 0.1 < regions["armpit"].centre[0] < 0.25  # the left one
    assert abs(regions["waist"].centre[0]) < 0.02
    # By trimesh's sections: arms are apart from the trunk just below the armpit and not above it.
    mesh = trimesh.Trimesh(body.vertices, body.triangles, process=False)
    for offset, parts in ((-0.01, 3), (0.02, 1)):
        plane = ([0, 0, regions["armpit"].centre[2] + offset], [0, 0, 1])
        lines = trimesh.intersections.mesh_plane(mesh, plane_normal=plane[1], plane_origin=plane[0])
        loops = shapely.polygonize(shapely.linestrings(lines[:, :, :2].round(9)))
        assert len([loop for loop in loops.geoms if loop.area > 1e-3]) == parts


def test_only_what_the_garment_covers_is_looked_at():
    assert list(regions_of(Body.load("young"), 0.5, 1.05)) == ["waist", "hem"]


def test_body_without_arms_has_a_hem():
    column = trimesh.creation.cylinder(0.15, 1.6).apply_translation([0, 0, 0.8]).subdivide_to_size(0.1)
    assert list(regions_of(Body.from_arrays(column.vertices, column.faces), 0.5, 1.0)) == ["hem"]


def test_table_goes_on_from_what_is_done_and_names_what_failed(contact_table, tmp_path, capsys):
    arguments = ["--only", "^(skirt|dress)-young-silk", "--results", str(tmp_path), "--output", str(tmp_path / "t.md")]
    gate = {"passed": True, "failed": [], "criteria": {"moving_share": {"value": 0.001}}}
    report = {"particles": 7, "wall_time": 1.5, "simulated_time": 2.0, "body_intersections": 2,
              "body_edges_through_cloth": 3, "self_intersections": 0, "max_penetration": 0.0,
              "contact_searches": 9}  # fmt: skip
    for garment in ("skirt", "dress"):
        case = contact_table.Case((garment,), "young", "silk", "normal")
        row = {"garment": garment, "body": "young", "fabric": "silk", "quality": "normal", "report": report,
               "gate": gate, "contacts": 3, "contact_share": 0.25}  # fmt: skip
        (tmp_path / f"{case.stem}.json").write_text(json.dumps(row))
    assert contact_table.main(arguments) == 0
    text = (tmp_path / "t.md").read_text()
    assert "2 drapes at quality normal; 2 pass the gate" in text
    assert "| skirt | young | silk | 7 | 1.5 s | 2.00 s | 5 | 0 | 0 mm | 3 | 9 | 25 % | 0.1 % | passed |" in text
    assert "2 cases, 2 of them done before" in capsys.readouterr().out
    failed = {**row, "gate": {**gate, "passed": False, "failed": ["4 cloth edges cross the body"]}}
    (tmp_path / "dress-young-silk-normal.json").write_text(json.dumps(failed))
    assert contact_table.main(arguments) == 1
    assert "- dress on young, silk: 4 cloth edges cross the body" in (tmp_path / "t.md").read_text()
    # All garments, the outfit of two included, on three bodies in three fabrics.
    assert len({case.stem for case in contact_table.cases_of(contact_table.parse([]))}) == 45


def test_case_that_cannot_be_run_is_a_row(contact_table):
    row = contact_table.run_case(contact_table.Case(("no_such",), "young", "silk", "draft"), None, 10.0)
    assert "no_such" in row["error"]
    assert "not run" in contact_table.table([row])
