"""The parameters of the node: what they mean, in which ranges they lie, and the checks that no range expresses."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from cloth_core.body import builtin_bodies
from cloth_core.errors import ClothError
from cloth_core.fabric import Fabric, fabric_presets
from cloth_core.pattern import builtin_patterns
from cloth_core.quality import QUALITIES
from cloth_sim_ros.scene_inputs import Limits, SceneParameters
from cloth_sim_ros.worker import WorkerSettings

__all__ = ["PARAMETERS", "NodeParameter", "check", "scene_parameters", "worker_settings"]

AT_ONCE = "Acts at once."
NEXT_SCENE = "Acts with the next pattern, body or reset."


@dataclass(frozen=True)
class NodeParameter:
    """A parameter with its default value, description and closed range."""

    name: str
    default: bool | int | float | str | list[float]
    description: str
    constraints: str = ""
    lowest: float | None = None
    highest: float | None = None


_SCENE = SceneParameters()
_SETTINGS = WorkerSettings()

PARAMETERS = (
    NodeParameter(
        "fabric",
        _SCENE.fabric,
        f"Fabric preset. {NEXT_SCENE}",
        f"One of {', '.join(fabric_presets())}.",
    ),
    NodeParameter(
        "quality",
        _SCENE.quality,
        f"Speed against accuracy; not used where tolerance is above 0. {NEXT_SCENE}",
        f"One of {', '.join(QUALITIES)}.",
    ),
    NodeParameter(
        "tolerance",
        _SCENE.tolerance,
        f"Largest error of the drape [mm]; 0 leaves the choice to quality. {NEXT_SCENE}",
        lowest=0.0,
        highest=1000.0,
    ),
    NodeParameter("gravity", _SCENE.gravity, f"Gravity, downward [m/s^2]. {NEXT_SCENE}", lowest=0.0, highest=100.0),
    NodeParameter(
        "air_drag",
        _SCENE.air_drag,
        f"Air drag per mass and speed, k_a in F = -m k_a v [1/s]. {NEXT_SCENE}",
        lowest=0.0,
        highest=1000.0,
    ),
    NodeParameter(
        "frame_id",
        _SCENE.frame_id,
        f"Coordinate frame of body and garment, in metres with z up. {NEXT_SCENE}",
        "Not empty, without spaces or a leading slash.",
    ),
    NodeParameter(
        "garment_color",
        list(_SCENE.garment_color),
        f"Color of ~/garment: red, green, blue, alpha. {NEXT_SCENE}",
        "Four numbers from 0 to 1.",
    ),
    NodeParameter(
        "body_color",
        list(_SCENE.body_color),
        f"Color of ~/body_marker: red, green, blue, alpha. {NEXT_SCENE}",
        "Four numbers from 0 to 1.",
    ),
    NodeParameter(
        "publish_rate",
        _SETTINGS.publish_rate,
        "Frames of ~/garment per second of wall-clock time while it moves [Hz]; ~/step moves it by 1 / publish_rate "
        f"of simulated time. {AT_ONCE}",
        lowest=0.1,
        highest=240.0,
    ),
    NodeParameter(
        "auto_start",
        _SETTINGS.auto_start,
        f"Whether a new garment starts to move by itself. {AT_ONCE}",
    ),
    NodeParameter(
        "record_directory",
        _SETTINGS.record_directory,
        f"Directory in which ~/record and ~/save make new files; made if need be. {AT_ONCE}",
        "Not empty.",
    ),
    NodeParameter(
        "max_particles",
        _SETTINGS.limits.max_particles,
        "Largest garment that is built [particles]. Acts with the next pattern, body or reset.",
        lowest=4,
        highest=10_000_000,
    ),
    NodeParameter(
        "max_triangles",
        _SETTINGS.limits.max_triangles,
        "Largest body that is taken from ~/body [triangles]. Acts with the next body.",
        lowest=1,
        highest=2_000_000,
    ),
    NodeParameter(
        "body",
        "",
        f"Built-in body to drape on; ~/body replaces it. {AT_ONCE}",
        f"Empty, or one of {', '.join(builtin_bodies())}.",
    ),
    NodeParameter(
        "pattern",
        "",
        f"Built-in pattern to drape; ~/pattern replaces it. {AT_ONCE}",
        f"Empty, or one of {', '.join(builtin_patterns())}.",
    ),
)


def scene_parameters(values: Mapping[str, Any]) -> SceneParameters:
    """Those of the values that a scene takes."""
    chosen = {field.name: values[field.name] for field in fields(SceneParameters)}
    for color in ("garment_color", "body_color"):
        chosen[color] = tuple(chosen[color])
    return SceneParameters(**chosen)


def worker_settings(values: Mapping[str, Any]) -> WorkerSettings:
    """Those of the values that act at once."""
    limits = Limits(max_particles=values["max_particles"], max_triangles=values["max_triangles"])
    return replace(
        _SETTINGS,
        publish_rate=values["publish_rate"],
        auto_start=values["auto_start"],
        record_directory=values["record_directory"],
        limits=limits,
    )


def check(values: Mapping[str, Any]) -> None:
    """Refuses values that lie within the ranges and still cannot be used.

    Args:
        values: of all parameters

    Raises:
        ClothError: names the parameter and what it may be.
    """
    Fabric.preset(values["fabric"])
    scene_parameters(values).settings()
    for name, choices in (("body", builtin_bodies()), ("pattern", builtin_patterns())):
        if values[name] and values[name] not in choices:
            raise ClothError(f"{name} '{values[name]}': not known; use one of {', '.join(choices)}")
    frame_id = values["frame_id"]
    if not frame_id or frame_id.startswith("/") or frame_id.split() != [frame_id]:
        raise ClothError(f"frame_id '{frame_id}': give a name without spaces or a leading slash")
    for name in ("garment_color", "body_color"):
        color = values[name]
        if len(color) != 4 or not all(0.0 <= part <= 1.0 for part in color):
            raise ClothError(f"{name} {list(color)}: give red, green, blue and alpha from 0 to 1")
    if not values["record_directory"] or "\0" in values["record_directory"]:
        raise ClothError("record_directory: it is empty; give a directory")
