"""The parameters of the node: what they mean, in which ranges they lie, and the checks that no range expresses."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from cloth_core.body import builtin_bodies
from cloth_core.errors import ClothError
from cloth_core.fabric import Fabric, fabric_presets
from cloth_core.pattern import builtin_patterns
from cloth_core.quality import QUALITIES
from cloth_core.switched_off import SWITCHABLE, check_without
from cloth_sim_ros.scene_inputs import Limits, SceneParameters
from cloth_sim_ros.worker import WorkerSettings

__all__ = ["PARAMETERS", "NodeParameter", "check", "scene_parameters", "worker_settings"]

AT_ONCE = "at once"
NEXT_SCENE = "with the next pattern, body or reset"
NEXT_BODY = "with the next body"
AT_START = "at start and cannot be set later"


@dataclass(frozen=True)
class NodeParameter:
    """A parameter with its default value, unit, closed range, and when it acts."""

    name: str
    default: bool | int | float | str | list[float] | list[str]
    summary: str
    acts: str = AT_ONCE
    unit: str = ""
    constraints: str = ""
    lowest: float | None = None
    highest: float | None = None

    @property
    def read_only(self) -> bool:
        """Whether it can only be set when the node is started."""
        return self.acts == AT_START

    @property
    def description(self) -> str:
        """What it is, its unit, and when it acts; one or two sentences."""
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{self.summary}{unit}. Acts {self.acts}."

    def to_dict(self, value: object) -> dict[str, object]:
        """All there is to know, with the present value, as values that JSON can hold."""
        limits = None if self.lowest is None else [self.lowest, self.highest]
        return {
            "value": value,
            "default": self.default,
            "unit": self.unit or None,
            "range": limits,
            "constraints": self.constraints or None,
            "acts": self.acts,
            "read_only": self.read_only,
            "description": self.summary,
        }


_SCENE = SceneParameters()
_SETTINGS = WorkerSettings()

PARAMETERS = (
    NodeParameter(
        "fabric", _SCENE.fabric, "Fabric preset", NEXT_SCENE, constraints=f"One of {', '.join(fabric_presets())}."
    ),
    NodeParameter(
        "quality",
        _SCENE.quality,
        "Speed against accuracy; not used where tolerance is above 0",
        NEXT_SCENE,
        constraints=f"One of {', '.join(QUALITIES)}.",
    ),
    NodeParameter(
        "tolerance",
        _SCENE.tolerance,
        "Largest error of the drape; 0 leaves the choice to quality",
        NEXT_SCENE,
        "mm",
        lowest=0.0,
        highest=1000.0,
    ),
    NodeParameter("gravity", _SCENE.gravity, "Gravity, downward", NEXT_SCENE, "m/s^2", lowest=0.0, highest=100.0),
    NodeParameter(
        "air_drag",
        _SCENE.air_drag,
        "Air drag per mass and speed, k_a in F = -m k_a v",
        NEXT_SCENE,
        "1/s",
        lowest=0.0,
        highest=1000.0,
    ),
    NodeParameter(
        "without",
        [""],  # an empty list would have no type
        "Terms that are switched off; the report says what the run lacks",
        NEXT_SCENE,
        constraints=f"Some of {', '.join(SWITCHABLE)}; [''] for none.",
    ),
    NodeParameter(
        "frame_id",
        _SCENE.frame_id,
        "Coordinate frame of body, garment and grippers, in metres with z up",
        NEXT_SCENE,
        constraints="Not empty, without spaces or a leading slash.",
    ),
    NodeParameter(
        "garment_color",
        list(_SCENE.garment_color),
        "Color of ~/garment: red, green, blue, alpha",
        NEXT_SCENE,
        constraints="Four numbers from 0 to 1.",
    ),
    NodeParameter(
        "body_color",
        list(_SCENE.body_color),
        "Color of ~/body_marker: red, green, blue, alpha",
        NEXT_SCENE,
        constraints="Four numbers from 0 to 1.",
    ),
    NodeParameter(
        "publish_rate",
        _SETTINGS.publish_rate,
        "Frames of ~/garment per second of wall-clock time while it moves",
        unit="Hz",
        lowest=0.1,
        highest=240.0,
    ),
    NodeParameter("auto_start", _SETTINGS.auto_start, "Whether a new garment starts to move by itself"),
    NodeParameter(
        "paused", _SETTINGS.paused, "Whether the garment is held still, whatever was asked for; ~/step moves it"
    ),
    NodeParameter(
        "real_time_factor",
        _SETTINGS.real_time_factor,
        "Most simulated per wall-clock time, 1 for real time; 0 runs as fast as possible",
        unit="s/s",
        lowest=0.0,
        highest=1000.0,
    ),
    NodeParameter(
        "step_duration",
        _SETTINGS.step_duration,
        "Simulated time of one ~/step; 0 takes 1 / publish_rate",
        unit="s",
        lowest=0.0,
        highest=10.0,
    ),
    NodeParameter(
        "publish_clock", _SETTINGS.publish_clock, "Whether the time of the run, as in all stamps, is sent on /clock"
    ),
    NodeParameter(
        "grippers",
        ["gripper"],
        "Names of grippers: each has a topic ~/NAME/pose and services ~/NAME/grasp and ~/NAME/release",
        AT_START,
        constraints="Different ROS names without slashes.",
    ),
    NodeParameter(
        "grasp_radius",
        _SETTINGS.grasp_radius,
        "A gripper takes the particles that are not farther from it; acts on the next grasp",
        unit="m",
        lowest=0.0001,
        highest=10.0,
    ),
    NodeParameter(
        "grasp_speed",
        _SETTINGS.grasp_speed,
        "No held particle is moved faster",
        unit="m/s",
        lowest=0.001,
        highest=100.0,
    ),
    NodeParameter(
        "body_move_duration",
        _SETTINGS.body_move_duration,
        "Simulated time in which a body with the same triangles gets to its new vertices; 0 starts the garment again",
        NEXT_BODY,
        "s",
        lowest=0.0,
        highest=60.0,
    ),
    NodeParameter(
        "body_speed",
        _SETTINGS.body_speed,
        "No vertex of the body is moved faster",
        NEXT_BODY,
        "m/s",
        lowest=0.001,
        highest=100.0,
    ),
    NodeParameter(
        "record_directory",
        _SETTINGS.record_directory,
        "Directory in which ~/record and ~/save make new files; made if need be",
        constraints="Not empty.",
    ),
    NodeParameter(
        "max_particles",
        _SETTINGS.limits.max_particles,
        "Largest garment that is built",
        NEXT_SCENE,
        "particles",
        lowest=4,
        highest=10_000_000,
    ),
    NodeParameter(
        "max_triangles",
        _SETTINGS.limits.max_triangles,
        "Largest body that is taken from ~/body",
        NEXT_BODY,
        "triangles",
        lowest=1,
        highest=2_000_000,
    ),
    NodeParameter(
        "body",
        "",
        "Built-in body to drape on; ~/body replaces it",
        constraints=f"Empty, or one of {', '.join(builtin_bodies())}.",
    ),
    NodeParameter(
        "pattern",
        "",
        "Built-in pattern to drape; ~/pattern replaces it",
        constraints=f"Empty, or one of {', '.join(builtin_patterns())}.",
    ),
)


def scene_parameters(values: Mapping[str, Any]) -> SceneParameters:
    """Those of the values that a scene takes."""
    chosen = {field.name: values[field.name] for field in fields(SceneParameters)}
    for color in ("garment_color", "body_color"):
        chosen[color] = tuple(chosen[color])
    chosen["without"] = _names(values["without"])
    return SceneParameters(**chosen)


def _names(values: Iterable[str]) -> tuple[str, ...]:
    """Those that are not empty, each once."""
    return tuple(dict.fromkeys(name for name in values if name))


def worker_settings(values: Mapping[str, Any]) -> WorkerSettings:
    """Those of the values that act at once."""
    limits = Limits(max_particles=values["max_particles"], max_triangles=values["max_triangles"])
    chosen = {field.name: values[field.name] for field in fields(WorkerSettings) if field.name in values}
    return WorkerSettings(**chosen, limits=limits)


def check(values: Mapping[str, Any]) -> None:
    """Refuses values that lie within the ranges and still cannot be used.

    Args:
        values: of all parameters

    Raises:
        ClothError: names the parameter and what it may be.
    """
    Fabric.preset(values["fabric"])
    scene_parameters(values).settings()
    check_without(_names(values["without"]))
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
    names = list(values["grippers"])
    if len(set(names)) < len(names) or not all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) for name in names):
        raise ClothError(f"grippers {names}: give different names of letters, digits and underscores")
    if not values["record_directory"] or "\0" in values["record_directory"]:
        raise ClothError("record_directory: it is empty; give a directory")
