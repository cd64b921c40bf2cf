"""What a scene is made of as it comes in piece by piece, and the limits within which it is built."""

from dataclasses import asdict, dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cloth_core.body import Body
from cloth_core.calibration import Cloth
from cloth_core.errors import SceneError
from cloth_core.fabric import Fabric
from cloth_core.pattern import Pattern
from cloth_core.quality import Settings, settings_for
from cloth_core.scene import Scene
from cloth_sim_ros.messages import Color, encode_mesh
from cloth_sim_ros.run_messages import BODY_COLOR, GARMENT_COLOR

__all__ = ["Limits", "ReceivedBody", "SceneInputs", "SceneParameters", "build_scene"]


@dataclass(frozen=True)
class SceneParameters:
    """Values that a scene takes over when it is built, that is with the next pattern, body or reset."""

    fabric: str = "cotton_poplin"
    quality: str = "normal"
    tolerance: float = 0.0
    """Largest error [mm]; 0 leaves the choice to `quality`."""
    gravity: float = 9.80665
    """Downward [m/s^2]."""
    air_drag: float = 1.0
    """k_a [1/s]."""
    without: tuple[str, ...] = ()
    """Terms that are switched off."""
    frame_id: str = "map"
    garment_color: Color = GARMENT_COLOR
    body_color: Color = BODY_COLOR

    def to_dict(self) -> dict[str, object]:
        """Values that JSON can hold."""
        return asdict(self)

    def settings(self, *patterns: Pattern) -> Settings:
        """Numerical settings that quality and tolerance stand for, for these patterns in the fabric.

        Raises:
            ClothError: unknown quality or fabric, or a tolerance that is not positive.
        """
        cloth = Cloth.of(sum(p.area for p in patterns), Fabric.preset(self.fabric)) if patterns else None
        return settings_for(self.quality, self.tolerance / 1000.0 if self.tolerance > 0.0 else None, cloth)


@dataclass(frozen=True)
class Limits:
    """Largest scene that is built; a message cannot ask for more."""

    max_particles: int = 200_000
    max_triangles: int = 500_000

    def check_particles(self, count: int) -> None:
        """Refuses a garment of more particles.

        Raises:
            SceneError: says how many.
        """
        if count > self.max_particles:
            raise SceneError(
                f"garment: {count} particles are more than max_particles = {self.max_particles}; "
                "choose a coarser quality, a smaller garment or raise the parameter"
            )


@dataclass(frozen=True, eq=False)
class ReceivedBody:
    """A checked body and the mesh that it was made from, for the log."""

    body: Body
    message: bytes
    """`shape_msgs/Mesh` as it came in, before any repair."""
    triangles: npt.NDArray[np.int32]
    """As they came in, (m, 3)."""

    @classmethod
    def from_arrays(
        cls, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32], name: str = "body"
    ) -> "ReceivedBody":
        """Checks vertices [m], (n, 3), and triangles (m, 3).

        Raises:
            BodyError: the mesh cannot be used.
        """
        return cls(Body.from_arrays(vertices, triangles, name), encode_mesh(vertices, triangles), triangles)

    @classmethod
    def builtin(cls, name: str) -> "ReceivedBody":
        """A body that comes with the package.

        Raises:
            BodyError: there is none of that name.
        """
        body = Body.load(name)
        return cls(body, encode_mesh(body.vertices, body.triangles), body.triangles)

    def moved(self, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> "ReceivedBody | None":
        """The same body elsewhere, if these vertices [m], (n, 3), and triangles (m, 3) are that; else None."""
        same = len(vertices) == len(self.body.vertices) and np.array_equal(triangles, self.triangles)
        if not (same and np.isfinite(vertices).all()):
            return None
        return ReceivedBody(self.body.moved(vertices), encode_mesh(vertices, triangles), self.triangles)


@dataclass(frozen=True, eq=False)
class SceneInputs:
    """Everything accepted so far."""

    pattern: Pattern | None = None
    body: ReceivedBody | None = None
    parameters: SceneParameters = field(default_factory=SceneParameters)

    def same_scene(self, other: "SceneInputs") -> bool:
        """Whether both make the same scene; frame and colors are not part of it."""
        mine = self.parameters
        theirs = replace(
            other.parameters, frame_id=mine.frame_id, garment_color=mine.garment_color, body_color=mine.body_color
        )
        return self.pattern is other.pattern and self.body is other.body and mine == theirs


def build_scene(inputs: SceneInputs, limits: Limits) -> Scene:
    """The scene of the inputs, which hold a pattern.

    Raises:
        ClothError: they do not fit together or exceed the limits.
    """
    assert inputs.pattern is not None
    parameters = inputs.parameters
    settings = parameters.settings(inputs.pattern)
    # The grid has one particle per cell, so the area alone tells a scene that is far too large before it is built.
    limits.check_particles(round(inputs.pattern.area / settings.spacing**2))
    body = None if inputs.body is None else inputs.body.body
    return Scene.build(
        inputs.pattern,
        body,
        Fabric.preset(parameters.fabric),
        settings=settings,
        gravity=parameters.gravity,
        air_drag=parameters.air_drag,
        without=parameters.without,
    )
