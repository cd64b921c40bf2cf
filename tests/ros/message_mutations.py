"""Mutations of real patterns and bodies, as CDR bytes: of their bytes, their numbers, their structure, their names.

A seed gives the same message on every machine. Most mutations leave the message well formed one level deeper than the
last check that they break, so that all checks are reached.
"""

from __future__ import annotations

import json
import math
import random
import struct
from collections.abc import Callable
from importlib import resources
from typing import Any

import numpy as np
import trimesh

from cloth_sim_ros.messages import encode_mesh, encode_string

__all__ = ["HOSTILE_NAMES", "mutated_body", "mutated_pattern", "real_bodies", "real_patterns"]

HOSTILE_NUMBERS: tuple[Any, ...] = (
    0, -0.0, -1, 1, 1e-300, 1e300, -1e300, 1e9, 2**31, 2**32, 2**63, -(2**63) - 1, 10**400, math.nan, math.inf,
    -math.inf, True, None, "1", "1e5", [], {}, 1e-9, 5e-324, 1e5, 0.1,
)  # fmt: skip
HOSTILE_NAMES = (
    "", " ", "..", "../../etc/passwd", "/etc/passwd", "/dev/zero", "file:///etc/passwd", "http://localhost:1/x",
    "package://cloth_sim_ros/x", "C:\\x", "a\0b", "a\nb", "\x1b[2J", "\u202eabc", "\ud800", "x" * 300, "x" * 100_000,
    "%s%n{0}", "__proto__", "NaN", "${HOME}", "`id`",
)  # fmt: skip
MUCH = 3000
"""Copies of an entry, to see what counts do."""


def real_patterns() -> dict[str, str]:
    """JSON of the built-in patterns."""
    folder = resources.files("cloth_core") / "data" / "patterns"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".json")), key=lambda entry: entry.name)
    return {entry.name: entry.read_text(encoding="utf-8") for entry in files}


def real_bodies() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """A box, a ball and the limbs of a built-in body, coarse enough to be built often."""
    box = trimesh.creation.box((0.2, 0.3, 0.4))
    ball = trimesh.creation.icosphere(2, 0.3)
    path = resources.files("cloth_core") / "data" / "bodies" / "young.ply"
    woman = trimesh.load(str(path), process=False)
    # Every vertex of a grid of 4 cm becomes one: a real body's shape with its thin parts and some triangles lost.
    _, first, cells = np.unique(
        np.floor(woman.vertices / 0.04).astype(int), axis=0, return_index=True, return_inverse=True
    )
    triangles = cells.ravel()[woman.faces]
    kept = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return {
        "box": (np.array(box.vertices), np.array(box.faces)),
        "ball": (np.array(ball.vertices), np.array(ball.faces)),
        "woman": (np.array(woman.vertices[first]), triangles[kept]),
    }


# -- patterns


def mutated_pattern(seed: int, sources: dict[str, str]) -> bytes:
    """A `std_msgs/String` with something wrong, or at least odd, in its pattern."""
    rng = random.Random(seed)
    root = json.loads(rng.choice(list(sources.values())))
    kind = rng.random()
    if kind < 0.08:
        return _mutated_bytes(encode_string(json.dumps(root)), rng)
    if kind < 0.14:
        return encode_string(_mutated_text(json.dumps(root), rng))
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        rng.choice(PATTERN_MUTATIONS)(root, rng)
    try:
        return encode_string(json.dumps(root))
    except UnicodeEncodeError:
        return encode_string(json.dumps(root, ensure_ascii=True))


def _mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    content = bytearray(data)
    for _ in range(rng.choice((1, 2, 8))):
        place = rng.randrange(len(content))
        how = rng.randrange(4)
        if how == 0:
            content[place] ^= 1 << rng.randrange(8)
        elif how == 1:
            content[place : place + 4] = struct.pack("<I", rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1)))
        elif how == 2:
            del content[place : place + rng.randrange(1, 64)]
        else:
            content[place:place] = rng.randbytes(rng.randrange(1, 64))
        if not content:
            break
    return bytes(content)


def _mutated_text(text: str, rng: random.Random) -> str:
    depth = rng.choice((10, 100, 2_000, 100_000))
    place = rng.randrange(len(text))
    return rng.choice(
        (
            text[:place],
            text[:place] + rng.choice('{}[]",:0-\0\n\ufeff') + text[place + 1 :],
            "[" * depth,
            "[" * depth + "]" * depth,
            '{"a":' * depth + "1" + "}" * depth,
            text.replace('"translation"', '"' + "x" * depth + '"', 1),
            text.replace("0", "0" * depth, 1),
            text.replace("1", "1" * depth, 1),
            text + text,
            "\ufeff" + text,
            "",
            rng.choice(HOSTILE_NAMES[:-6]).replace("\ud800", "?"),
            json.dumps(rng.choice(HOSTILE_NUMBERS)),
        )
    )


def _panel(root: Any, rng: random.Random) -> Any:
    panels = root["pattern"]["panels"]
    return panels[rng.choice(list(panels))] if isinstance(panels, dict) and panels else {}


def _any_number(root: Any, rng: random.Random) -> None:
    """Anything, anywhere: a value of the document becomes a hostile one."""
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, entry in list(entries):
            places.append((value, key))
            walk(entry)

    walk(root)
    holder, key = rng.choice(places)
    how = rng.randrange(3)
    if how == 0 and isinstance(holder[key], (int, float)):
        holder[key] = holder[key] * rng.choice((-1, 0.5, 1.1, 2, 10, 100, 1e-3, 1e-6)) + rng.choice((0, 0, 1, -0.5))
    elif how == 1 and isinstance(holder[key], str):
        holder[key] = rng.choice(HOSTILE_NAMES)
    else:
        holder[key] = rng.choice(HOSTILE_NUMBERS)


def _move_vertex(root: Any, rng: random.Random) -> None:
    vertices = _panel(root, rng).get("vertices")
    if isinstance(vertices, list) and vertices:
        row = rng.randrange(len(vertices))
        other = rng.choice(vertices)
        try:
            scale = rng.choice((1e-9, 1e-3, 0.1, 1.0))
            vertices[row] = [a + scale * (b - a) for a, b in zip(vertices[row], other, strict=True)]
        except (TypeError, ValueError):
            vertices[row] = other


def _scale(root: Any, rng: random.Random) -> None:
    panel = _panel(root, rng)
    factors = [rng.choice((1e-6, 1e-3, 0.02, 0.2, 3.0, 30.0, 1e3, 1e6)) for _ in range(2)]
    try:
        panel["vertices"] = [[c * f for c, f in zip(vertex, factors, strict=True)] for vertex in panel["vertices"]]
    except (KeyError, TypeError, ValueError):
        pass


def _endpoints(root: Any, rng: random.Random) -> None:
    edges = _panel(root, rng).get("edges")
    if isinstance(edges, list) and edges:
        edge = rng.choice(edges)
        if isinstance(edge, dict):
            ends = [rng.choice((0, 1, 2, 3, -1, 7, 2**31, 1.0, None, "0")) for _ in range(rng.choice((2, 2, 1, 3)))]
            edge["endpoints"] = ends


def _curve(root: Any, rng: random.Random) -> None:
    edges = _panel(root, rng).get("edges")
    if isinstance(edges, list) and edges and isinstance(edge := rng.choice(edges), dict):

        def number() -> Any:
            return rng.choice((0, 0.5, 1, -0.3, 0.001, 20, rng.uniform(-1, 2), rng.choice(HOSTILE_NUMBERS)))

        edge["curvature"] = rng.choice(
            (
                {"type": "quadratic", "params": [[number(), number()]]},
                {"type": "cubic", "params": [[number(), number()], [number(), number()]]},
                {"type": "circle", "params": [number(), rng.choice((0, 1, 2)), rng.choice((0, 1, None))]},
                [number(), number()],
                {"type": rng.choice(HOSTILE_NAMES), "params": []},
            )
        )


def _stitches(root: Any, rng: random.Random) -> None:
    body = root["pattern"]
    panels = list(body["panels"]) if isinstance(body.get("panels"), dict) else []
    names = [*panels, rng.choice(HOSTILE_NAMES)]
    stitches = body.setdefault("stitches", [])
    if not isinstance(stitches, list):
        return
    how = rng.randrange(5)
    if how == 0 and stitches:
        del stitches[rng.randrange(len(stitches))]
    elif how == 1 and stitches:
        stitches.extend([rng.choice(stitches)] * rng.choice((1, MUCH)))
    elif how == 2 and stitches and isinstance(stitch := rng.choice(stitches), list):
        stitch.append(rng.choice(("right_wrong", True, False, 3)))
    elif how == 3 and stitches and isinstance(stitch := rng.choice(stitches), list):
        stitch.reverse()
    else:
        stitches.append([{"panel": rng.choice(names), "edge": rng.choice((0, 1, 2, 3, 5, -1, 99))} for _ in range(2)])


def _many(root: Any, rng: random.Random) -> None:
    panel = _panel(root, rng)
    how = rng.randrange(4)
    if how == 0:
        panels = root["pattern"]["panels"]
        if isinstance(panels, dict):
            for number in range(rng.choice((3, 40, 600))):
                panels[f"copy {number}"] = panel
    elif how == 1:
        count = rng.choice((5, 50, 500, 6000))
        radius = rng.choice((10.0, 30.0))
        angles = [2 * math.pi * i / count for i in range(count)]
        wave = rng.choice((0.0, 0.3))
        panel["vertices"] = [
            [radius * (1 + wave * (i % 2)) * math.cos(a), radius * (1 + wave * (i % 2)) * math.sin(a)]
            for i, a in enumerate(angles)
        ]
        curvature = rng.choice((None, {"type": "quadratic", "params": [[0.5, 0.1]]}))
        panel["edges"] = [{"endpoints": [i, (i + 1) % count], "curvature": curvature} for i in range(count)]
    elif how == 2 and isinstance(panel.get("vertices"), list):
        panel["vertices"] = panel["vertices"] * rng.choice((2, MUCH))
    elif isinstance(panel.get("edges"), list):
        panel["edges"] = panel["edges"] * rng.choice((2, MUCH))


def _names(root: Any, rng: random.Random) -> None:
    panels = root["pattern"]["panels"]
    if isinstance(panels, dict) and panels:
        old, new = rng.choice(list(panels)), rng.choice(HOSTILE_NAMES)
        panels[new] = panels.pop(old)
        if rng.random() < 0.5:
            root["pattern"] = json.loads(json.dumps(root["pattern"]).replace(json.dumps(old), json.dumps(new)))


def _placement(root: Any, rng: random.Random) -> None:
    panel = _panel(root, rng)
    panel[rng.choice(("translation", "rotation"))] = [
        rng.choice((0, 1, 90, -45, 1e4, 12.3, rng.choice(HOSTILE_NUMBERS))) for _ in range(rng.choice((3, 3, 3, 2)))
    ]


def _properties(root: Any, rng: random.Random) -> None:
    properties = root["properties"]
    if isinstance(properties, dict):
        key = rng.choice(
            ("units_in_meter", "curvature_coords", "normalize_panel_translation", "normalized_edge_loops", "path")
        )
        properties[key] = rng.choice((1, 100, 1000, 39.37, "absolute", "relative", True, False, *HOSTILE_NUMBERS))


def _missing(root: Any, rng: random.Random) -> None:
    holder = rng.choice((root, root.get("pattern"), root.get("properties"), _panel(root, rng)))
    if isinstance(holder, dict) and len(holder) > 0:
        key = rng.choice(list(holder))
        if key not in ("pattern", "panels", "properties") or rng.random() < 0.1:
            holder.pop(key)
            holder.setdefault("pattern", {"panels": {}}) if holder is root else None
            holder.setdefault("properties", {}) if holder is root else None
            holder.setdefault("panels", {}) if holder is root.get("pattern") else None


def _guarded(mutation: Callable[[Any, random.Random], None]) -> Callable[[Any, random.Random], None]:
    """A mutation that leaves alone what a former one made unrecognisable."""

    def apply(root: Any, rng: random.Random) -> None:
        try:
            mutation(root, rng)
        except (AttributeError, LookupError, TypeError):
            pass

    return apply


PATTERN_MUTATIONS = [
    _guarded(mutation)
    for mutation in (
        _any_number, _any_number, _move_vertex, _move_vertex, _scale, _endpoints, _curve, _curve, _stitches, _many,
        _names, _placement, _properties, _missing,
    )
]  # fmt: skip


# -- bodies


def mutated_body(seed: int, sources: dict[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """A `shape_msgs/Mesh` with something wrong, or at least odd."""
    rng = random.Random(seed)
    vertices, triangles = (array.copy() for array in rng.choice(list(sources.values())))
    if rng.random() < 0.1:
        return _mutated_bytes(encode_mesh(vertices, triangles), rng)
    with np.errstate(all="ignore"):
        return _mutated_mesh(vertices, triangles.astype(np.int64), seed, rng)


def _mutated_mesh(vertices: np.ndarray, triangles: np.ndarray, seed: int, rng: random.Random) -> bytes:
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        row = rng.randrange(len(vertices)) if len(vertices) else 0
        how = rng.randrange(15)
        if len(vertices) == 0 or len(triangles) == 0:
            break
        if how == 0:
            vertices[row, rng.randrange(3)] = rng.choice((math.nan, math.inf, -math.inf, 1e300, 1e-300, 1e30, 1e6))
        elif how == 1:
            vertices = vertices * rng.choice((0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.03, 30.0, 1e3, 1e6, 1e30, 1e200, 1e308))
        elif how == 2:
            vertices = vertices + np.array([rng.choice((0.0, 1.0, 1e3, 1e9, 1e18)) for _ in range(3)])
        elif how == 3:
            triangles[rng.randrange(len(triangles)), rng.randrange(3)] = rng.choice(
                (len(vertices), 2**31 - 1, 2**31, 2**32 - 1, rng.randrange(len(vertices)))
            )
        elif how == 4:
            vertices[row] = vertices[rng.randrange(len(vertices))]
        elif how == 5:
            triangles = np.concatenate([triangles] * rng.choice((2, 3, 40)))
        elif how == 6:
            kept = np.array([rng.random() < rng.choice((0.0, 0.5, 0.99)) for _ in range(len(triangles))], dtype=bool)
            triangles = triangles[kept]
        elif how == 7:
            triangles = triangles[:, ::-1]
        elif how == 8:
            vertices[:, rng.randrange(3)] = rng.choice((0.0, 1.0))
        elif how == 9:
            vertices = vertices + np.random.default_rng(seed).normal(scale=rng.choice((1e-6, 0.01, 1.0)), size=(1, 3))
        elif how == 10:
            vertices = vertices + np.random.default_rng(seed).normal(scale=0.05, size=vertices.shape)
        elif how == 11:
            vertices = np.concatenate([vertices, np.full((rng.choice((1, 20_000)), 3), rng.choice((0.0, 1e12, 1.0)))])
        elif how == 12:
            triangles = np.array([[row, row, row]] * rng.choice((1, 5000)))
        elif how == 13:
            order = np.random.default_rng(seed).permutation(len(vertices))
            triangles = order[triangles] if triangles.max() < len(order) else triangles
        else:
            vertices = vertices[: rng.randrange(len(vertices) + 1)]
    return encode_mesh(vertices, triangles.astype(np.uint32))
