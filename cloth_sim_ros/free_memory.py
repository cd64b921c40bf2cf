"""Giving free memory back to the system."""

import ctypes
from collections.abc import Callable

__all__ = ["give_back_free_memory"]


def _find() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None  # another C library than that of GNU
    return trim


_trim = _find()


def give_back_free_memory() -> None:
    """Has the C library return what it keeps for later; takes some milliseconds, without Python's lock.

    Building scenes of changing sizes leaves holes, and each thread that allocates has a heap of its own: without this a
    node keeps the most that each of its threads has ever had.
    """
    if _trim is not None:
        _trim(0)
