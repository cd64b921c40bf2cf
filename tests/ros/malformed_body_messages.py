"""Body messages that must be refused: what is wrong with each, its bytes, and what the refusal must say."""

from __future__ import annotations

import struct

import numpy as np
from small_scenes import BOX_TRIANGLES, BOX_VERTICES

from cloth_sim_ros.messages import encode_mesh

__all__ = ["MALFORMED_BODIES"]

GOOD = encode_mesh(BOX_VERTICES, BOX_TRIANGLES)
VERTEX_COUNT_AT = 4 + 4 + 12 * len(BOX_TRIANGLES)
"""Place of the count of vertices: behind the header, the count of triangles and the triangles."""


def _with_count(place: int, count: int) -> bytes:
    return GOOD[:place] + struct.pack("<I", count) + GOOD[place + 4 :]


def _with_vertex(row: int, value: float) -> bytes:
    vertices = BOX_VERTICES.copy()
    vertices[row, 2] = value
    return encode_mesh(vertices, BOX_TRIANGLES)


def _with_index(index: int) -> bytes:
    triangles = BOX_TRIANGLES.astype(np.uint32)
    triangles[3, 1] = index
    return encode_mesh(BOX_VERTICES, triangles)


NO_TRIANGLES = np.empty((0, 3), dtype=np.int32)

MALFORMED_BODIES: dict[str, tuple[bytes, str]] = {
    "no bytes": (b"", "0 bytes are too few"),
    "header only": (GOOD[:4], "count of triangles needs 4 bytes but only 0 are left"),
    "big endian": (b"\x00\x00\x00\x00" + GOOD[4:], "encapsulation 0000"),
    "parameter list": (b"\x00\x03\x00\x00" + GOOD[4:], "encapsulation 0003"),
    "XCDR 2": (b"\x00\x07\x00\x00" + GOOD[4:], "encapsulation 0007"),
    "cut in the triangles": (GOOD[:40], "triangles[12] needs 144 bytes but only 32 are left"),
    "cut before the vertices": (GOOD[:VERTEX_COUNT_AT], "count of vertices needs 4 bytes"),
    "cut in the vertices": (GOOD[:-8], "vertices[8] needs 192 bytes but only 184 are left"),
    "cut by one byte": (GOOD[:-1], "vertices[8] needs 192 bytes but only 191 are left"),
    "four billion triangles": (_with_count(4, 2**32 - 1), "more than max_triangles"),
    "one triangle more than there are": (_with_count(4, 13), "needs"),
    "four billion vertices": (_with_count(VERTEX_COUNT_AT, 2**32 - 1), "vertices[4294967295] needs 103079215080 bytes"),
    "one vertex more than there are": (_with_count(VERTEX_COUNT_AT, 9), "vertices[9] needs 216 bytes"),
    "one vertex fewer than there are": (_with_count(VERTEX_COUNT_AT, 7), "24 bytes follow its last field"),
    "another message behind it": (GOOD + GOOD, "bytes follow its last field"),
    "index one too high": (_with_index(8), "triangle 3: index 8 has no vertex"),
    "index above 2^31": (_with_index(2**31 + 1), "triangle 3: index 2147483649 has no vertex"),
    "NaN": (_with_vertex(5, np.nan), "vertex 5"),
    "infinity": (_with_vertex(2, np.inf), "vertex 2"),
    "no triangles": (encode_mesh(BOX_VERTICES, NO_TRIANGLES), "triangles"),
    "nothing at all": (encode_mesh(BOX_VERTICES[:0], NO_TRIANGLES), "vertices"),
    "all triangles without an area": (encode_mesh(0.0 * BOX_VERTICES, BOX_TRIANGLES), "area"),
}
