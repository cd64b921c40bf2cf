"""Malformed sewing patterns: what is wrong with each, its text, and what the message must say about it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

__all__ = ["MALFORMED", "tube"]


def tube(**properties: Any) -> dict[str, Any]:
    """A tube of two square panels of 40 cm, sewn along their upright edges, as parsed JSON [cm]."""

    def panel(z: float, rotation: list[float]) -> dict[str, Any]:
        return {
            "translation": [0, 100, z],
            "rotation": rotation,
            "vertices": [[-20, 0], [20, 0], [20, 40], [-20, 40]],
            "edges": [{"endpoints": [i, (i + 1) % 4]} for i in range(4)],
        }

    return {
        "pattern": {
            "panels": {"front": panel(20, [0, 0, 0]), "back": panel(-20, [0, 180, 0])},
            "stitches": [
                [{"panel": "front", "edge": 1}, {"panel": "back", "edge": 3}],
                [{"panel": "front", "edge": 3}, {"panel": "back", "edge": 1}],
            ],
        },
        "properties": {"curvature_coords": "relative", "units_in_meter": 100} | properties,
    }


MALFORMED: dict[str, tuple[str | bytes, str]] = {
    "empty text": ("", "not JSON: Expecting value at line 1, column 1"),
    "no JSON": ("panel front", "not JSON"),
    "cut off": (json.dumps(tube())[:300], "not JSON"),
    "trailing comma": ('{"pattern": {},}', "not JSON"),
    "an empty list at the root": ("[]", "the pattern file is a list of 0; give 1 to 16 patterns"),
    "a list of lists": ("[[]]", "pattern 1 of the list: expected an object {...}, found a list"),
    "a list with an empty pattern": (
        "[{}]",
        "pattern 1 of the list: the pattern file: the key 'properties' is missing",
    ),
    "a list with a number for a name": ('[{"name": 7}]', "pattern 1 of the list, name: expected a text"),
    "a list of too many": ("[" + ", ".join(["{}"] * 17) + "]", "a list of 17; give 1 to 16 patterns"),
    "null at the root": ("null", "the pattern file: expected an object {...}, found null"),
    "not UTF-8": (b'{"pattern": "\xff\xfe"}', "not UTF-8 text"),
    "UTF-16": (json.dumps(tube()).encode("utf-16"), "not UTF-8 text"),
    "lone surrogate": ('{"\ud800": 1}', "not UTF-8 text"),
    "nested too deep": ("[" * 200_000, "nested too deep"),
    "an integer of 5,000 digits": ('{"pattern": ' + "9" * 5000 + "}", "too many digits"),
    "text too long": (" " * (4 * 1024 * 1024 + 1), "at most 4194304 are read"),
}


def _malformed(message: str) -> Callable[[Callable[[dict[str, Any]], None]], Callable[[dict[str, Any]], None]]:
    """Enter the tube, spoilt by the decorated function, into the table."""

    def enter(spoil: Callable[[dict[str, Any]], None]) -> Callable[[dict[str, Any]], None]:
        data = tube()
        spoil(data)
        MALFORMED[spoil.__name__.strip("_").replace("_", " ")] = (json.dumps(data), message)
        return spoil

    return enter


def _front(data: dict[str, Any]) -> dict[str, Any]:
    panel: dict[str, Any] = data["pattern"]["panels"]["front"]
    return panel


def _curve(data: dict[str, Any], curvature: Any) -> None:
    _front(data)["edges"][2]["curvature"] = curvature


# ---- root and properties


@_malformed("the pattern file: the key 'properties' is missing")
def _no_properties(data: dict[str, Any]) -> None:
    del data["properties"]


@_malformed("the pattern file: the key 'pattern' is missing")
def _no_pattern(data: dict[str, Any]) -> None:
    del data["pattern"]


@_malformed("properties: the key 'units_in_meter' is missing")
def _no_units(data: dict[str, Any]) -> None:
    del data["properties"]["units_in_meter"]


@_malformed("properties, units_in_meter: 0 is not plausible")
def _zero_units(data: dict[str, Any]) -> None:
    data["properties"]["units_in_meter"] = 0


@_malformed("properties, units_in_meter: -100 is not plausible")
def _negative_units(data: dict[str, Any]) -> None:
    data["properties"]["units_in_meter"] = -100


@_malformed("properties, units_in_meter: expected a number, found true or false")
def _boolean_units(data: dict[str, Any]) -> None:
    data["properties"]["units_in_meter"] = True


@_malformed("properties, units_in_meter: expected a number, found a text")
def _units_in_words(data: dict[str, Any]) -> None:
    data["properties"]["units_in_meter"] = "cm"


@_malformed("the numbers look like centimetres: set it to 100")
def _centimetres_called_metres(data: dict[str, Any]) -> None:
    data["properties"]["units_in_meter"] = 1


@_malformed("panel 'front': is 4e-05 m large with units_in_meter = 100; check the vertices and the unit")
def _microscopic(data: dict[str, Any]) -> None:
    _front(data)["vertices"] = [[x / 10_000, y / 10_000] for x, y in _front(data)["vertices"]]


@_malformed("properties, curvature_coords: 'polar' is unknown")
def _unknown_curvature_coordinates(data: dict[str, Any]) -> None:
    data["properties"]["curvature_coords"] = "polar"


@_malformed("properties, normalized_edge_loops: expected true or false, found a text")
def _flag_in_words(data: dict[str, Any]) -> None:
    data["properties"]["normalized_edge_loops"] = "no"


@_malformed("pattern, panels: there is no panel")
def _no_panel(data: dict[str, Any]) -> None:
    data["pattern"]["panels"] = {}


@_malformed("pattern, panels: expected an object {...}, found a list")
def _panels_in_a_list(data: dict[str, Any]) -> None:
    data["pattern"]["panels"] = list(data["pattern"]["panels"].values())


@_malformed("pattern, panels: 501 panels are more than the limit of 500")
def _too_many_panels(data: dict[str, Any]) -> None:
    data["pattern"]["panels"] = {str(i): {} for i in range(501)}


@_malformed(r"panel 'a\nb': the name must be")
def _panel_name_of_two_lines(data: dict[str, Any]) -> None:
    data["pattern"]["panels"]["a\nb"] = data["pattern"]["panels"].pop("back")


@_malformed("pattern, panel_order: entry 1, 'sleeve', is not a panel")
def _unknown_panel_in_the_order(data: dict[str, Any]) -> None:
    data["pattern"]["panel_order"] = ["front", "sleeve"]


@_malformed("pattern, panel_order: panel 'front' is listed twice")
def _panel_twice_in_the_order(data: dict[str, Any]) -> None:
    data["pattern"]["panel_order"] = ["front", "front"]


MALFORMED["key twice"] = (
    json.dumps(tube()).replace('"back": {', '"front": {', 1),
    "the key 'front' occurs twice in one JSON object",
)


# ---- panels


@_malformed("panel 'front': expected an object {...}, found null")
def _null_panel(data: dict[str, Any]) -> None:
    data["pattern"]["panels"]["front"] = None


@_malformed("panel 'front': the key 'vertices' is missing")
def _no_vertices(data: dict[str, Any]) -> None:
    del _front(data)["vertices"]


@_malformed("panel 'front': the key 'translation' is missing")
def _no_translation(data: dict[str, Any]) -> None:
    del _front(data)["translation"]


@_malformed("panel 'front': the key 'rotation' is missing")
def _no_rotation(data: dict[str, Any]) -> None:
    del _front(data)["rotation"]


@_malformed("panel 'front': 2 vertices; an outline has 3 to")
def _two_vertices(data: dict[str, Any]) -> None:
    del _front(data)["vertices"][2:]


@_malformed("panel 'front': 5001 vertices")
def _too_many_vertices(data: dict[str, Any]) -> None:
    _front(data)["vertices"] = [[0, 0]] * 5001


@_malformed("panel 'front', vertex 2: expected 2 values, found 3")
def _vertex_in_space(data: dict[str, Any]) -> None:
    _front(data)["vertices"][2] = [20, 40, 0]


@_malformed("panel 'front', vertex 1: nan is not a finite number")
def _vertex_that_is_no_number(data: dict[str, Any]) -> None:
    _front(data)["vertices"][1] = [float("nan"), 0]


@_malformed("panel 'front', translation: inf is not a finite number")
def _infinite_translation(data: dict[str, Any]) -> None:
    _front(data)["translation"][2] = float("inf")


@_malformed("panel 'front', vertex 1: 1e+300 is too large")
def _huge_vertex(data: dict[str, Any]) -> None:
    _front(data)["vertices"][1] = [1e300, 0]


@_malformed("panel 'front', vertex 1: a number of more than 30 digits is too large")
def _huge_integer(data: dict[str, Any]) -> None:
    _front(data)["vertices"][1] = [10**400, 0]


@_malformed("panel 'front', vertex 0: expected a number, found true or false")
def _boolean_vertex(data: dict[str, Any]) -> None:
    _front(data)["vertices"][0] = [True, False]


@_malformed("panel 'front', rotation: expected 3 values, found 1")
def _rotation_of_one_angle(data: dict[str, Any]) -> None:
    _front(data)["rotation"] = [90]


@_malformed("panel 'front': its translation puts it more than 100 m from the origin")
def _far_away(data: dict[str, Any]) -> None:
    _front(data)["translation"] = [0, 20_000, 0]


@_malformed("panel 'front', edges: expected a list [...], found null")
def _null_edges(data: dict[str, Any]) -> None:
    _front(data)["edges"] = None


@_malformed("panel 'front': 0 edges do not make a closed loop")
def _no_edges(data: dict[str, Any]) -> None:
    _front(data)["edges"] = []


@_malformed("panel 'front', edge 2: ends at vertex 3 but edge 0 starts at vertex 0")
def _open_loop(data: dict[str, Any]) -> None:
    del _front(data)["edges"][3]


@_malformed("panel 'front', edge 0: ends at vertex 1 but edge 1 starts at vertex 2")
def _edges_out_of_order(data: dict[str, Any]) -> None:
    edges = _front(data)["edges"]
    edges[1], edges[2] = edges[2], edges[1]


@_malformed("panel 'front', edge 4: the outline passes vertex 0 again after edge 0")
def _outline_passed_twice(data: dict[str, Any]) -> None:
    _front(data)["edges"] *= 2


@_malformed("panel 'front', edge 3, endpoints: there is no vertex 4; the panel has vertices 0 to 3")
def _endpoint_out_of_range(data: dict[str, Any]) -> None:
    _front(data)["edges"][3]["endpoints"] = [3, 4]


@_malformed("panel 'front', edge 3, endpoints: there is no vertex -4")
def _negative_endpoint(data: dict[str, Any]) -> None:
    _front(data)["edges"][3]["endpoints"] = [3, -4]


@_malformed("panel 'front', edge 3, endpoints: expected vertex numbers, found true or false")
def _boolean_endpoint(data: dict[str, Any]) -> None:
    _front(data)["edges"][3]["endpoints"] = [3, False]


@_malformed("panel 'front', edge 0, endpoints: expected 2 values, found 3")
def _three_endpoints(data: dict[str, Any]) -> None:
    _front(data)["edges"][0]["endpoints"] = [0, 1, 2]


@_malformed("panel 'front', edge 1: its length is zero, vertices 1 and 2 lie at one point")
def _zero_length_edge(data: dict[str, Any]) -> None:
    _front(data)["vertices"][2] = _front(data)["vertices"][1]


@_malformed("panel 'front', edge 0: its length is zero, vertices 0 and 1 lie at one point")
def _all_vertices_at_one_point(data: dict[str, Any]) -> None:
    _front(data)["vertices"] = [[3, 3]] * 4


@_malformed("panel 'front': its outline encloses no area")
def _sliver(data: dict[str, Any]) -> None:
    _front(data)["vertices"] = [[0, 0], [20, 0], [40, 1e-7], [20, 1e-7]]


@_malformed("panel 'front', edges 0 and 2: cross or touch each other")
def _bow_tie(data: dict[str, Any]) -> None:
    _front(data)["vertices"] = [[-20, 0], [20, 40], [20, 0], [-20, 40]]


@_malformed("panel 'front', edges 0 and 2: cross or touch each other")
def _curve_across_the_panel(data: dict[str, Any]) -> None:
    _curve(data, {"type": "quadratic", "params": [[0.5, 2.5]]})


@_malformed("panel 'front', edge 2: crosses itself")
def _edge_with_a_loop(data: dict[str, Any]) -> None:
    _curve(data, {"type": "cubic", "params": [[1.6, -0.8], [-0.6, -0.8]]})


@_malformed("panel 'front', edges 0 and 1: cross or touch each other")
def _edge_that_runs_back_on_its_neighbour(data: dict[str, Any]) -> None:
    _front(data)["vertices"] = [[-20, 0], [20, 0], [0, 0], [-20, 40]]


# ---- curvature


@_malformed("panel 'front', edge 2, curvature: type 'spline' is unknown; use 'quadratic', 'cubic' or 'circle'")
def _unknown_curvature(data: dict[str, Any]) -> None:
    _curve(data, {"type": "spline", "params": [[0.5, 0.1]]})


@_malformed("panel 'front', edge 2, curvature: type a list is unknown")
def _curvature_type_in_a_list(data: dict[str, Any]) -> None:
    _curve(data, {"type": ["quadratic"], "params": [[0.5, 0.1]]})


@_malformed("panel 'front', edge 2, curvature: the key 'params' is missing")
def _curvature_without_parameters(data: dict[str, Any]) -> None:
    _curve(data, {"type": "quadratic"})


@_malformed("panel 'front', edge 2, curvature, params of quadratic: expected 1 value, found 2")
def _quadratic_with_two_control_points(data: dict[str, Any]) -> None:
    _curve(data, {"type": "quadratic", "params": [[0.3, 0.1], [0.6, 0.1]]})


@_malformed("panel 'front', edge 2, curvature, params of cubic: expected 2 values, found 1")
def _cubic_with_one_control_point(data: dict[str, Any]) -> None:
    _curve(data, {"type": "cubic", "params": [[0.3, 0.1]]})


@_malformed("panel 'front', edge 2, curvature, control point: expected a list [...], found a number")
def _flat_parameters(data: dict[str, Any]) -> None:
    _curve(data, {"type": "cubic", "params": [0.3, 0.1]})


@_malformed("panel 'front', edge 2, curvature, control point: expected 2 values, found 3")
def _old_curvature_of_three_numbers(data: dict[str, Any]) -> None:
    _curve(data, [0.5, 0.1, 0.0])


@_malformed("panel 'front', edge 2, curvature: expected an object {...}, found a number")
def _curvature_of_one_number(data: dict[str, Any]) -> None:
    _curve(data, 0.1)


@_malformed("panel 'front', edge 2, curvature, control point: nan is not a finite number")
def _control_point_that_is_no_number(data: dict[str, Any]) -> None:
    _curve(data, [float("nan"), 0.1])


@_malformed("panel 'front', edge 2: its curve makes the panel 2e+03 m large")
def _control_point_far_away(data: dict[str, Any]) -> None:
    _curve(data, [0.5, -10_000])


@_malformed("panel 'front', edge 2, curvature, params of circle: expected 3 values, found 1")
def _circle_without_flags(data: dict[str, Any]) -> None:
    _curve(data, {"type": "circle", "params": [30]})


@_malformed("panel 'front', edge 2, curvature: radius 19 is smaller than half the distance of the ends, 20")
def _circle_too_small(data: dict[str, Any]) -> None:
    _curve(data, {"type": "circle", "params": [19, 0, 1]})


@_malformed("panel 'front', edge 2, curvature: radius -30 is smaller")
def _negative_radius(data: dict[str, Any]) -> None:
    _curve(data, {"type": "circle", "params": [-30, 0, 1]})


@_malformed("panel 'front', edge 2, curvature, large_arc: expected 0 or 1, found 2")
def _circle_flag_out_of_range(data: dict[str, Any]) -> None:
    _curve(data, {"type": "circle", "params": [30, 2, 1]})


@_malformed("panel 'front', edge 2, curvature, right: expected 0 or 1, found 'right'")
def _circle_flag_in_words(data: dict[str, Any]) -> None:
    _curve(data, {"type": "circle", "params": [30, 0, "right"]})


@_malformed("panel 'front', edge 2, label: expected a text")
def _label_that_is_a_number(data: dict[str, Any]) -> None:
    _front(data)["edges"][2]["label"] = 7


# ---- stitches


def _stitches(data: dict[str, Any]) -> list[Any]:
    stitches: list[Any] = data["pattern"]["stitches"]
    return stitches


@_malformed("pattern, stitches: expected a list [...], found an object")
def _stitches_in_an_object(data: dict[str, Any]) -> None:
    data["pattern"]["stitches"] = {"side": _stitches(data)[0]}


@_malformed("stitch 1: has 1 elements; give two sides")
def _stitch_of_one_side(data: dict[str, Any]) -> None:
    del _stitches(data)[1][1]


@_malformed("stitch 1: has 4 elements; give two sides")
def _stitch_of_four_elements(data: dict[str, Any]) -> None:
    _stitches(data)[1] += ["right_wrong", "right_wrong"]


@_malformed("stitch 0: the third element 'wrong_right' is unknown; use 'right_wrong'")
def _unknown_stitch_flag(data: dict[str, Any]) -> None:
    _stitches(data)[0].append("wrong_right")


@_malformed("stitch 0, side 1: the key 'edge' is missing")
def _side_without_edge(data: dict[str, Any]) -> None:
    del _stitches(data)[0][1]["edge"]


@_malformed("stitch 0, side 1: there is no panel 'sleeve'; the panels are 'front', 'back'")
def _stitch_to_an_unknown_panel(data: dict[str, Any]) -> None:
    _stitches(data)[0][1]["panel"] = "sleeve"


@_malformed("stitch 0, side 1: there is no panel a list")
def _stitch_to_a_list(data: dict[str, Any]) -> None:
    _stitches(data)[0][1]["panel"] = ["front"]


@_malformed("stitch 0, side 1: panel 'back' has no edge 4; its edges are 0 to 3")
def _stitch_to_an_edge_out_of_range(data: dict[str, Any]) -> None:
    _stitches(data)[0][1]["edge"] = 4


@_malformed("stitch 0, side 1: panel 'back' has no edge -1")
def _stitch_to_a_negative_edge(data: dict[str, Any]) -> None:
    _stitches(data)[0][1]["edge"] = -1


@_malformed("stitch 0, side 1, edge: expected an edge number, found a number")
def _stitch_to_a_fraction_of_an_edge(data: dict[str, Any]) -> None:
    _stitches(data)[0][1]["edge"] = 1.5


@_malformed("panel 'back', edge 3: stitched twice, by stitch 0 and stitch 2; remove one stitch")
def _edge_stitched_twice(data: dict[str, Any]) -> None:
    _stitches(data).append([{"panel": "front", "edge": 0}, {"panel": "back", "edge": 3}])


@_malformed("stitch 2: sews panel 'front', edge 0 to itself")
def _edge_stitched_to_itself(data: dict[str, Any]) -> None:
    _stitches(data).append([{"panel": "front", "edge": 0}, {"panel": "front", "edge": 0}])


@_malformed("panel 'front', edge 0: sewing would join its two ends into one point; check edges and 'right_wrong' of")
def _dart_the_wrong_way_round(data: dict[str, Any]) -> None:
    _stitches(data).clear()
    _stitches(data).append([{"panel": "front", "edge": 0}, {"panel": "front", "edge": 1}, "right_wrong"])


@_malformed("sewing would join its two ends into one point")
def _corner_sewn_around(data: dict[str, Any]) -> None:
    _stitches(data).append([{"panel": "front", "edge": 2}, {"panel": "back", "edge": 2}, "right_wrong"])
