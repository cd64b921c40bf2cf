"""Start positions: a flat panel that touches the body is moved straight out until it is clear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cloth_core.body import Body
from cloth_core.body_contact import BodyContact
from cloth_core.contact import Contact
from cloth_core.errors import SceneError
from cloth_core.garment import Garment

__all__ = ["clear_of_body"]

Floats = NDArray[np.float64]

_STEP = 0.01  # m
_FARTHEST = 1.0  # m


def clear_of_body(garment: Garment, body: Body, gap: float) -> Garment:
    """Move each panel along its normal, outwards first, until no point of it is nearer to the body than gap [m].

    Raises:
        SceneError: a panel is not clear within 1 m either way.
    """
    start = garment.start.copy()
    warnings = list(garment.warnings)
    for k, name in enumerate(garment.panel_names):
        own = np.flatnonzero(garment.panel_of_particle == k)
        local = np.full(len(start), -1, dtype=np.int32)
        local[own] = np.arange(len(own))
        triangles = local[garment.triangles[garment.panel_of_triangle == k]]
        against = BodyContact(body, gap)
        contact = Contact(triangles, against)
        shift = _clear_shift(contact, against, garment.start[own], garment.panel_normals[k], gap)
        if shift is None:
            raise SceneError(
                f"panel '{name}': lies inside the body and is not clear of it within {_FARTHEST:g} m; "
                "place it in front of or behind the body"
            )
        if shift != 0.0:
            start[own] += shift * garment.panel_normals[k]
            side = "outwards" if shift > 0 else "inwards"
            warnings.append(f"panel '{name}': starts inside the body; moved {abs(1000 * shift):.0f} mm {side}")
    return replace(garment, start=start, warnings=tuple(warnings))


def _clear_shift(contact: Contact, body: BodyContact, x: Floats, normal: Floats, gap: float) -> float | None:
    for distance in np.arange(0.0, _FARTHEST, _STEP):
        for direction in (1.0, -1.0):
            moved = np.ascontiguousarray(x + direction * distance * normal)
            travel = contact.search(moved, gap).travel
            # One point tells inside from outside for all of a panel that nothing crosses.
            inside = not body.body.warnings and float(body.body.signed_distance(moved[:1])[0]) < 0.0
            # Reach is twice the gap, so a panel that keeps its travel of a full gap has nothing nearer than it; one
            # that is crossed by the body has sides or corners at no distance from it.
            if float(travel.min()) >= 0.9 * gap and not inside and not body.crosses(moved, contact.triangles):
                return float(direction * distance)
            if distance == 0.0:
                break
    return None
