"""Start positions of all that is worn: clear of the body, layer upon layer, with limbs where they belong."""

from __future__ import annotations

from cloth_core.approach import brought_near
from cloth_core.body import Body
from cloth_core.curled_start import curled_inside_limbs
from cloth_core.garment import Garment
from cloth_core.layering import separate_panels
from cloth_core.limb_room import with_room_for_limbs
from cloth_core.placement import clear_of_body

__all__ = ["started_around"]

# Between panels that a pattern puts across each other [m].
_PANEL_GAP = 0.01


def started_around(garment: Garment, body: Body | None, gap: float) -> Garment:
    """A garment with its panels where they can be sewn around the body.

    Args:
        garment: as the pattern puts it.
        body: what it is worn by; without one panels are only kept from each other.
        gap: to the body [m].

    Raises:
        SceneError: a panel cannot be put clear of the body.
    """
    if body is None:
        return separate_panels(garment, _PANEL_GAP)
    garment = clear_of_body(garment, body, gap)
    apart = separate_panels(garment, _PANEL_GAP)
    if apart is not garment:
        apart = clear_of_body(apart, body, gap)
    return with_room_for_limbs(curled_inside_limbs(brought_near(apart, body), body), body)
