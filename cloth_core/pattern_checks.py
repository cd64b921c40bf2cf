"""What a pattern must fulfil beyond its format: plausible sizes, simple outlines, seams that do not close an edge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cloth_core.curves import Line
from cloth_core.errors import PatternError
from cloth_core.pattern import Panel, Stitch, StitchSide

__all__ = ["check_merging", "check_outline", "check_size", "corner_pairs", "seam_warnings", "start_distances"]

MIN_PANEL_SIZE, MAX_PANEL_SIZE = 1e-3, 20.0  # [m], the longer side of the bounding box
_USUAL_UNITS = {"centimetres": 100.0, "metres": 1.0, "millimetres": 1000.0, "inches": 39.37}
_USUAL_PANEL_SIZE = (0.03, 3.0)  # [m]
_MIN_AREA_SHARE = 1e-7  # of the squared size
_SAMPLES_PER_CURVE = (64, 512)  # the finer one decides where curves meet at a sharp tip
_MAX_SAMPLES = 50_000  # of one outline; one of thousands of curves needs fewer on each
_LENGTH_RATIO = 1.5  # of sewn edges, above which a warning is given
_TWIST_RATIO = 1.5  # of the distances in the given and the flipped pairing, above which a seam seems twisted

FloatArray = NDArray[np.float64]


def check_size(name: str, vertices: FloatArray, units: float) -> None:
    """PatternError, with the probable unit, if the panel of these vertices (n, 2) [m] is implausibly large or small."""
    size = float(np.ptp(vertices, axis=0).max())
    # with all vertices at one point the edges are to blame, not the unit
    if size == 0.0 or MIN_PANEL_SIZE <= size <= MAX_PANEL_SIZE:
        return
    likely = [
        unit
        for unit, factor in _USUAL_UNITS.items()
        if _USUAL_PANEL_SIZE[0] <= size * units / factor <= _USUAL_PANEL_SIZE[1]
    ]
    advice = (
        f"the numbers look like {likely[0]}: set it to {_USUAL_UNITS[likely[0]]:g}"
        if likely
        else "check the vertices and the unit"
    )
    raise PatternError(f"panel {name!r}: is {size:.3g} m large with units_in_meter = {units:g}; {advice}")


def check_outline(panel: Panel) -> None:
    """PatternError if the curved outline is too large, encloses no area, or crosses or touches itself."""
    import shapely

    where = f"panel {panel.name!r}"
    most = max(_MAX_SAMPLES // len(panel.edges), 8)
    for count in (min(count, most) for count in _SAMPLES_PER_CURVE):
        lines = [
            edge.curve.point(np.linspace(0.0, 1.0, 2 if isinstance(edge.curve, Line) else count))
            for edge in panel.edges
        ]
        for edge, line in zip(panel.edges, lines, strict=True):
            line[0], line[-1] = panel.vertices[edge.start], panel.vertices[edge.end]  # so that neighbours meet exactly
        outline = np.concatenate([line[:-1] for line in lines])
        extent = np.ptp(outline, axis=0)
        if extent.max() > MAX_PANEL_SIZE:
            widest = int(np.argmax([np.ptp(line, axis=0).max() for line in lines]))
            raise PatternError(
                f"{where}, edge {widest}: its curve makes the panel {extent.max():.3g} m large; check its curvature"
            )
        if shapely.LinearRing(outline).is_simple:
            break
    else:
        raise PatternError(
            f"{where}{_crossing([shapely.LineString(line) for line in lines])}; correct vertices or curvature"
        )
    if abs(panel.area) < _MIN_AREA_SHARE * float(extent.max()) ** 2:
        raise PatternError(f"{where}: its outline encloses no area; move a vertex")


def _crossing(lines: list[object]) -> str:
    """Which edges of an outline that is not simple cross or touch, as a piece of the message."""
    import shapely

    for i, line in enumerate(lines):
        if not shapely.is_simple(line):
            return f", edge {i}: crosses itself"
    tree = shapely.STRtree(lines)
    for i, line in enumerate(lines):
        for j in sorted(int(j) for j in tree.query(line, predicate="intersects") if j > i):
            neighbours = j - i == 1 or (i == 0 and j == len(lines) - 1)
            if not neighbours or shapely.intersection(line, lines[j]).geom_type != "Point":
                return f", edges {i} and {j}: cross or touch each other"
    return ": its outline crosses or touches itself"


def corner_pairs(panels: Mapping[str, Panel], stitch: Stitch) -> tuple[tuple[int, int], tuple[int, int]]:
    """Vertices that a stitch joins: ((start of the first edge, its partner), (end of the first edge, its partner))."""
    first = panels[stitch.first.panel].edges[stitch.first.edge]
    second = panels[stitch.second.panel].edges[stitch.second.edge]
    if stitch.start_meets_end:
        return (first.start, second.end), (first.end, second.start)
    return (first.start, second.start), (first.end, second.end)


class _Corners:
    """Sets of panel corners, given by panel and vertex, that sewing joins into one point."""

    def __init__(self, panels: Mapping[str, Panel]) -> None:
        self._parent = {
            (name, vertex): (name, vertex) for name, p in panels.items() for vertex in range(len(p.vertices))
        }

    def root(self, corner: tuple[str, int]) -> tuple[str, int]:
        """The corner that stands for a set."""
        while self._parent[corner] != corner:
            self._parent[corner] = self._parent[self._parent[corner]]
            corner = self._parent[corner]
        return corner

    def join(self, one: tuple[str, int], other: tuple[str, int]) -> None:
        """Make two corners, with all that they are joined to, one point."""
        self._parent[self.root(one)] = self.root(other)


def check_merging(panels: Mapping[str, Panel], stitches: Sequence[Stitch]) -> None:
    """PatternError if sewing would join the two ends of an edge into one point.

    An edge may become a ring, as the hem of a sleeve of one panel does: there a seam between two *other* edges of the
    panel joins its ends directly.
    """
    corners = _Corners(panels)
    root = corners.root
    closing: dict[tuple[str, frozenset[int]], list[Stitch]] = {}
    number = {side: i for i, stitch in enumerate(stitches) for side in (stitch.first, stitch.second)}
    for stitch in stitches:
        for here, there in corner_pairs(panels, stitch):
            corners.join((stitch.first.panel, here), (stitch.second.panel, there))
            if stitch.first.panel == stitch.second.panel:
                closing.setdefault((stitch.first.panel, frozenset((here, there))), []).append(stitch)
    for name, panel in panels.items():
        for i, edge in enumerate(panel.edges):
            if root((name, edge.start)) != root((name, edge.end)):
                continue
            side = StitchSide(name, i)
            if any(side not in (s.first, s.second) for s in closing.get((name, frozenset((edge.start, edge.end))), [])):
                continue
            near = [StitchSide(name, k % len(panel.edges)) for k in (i - 1, i, i + 1)]
            involved = sorted({number[side] for side in near if side in number})
            raise PatternError(
                f"panel {name!r}, edge {edge.file_index}: sewing would join its two ends into one point; "
                f"check edges and 'right_wrong' of stitch {' and '.join(map(str, involved)) or 'es at its ends'}"
            )


def start_distances(panels: Mapping[str, Panel], stitch: Stitch) -> tuple[float, float]:
    """Sum of the distances [m] between edge ends that meet, before sewing: as the stitch is given, and if flipped."""
    (a, b), (c, d) = _world_ends(panels, stitch)
    return float(np.linalg.norm(a - c) + np.linalg.norm(b - d)), float(np.linalg.norm(a - d) + np.linalg.norm(b - c))


def _world_ends(panels: Mapping[str, Panel], stitch: Stitch) -> tuple[FloatArray, FloatArray]:
    """World positions (2, 3) [m] of the ends of both edges, in the order in which they meet."""
    first, second = panels[stitch.first.panel], panels[stitch.second.panel]
    (a, c), (b, d) = corner_pairs(panels, stitch)
    return first.to_world(first.vertices[[a, b]]), second.to_world(second.vertices[[c, d]])


def _seems_twisted(panels: Mapping[str, Panel], stitches: Sequence[Stitch], i: int) -> bool:
    """Whether stitch i probably is sewn the wrong way round.

    If the other stitches join corners of its two edges already, that tells. Otherwise it seems so if the ends would
    start closer the other way round, clearly so if the distance between the panels is left out. That alone is no sign:
    an edge which has to go round the body before it meets its partner starts the other way round.
    """
    stitch = stitches[i]
    corners = _Corners(panels)
    for other in (*stitches[:i], *stitches[i + 1 :]):
        for here, there in corner_pairs(panels, other):
            corners.join((other.first.panel, here), (other.second.panel, there))
    (a, c), (b, d) = (
        (corners.root((stitch.first.panel, here)), corners.root((stitch.second.panel, there)))
        for here, there in corner_pairs(panels, stitch)
    )
    if (a == c or b == d) != (a == d or b == c):
        return a == d or b == c
    given, flipped = start_distances(panels, stitch)
    first, second = _world_ends(panels, stitch)
    along, across = first[1] - first[0], second[1] - second[0]
    return given > flipped and bool(np.linalg.norm(along - across) > _TWIST_RATIO * np.linalg.norm(along + across))


def seam_warnings(panels: Mapping[str, Panel], stitches: Sequence[Stitch]) -> list[str]:
    """Seams of very different lengths, and seams that probably are sewn the wrong way round."""
    warnings = []
    for i, stitch in enumerate(stitches):
        edges = [panels[side.panel].edges[side.edge] for side in (stitch.first, stitch.second)]
        sides = " and ".join(
            f"panel {side.panel!r}, edge {edge.file_index}"
            for side, edge in zip((stitch.first, stitch.second), edges, strict=True)
        )
        short, long = sorted(edge.length for edge in edges)
        if long > _LENGTH_RATIO * short:
            lengths = f"{edges[0].length:.3g} m and {edges[1].length:.3g} m"
            warnings.append(f"stitch {i} ({sides}): lengths {lengths} differ by more than half; it gathers or is wrong")
        if _seems_twisted(panels, stitches, i):
            advice = (
                "perhaps 'right_wrong' is missing"
                if stitch.start_meets_end
                else "perhaps 'right_wrong' is one too many"
            )
            warnings.append(
                f"stitch {i} ({sides}): seems twisted, its ends would start closer the other way round; {advice}"
            )
    return warnings
