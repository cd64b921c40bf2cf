"""Fabric parameters in SI units, with presets whose every figure names its source (data/fabrics.json)."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import resources
from typing import Any

from cloth_core.errors import FabricError

__all__ = ["Fabric", "fabric_presets", "fabric_sources"]

# name: (lowest, highest) physically plausible value; outside of it a factor of a thousand was lost somewhere.
_RANGES = {
    "area_density": (1e-3, 1e2),
    "structural_warp": (1e-3, 1e8),
    "structural_weft": (1e-3, 1e8),
    "shear": (0.0, 1e8),
    "shear_spring": (0.0, 1e8),
    "bending": (0.0, 1.0),
    "bending_spring": (0.0, 1e8),
    "damping_time": (0.0, 1.0),
    "bending_damping_time": (0.0, 1.0),
    "friction": (0.0, 10.0),
    "thickness": (0.0, 0.05),
    "strain_limit": (1e-4, 10.0),
}

# Stiffness of the bending springs of a smoothed fabric, as a share of the structural one.
_SMOOTHING = 0.003


@dataclass(frozen=True)
class Fabric:
    """What a cloth is made of.

    Attributes:
        name: of the preset, or free.
        area_density: mass per area [kg/m^2].
        structural_warp, structural_weft: spring stiffness along warp and weft [N/m]; does not depend on the spacing.
        shear: shear modulus of the membrane [N/m], as a trellis resists it (`cloth_core.trellis`).
        bending: bending stiffness [N m] (true bending, per unit width).
        bending_spring: stiffness of the paper's springs between particles two apart [N/m].
        shear_spring: stiffness of the paper's springs along both diagonals of a cell [N/m]; it adds to the shear
            modulus, and to the stiffness along warp and weft.
        damping_time: Kelvin-Voigt time of the springs [s]: a strain rate e' acts like a strain of damping_time * e'.
        bending_damping_time: the same of true bending [s].
        friction: Coulomb coefficient of the cloth on a body.
        thickness: of the cloth [m].
        strain_limit: largest strain in use (0.05 = 5 %); a run that ends above it says so.

    Raises:
        FabricError: a value is not finite or not plausible.
    """

    name: str
    area_density: float
    structural_warp: float
    structural_weft: float
    shear: float
    bending: float
    bending_spring: float = 0.0
    shear_spring: float = 0.0
    damping_time: float = 1e-5
    bending_damping_time: float = 5e-3
    friction: float = 0.35
    thickness: float = 5e-4
    strain_limit: float = 0.05

    def __post_init__(self) -> None:
        for key, (low, high) in _RANGES.items():
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise FabricError(
                    f"fabric '{self.name}', {key}: {value!r} is no finite number; give a value in SI units"
                )
            if not low <= value <= high:
                raise FabricError(
                    f"fabric '{self.name}', {key}: {value:g} lies outside {low:g} to {high:g}; give it in SI units"
                )

    @classmethod
    def preset(cls, name: str, **changes: float) -> Fabric:
        """A built-in fabric, with single parameters changed if wanted.

        Raises:
            FabricError: there is no such preset or parameter.
        """
        table = _table()
        if name not in table:
            raise FabricError(f"fabric '{name}': not known; use one of {', '.join(table)}")
        values = {key: entry[0] for key, entry in table[name].items() if key != "description"}
        fabric = cls(name=name, **values)
        unknown = set(changes) - {f.name for f in fields(cls)}
        if unknown:
            raise FabricError(f"fabric '{name}': no parameter '{sorted(unknown)[0]}'; use one of {', '.join(_RANGES)}")
        return replace(fabric, **changes)  # type: ignore[arg-type]

    @property
    def smoothed(self) -> Fabric:
        """The fabric with the paper's springs for shear and bending, for shapes that are only passed through.

        They have no stiffness against slight bending, but on a coarse grid a lot against folds of the size of a cell:
        panels that are pulled together do not crumple, and a coarse drape has no creases across which a finer mesh
        would cut.
        """
        weaker = min(self.structural_warp, self.structural_weft)
        return replace(
            self,
            bending_spring=max(self.bending_spring, _SMOOTHING * weaker),
            shear=0.0,
            shear_spring=self.shear + self.shear_spring,
        )


def fabric_presets() -> list[str]:
    """Names of the built-in fabrics."""
    return list(_table())


def fabric_sources(name: str) -> dict[str, str]:
    """Where each figure of a preset comes from."""
    return {key: entry[1] for key, entry in _table()[name].items() if key != "description"}


@cache
def _table() -> dict[str, dict[str, Any]]:
    text = resources.files("cloth_core").joinpath("data/fabrics.json").read_text(encoding="utf-8")
    table: dict[str, dict[str, Any]] = json.loads(text)
    return table
