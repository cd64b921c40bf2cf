"""GarmentCode pattern JSON -> Pattern: each key is checked for presence, type, count and size before it is used.

The format is that of Korosteleva and Sorkine-Hornung, "GarmentCode: Programming Parametric Sewing Patterns" (2023). In
the file y is up, +z is the front of the body and `units_in_meter` file units are a metre; a `Pattern` has z up, the
front at -y, and metres.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from math import cos, hypot, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cloth_core.curves import CircularArc, CubicBezier, Curve, Line, Point, QuadraticBezier
from cloth_core.edge_loops import normalize_loops
from cloth_core.errors import PatternError
from cloth_core.json_values import (
    MAX_NAME_LENGTH,
    json_label,
    json_list,
    json_number,
    json_numbers,
    json_object,
    kind_of,
    listed,
    required,
    shown,
)
from cloth_core.pattern import MAX_TEXT_BYTES, Edge, Panel, Pattern, Stitch, StitchSide
from cloth_core.pattern_checks import check_merging, check_outline, check_size, seam_warnings
from cloth_core.pattern_layers import layered

__all__ = ["MAX_EDGES", "MAX_LAYERS", "MAX_PANELS", "MAX_VERTICES", "read_pattern"]

MAX_LAYERS = 16
MAX_PANELS = 500
MAX_VERTICES = 5_000  # per panel
MAX_EDGES = 20_000  # of all panels together
UNITS_RANGE = (0.1, 1e5)  # per metre
RADIUS_TOLERANCE = 1e-6  # by which an arc's radius may fall short of half the chord, from rounding in the file

FloatArray = NDArray[np.float64]

_FILE_TO_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (x, -z, y)


def read_pattern(text: str | bytes, name: str = "pattern") -> Pattern:
    """Parse and check a pattern. PatternError, and nothing else, for whatever is wrong with the text.

    A list of patterns is read as one that holds them as `layers`, the innermost garment first.
    """
    source = _decode(text)
    root = _parse(source)
    if isinstance(root, list):
        return _read_layers(root, name, source)
    return _read_root(json_object(root, "the pattern file"), name, source)


def _read_root(root: Mapping[str, Any], name: str, source: str) -> Pattern:
    properties = json_object(required(root, "properties", "the pattern file"), "properties")
    body = json_object(required(root, "pattern", "the pattern file"), "pattern")
    units = _units(properties)
    absolute = _curvature_is_absolute(properties)
    centred = _flag(properties, "normalize_panel_translation", default=False)
    normalized = _flag(properties, "normalized_edge_loops", default=True)

    warnings: list[str] = []
    panels: dict[str, Panel] = {}
    edge_count = 0
    for panel_name, spec in _ordered_panels(body, warnings).items():
        panel = _read_panel(panel_name, spec, units, absolute, warnings)
        edge_count += len(panel.edges)
        if edge_count > MAX_EDGES:
            raise PatternError(
                f"panel {panel_name!r}: the pattern has more than {MAX_EDGES} edges; simplify the outlines"
            )
        check_outline(panel)
        panels[panel_name] = _centred(panel) if centred else panel

    stitches = _read_stitches(body, panels)
    if not normalized:
        panels, stitches = normalize_loops(panels, stitches)
    check_merging(panels, stitches)
    warnings += seam_warnings(panels, stitches)
    return Pattern(name, panels, stitches, tuple(warnings), source)


def _read_layers(entries: list[Any], name: str, source: str) -> Pattern:
    if not 1 <= len(entries) <= MAX_LAYERS:
        raise PatternError(f"the pattern file is a list of {len(entries)}; give 1 to {MAX_LAYERS} patterns")
    layers: list[Pattern] = []
    for number, entry in enumerate(entries, start=1):
        where = f"pattern {number} of the list"
        try:
            root = json_object(entry, where)
            layers.append(_read_root(root, _layer_name(root, where) or f"{name} {number}", json.dumps(entry)))
        except PatternError as error:
            raise PatternError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None
    return layered(name, layers, source)


def _layer_name(root: Mapping[str, Any], where: str) -> str | None:
    """What a pattern in a list calls itself, under a key that the format leaves free."""
    name = root.get("name")
    if name is not None and (not isinstance(name, str) or len(name) > MAX_NAME_LENGTH or not name.isprintable()):
        raise PatternError(
            f"{where}, name: expected a text of at most {MAX_NAME_LENGTH} printable characters, found {shown(name)}"
        )
    return name or None


# ---- text and root


def _decode(text: str | bytes) -> str:
    if isinstance(text, (bytes, bytearray, memoryview)):
        size = len(text)
    elif isinstance(text, str):
        size = len(text.encode("utf-8", "surrogatepass"))
    else:
        raise PatternError(f"the pattern is {kind_of(text)}; give the text of a JSON file")
    if size > MAX_TEXT_BYTES:
        raise PatternError(f"the pattern text has {size} bytes; at most {MAX_TEXT_BYTES} are read")
    try:
        decoded = text.encode("utf-8").decode("utf-8-sig") if isinstance(text, str) else bytes(text).decode("utf-8-sig")
    except UnicodeError:
        raise PatternError("the pattern is not UTF-8 text; save the JSON file as UTF-8") from None
    return decoded


def _parse(source: str) -> object:
    try:
        root: object = json.loads(source, object_pairs_hook=_without_duplicates)
    except RecursionError:
        raise PatternError("the JSON text is nested too deep to be a pattern") from None
    except json.JSONDecodeError as error:
        raise PatternError(f"not JSON: {error.msg} at line {error.lineno}, column {error.colno}") from None
    except ValueError:  # an integer with thousands of digits
        raise PatternError("the JSON text has a number with too many digits; write it shorter") from None
    return root


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise PatternError(f"the key {shown(twice)} occurs twice in one JSON object; rename or remove one")
    return result


def _units(properties: Mapping[str, Any]) -> float:
    units = json_number(required(properties, "units_in_meter", "properties"), "properties, units_in_meter")
    if not UNITS_RANGE[0] <= units <= UNITS_RANGE[1]:
        raise PatternError(
            f"properties, units_in_meter: {units:g} is not plausible; "
            "use 100 for centimetres, 1000 for millimetres, 1 for metres"
        )
    return units


def _curvature_is_absolute(properties: Mapping[str, Any]) -> bool:
    value = properties.get("curvature_coords", "relative")
    if value not in ("relative", "absolute"):
        raise PatternError(f"properties, curvature_coords: {shown(value)} is unknown; use 'relative' or 'absolute'")
    return bool(value == "absolute")


def _flag(properties: Mapping[str, Any], key: str, default: bool) -> bool:
    value = properties.get(key, default)
    if not isinstance(value, bool):
        raise PatternError(f"properties, {key}: expected true or false, found {kind_of(value)}")
    return value


def _ordered_panels(body: Mapping[str, Any], warnings: list[str]) -> dict[str, Any]:
    specs = json_object(required(body, "panels", "pattern"), "pattern, panels")
    if not specs:
        raise PatternError("pattern, panels: there is no panel; add at least one")
    if len(specs) > MAX_PANELS:
        raise PatternError(f"pattern, panels: {len(specs)} panels are more than the limit of {MAX_PANELS}")
    for name in specs:
        if not name or len(name) > MAX_NAME_LENGTH or not name.isprintable():
            raise PatternError(
                f"panel {shown(name)}: the name must be 1 to {MAX_NAME_LENGTH} printable characters; rename it"
            )
    if body.get("panel_order") is None:
        return dict(specs)
    order: dict[str, Any] = {}
    for position, name in enumerate(json_list(body["panel_order"], "pattern, panel_order")):
        if not isinstance(name, str) or name not in specs:
            raise PatternError(
                f"pattern, panel_order: entry {position}, {shown(name)}, is not a panel; use the names under 'panels'"
            )
        if name in order:
            raise PatternError(f"pattern, panel_order: panel {name!r} is listed twice; remove one")
        order[name] = specs[name]
    missing = [name for name in specs if name not in order]
    if missing:
        warnings.append(f"panel_order lacks {listed(missing)}; taken after the others")
    return order | {name: specs[name] for name in missing}


# ---- panels


def _read_panel(name: str, spec: Any, units: float, absolute: bool, warnings: list[str]) -> Panel:
    where = f"panel {name!r}"
    spec = json_object(spec, where)
    raw = json_list(required(spec, "vertices", where), f"{where}, vertices")
    if not 3 <= len(raw) <= MAX_VERTICES:
        raise PatternError(f"{where}: {len(raw)} vertices; an outline has 3 to {MAX_VERTICES}")
    vertices = np.array([json_numbers(vertex, 2, f"{where}, vertex {i}") for i, vertex in enumerate(raw)]) / units
    check_size(name, vertices, units)
    raw_edges = json_list(required(spec, "edges", where), f"{where}, edges")
    edges = [_read_edge(edge, i, vertices, units, absolute, where) for i, edge in enumerate(raw_edges)]
    _check_loop(edges, where)
    rotation = _read_rotation(spec, where, warnings)
    translation = json_numbers(required(spec, "translation", where), 3, f"{where}, translation")
    if max(map(abs, translation)) / units > 100.0:
        raise PatternError(
            f"{where}: its translation puts it more than 100 m from the origin; check it and units_in_meter"
        )
    label = json_label(spec, where)
    unused = sorted(set(range(len(vertices))) - {edge.start for edge in edges})
    if unused:
        warnings.append(f"{where}: no edge uses vertex {listed(unused)}; left out")
        number = {old: new for new, old in enumerate(sorted({edge.start for edge in edges}))}
        edges = [replace(edge, start=number[edge.start], end=number[edge.end]) for edge in edges]
        vertices = vertices[list(number)]
    return Panel(
        name, vertices, tuple(edges), _FILE_TO_WORLD @ rotation, _FILE_TO_WORLD @ np.array(translation) / units, label
    )


def _read_rotation(spec: Mapping[str, Any], where: str, warnings: list[str]) -> FloatArray:
    """Rx Ry Rz. Readers of the format differ in the order, so a rotation that depends on it is warned about."""
    angles = json_numbers(required(spec, "rotation", where), 3, f"{where}, rotation")
    x, y, z = (_axis_rotation(axis, angle) for axis, angle in enumerate(angles))
    rotation = x @ y @ z
    if np.abs(rotation - z @ y @ x).max() > 1e-9:
        warnings.append(
            f"{where}: rotation {list(angles)} is about more than one axis, which programs read in different orders; "
            "taken as Rx Ry Rz"
        )
    return rotation


def _axis_rotation(axis: int, degrees: float) -> FloatArray:
    """Right-handed rotation about x (0), y (1) or z (2), shape (3, 3)."""
    # quarter turns are exact, so that panels turned by them stay exactly in their planes
    quarter = degrees % 360.0 / 90.0
    c, s = (
        [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][int(quarter) % 4]
        if quarter.is_integer()
        else (cos(radians(degrees)), sin(radians(degrees)))
    )
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def _check_loop(edges: list[Edge], where: str) -> None:
    if len(edges) < 3:
        raise PatternError(f"{where}: {len(edges)} edges do not make a closed loop; an outline has at least 3")
    visited: dict[int, int] = {}
    for i, edge in enumerate(edges):
        following = (i + 1) % len(edges)
        if edge.end != edges[following].start:
            raise PatternError(
                f"{where}, edge {i}: ends at vertex {edge.end} but edge {following} starts at vertex "
                f"{edges[following].start}; list the edges head to tail as one closed loop"
            )
        if edge.start in visited:
            raise PatternError(
                f"{where}, edge {i}: the outline passes vertex {edge.start} again after edge {visited[edge.start]}; "
                "it must be one simple loop"
            )
        visited[edge.start] = i


def _centred(panel: Panel) -> Panel:
    """The panel with its origin at the mean of its vertices; the offset goes to the translation, unrotated."""
    x, y = (float(value) for value in panel.vertices.mean(axis=0))
    edges = tuple(replace(edge, curve=edge.curve.translated(-x, -y)) for edge in panel.edges)
    return replace(
        panel,
        vertices=panel.vertices - (x, y),
        edges=edges,
        translation=panel.translation + _FILE_TO_WORLD @ (x, y, 0.0),
    )


# ---- edges


def _read_edge(spec: Any, index: int, vertices: FloatArray, units: float, absolute: bool, panel: str) -> Edge:
    where = f"{panel}, edge {index}"
    spec = json_object(spec, where)
    ends = json_list(required(spec, "endpoints", where), f"{where}, endpoints", 2)
    for end in ends:
        if isinstance(end, bool) or not isinstance(end, int):
            raise PatternError(f"{where}, endpoints: expected vertex numbers, found {kind_of(end)}")
        if not 0 <= end < len(vertices):
            raise PatternError(
                f"{where}, endpoints: there is no vertex {shown(end)}; the panel has vertices 0 to {len(vertices) - 1}"
            )
    start, end = ends
    first, last = _pair(vertices[start]), _pair(vertices[end])
    if hypot(last[0] - first[0], last[1] - first[1]) < 1e-7:
        raise PatternError(
            f"{where}: its length is zero, vertices {start} and {end} lie at one point; move or remove one of them"
        )
    curve = _read_curve(spec.get("curvature"), first, last, units, absolute, where)
    return Edge(start, end, curve, json_label(spec, where), index)


def _read_curve(spec: Any, start: Point, end: Point, units: float, absolute: bool, where: str) -> Curve:
    where = f"{where}, curvature"
    if spec is None:
        return Line(start, end)
    if isinstance(spec, list):  # the format of 2021: one control point
        kind, parameters = "quadratic", [spec]
    else:
        spec = json_object(spec, where)
        kind = required(spec, "type", where)
        if kind not in ("quadratic", "cubic", "circle"):
            raise PatternError(f"{where}: type {shown(kind)} is unknown; use 'quadratic', 'cubic' or 'circle'")
        parameters = json_list(
            required(spec, "params", where),
            f"{where}, params of {kind}",
            {"quadratic": 1, "cubic": 2, "circle": 3}[kind],
        )
    if kind == "circle":
        return _read_arc(parameters, start, end, units, where)
    controls = [
        _control_point(json_numbers(p, 2, f"{where}, control point"), start, end, units, absolute) for p in parameters
    ]
    return (
        QuadraticBezier(start, controls[0], end)
        if kind == "quadratic"
        else CubicBezier(start, controls[0], controls[1], end)
    )


def _control_point(given: tuple[float, ...], start: Point, end: Point, units: float, absolute: bool) -> Point:
    """Absolute: panel coordinates in file units. Relative: in the frame of the edge as a vector (1, 0)."""
    x, y = given
    if absolute:
        return (x / units, y / units)
    along, across = (end[0] - start[0], end[1] - start[1]), (start[1] - end[1], end[0] - start[0])
    return (start[0] + x * along[0] + y * across[0], start[1] + x * along[1] + y * across[1])


def _read_arc(parameters: list[Any], start: Point, end: Point, units: float, where: str) -> CircularArc:
    radius = json_number(parameters[0], f"{where}, radius") / units
    large_arc, right = (
        _side(value, f"{where}, {key}") for key, value in zip(("large_arc", "right"), parameters[1:], strict=True)
    )
    half_chord = 0.5 * hypot(end[0] - start[0], end[1] - start[1])
    if radius < half_chord * (1.0 - RADIUS_TOLERANCE):
        raise PatternError(
            f"{where}: radius {radius * units:g} is smaller than half the distance of the ends, "
            f"{half_chord * units:g}; enlarge it"
        )
    return CircularArc(start, end, max(radius, half_chord), large_arc, right)


def _pair(row: FloatArray) -> Point:
    return (float(row[0]), float(row[1]))


def _side(value: Any, where: str) -> bool:
    if isinstance(value, (bool, int, float)) and value in (0, 1):
        return bool(value)
    raise PatternError(f"{where}: expected 0 or 1, found {shown(value)}")


# ---- stitches


def _read_stitches(body: Mapping[str, Any], panels: Mapping[str, Panel]) -> tuple[Stitch, ...]:
    """Stitches with edge numbers as in the file, in which each edge occurs once at the most."""
    used: dict[StitchSide, int] = {}
    stitches = []
    for number, spec in enumerate(json_list(body.get("stitches", []), "pattern, stitches")):
        where = f"stitch {number}"
        spec = json_list(spec, where)
        if len(spec) not in (2, 3):
            raise PatternError(
                f"{where}: has {len(spec)} elements; give two sides, and 'right_wrong' as a third if start meets start"
            )
        first, second = (_read_side(side, panels, f"{where}, side {i}") for i, side in enumerate(spec[:2]))
        if first == second:
            raise PatternError(
                f"{where}: sews panel {first.panel!r}, edge {first.edge} to itself; name another edge for one side"
            )
        for side in (first, second):
            if side in used:
                raise PatternError(
                    f"panel {side.panel!r}, edge {side.edge}: stitched twice, by stitch {used[side]} and {where}; "
                    "remove one stitch"
                )
            used[side] = number
        stitches.append(Stitch(first, second, len(spec) == 3 and _right_wrong(spec[2], where)))
    return tuple(stitches)


def _read_side(spec: Any, panels: Mapping[str, Panel], where: str) -> StitchSide:
    spec = json_object(spec, where)
    name, edge = required(spec, "panel", where), required(spec, "edge", where)
    if not isinstance(name, str) or name not in panels:
        raise PatternError(f"{where}: there is no panel {shown(name)}; the panels are {listed(panels)}")
    if isinstance(edge, bool) or not isinstance(edge, int):
        raise PatternError(f"{where}, edge: expected an edge number, found {kind_of(edge)}")
    if not 0 <= edge < len(panels[name].edges):
        raise PatternError(
            f"{where}: panel {name!r} has no edge {shown(edge)}; its edges are 0 to {len(panels[name].edges) - 1}"
        )
    return StitchSide(name, edge)


def _right_wrong(flag: Any, where: str) -> bool:
    if flag == "right_wrong" or isinstance(flag, bool):
        return bool(flag)
    raise PatternError(f"{where}: the third element {shown(flag)} is unknown; use 'right_wrong' or leave it out")
