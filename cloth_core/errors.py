"""Errors of the simulator. Each message is one line: what is wrong, where, and what to do about it."""

__all__ = [
    "BodyError",
    "ClothError",
    "FabricError",
    "GarmentError",
    "PatternError",
    "SceneError",
    "SimulationError",
]


class ClothError(Exception):
    """Base of every error that the user can mend; its message is one line."""


class PatternError(ClothError):
    """A sewing pattern is malformed; the message names panel, edge or stitch."""


class GarmentError(ClothError):
    """A pattern cannot be turned into particles, triangles and seams."""


class FabricError(ClothError):
    """A fabric parameter is unknown, not finite or physically impossible."""


class BodyError(ClothError):
    """A body mesh cannot be used."""


class SceneError(ClothError):
    """Garment, fabric, body and settings do not fit together."""


class SimulationError(ClothError):
    """A run cannot go on; the last good state is kept."""
