"""Values of a worker that act at once."""

from dataclasses import dataclass, field

from cloth_sim_ros.scene_inputs import Limits

__all__ = ["WorkerSettings"]


@dataclass(frozen=True)
class WorkerSettings:
    """Values that act at once."""

    publish_rate: float = 30.0
    """Frames per second of wall-clock time while the garment moves [Hz]."""
    auto_start: bool = False
    """Start a new garment by itself."""
    paused: bool = False
    """Hold the garment still, whatever was asked for."""
    real_time_factor: float = 0.0
    """Most simulated per wall-clock time; 0 is as fast as possible."""
    step_duration: float = 0.0
    """Simulated time of a step [s]; 0 is 1 / publish_rate."""
    publish_clock: bool = False
    """Send the time of the run."""
    grasp_radius: float = 0.03
    """A gripper takes the particles that are not farther from it [m]."""
    grasp_speed: float = 1.0
    """No held particle is moved faster [m/s]."""
    body_move_duration: float = 0.1
    """Simulated time in which a body that comes again gets to its new place [s]; 0 lets the garment start again."""
    body_speed: float = 2.0
    """No vertex of the body is moved faster [m/s]."""
    record_directory: str = "cloth_sim_records"
    limits: Limits = field(default_factory=Limits)

    @property
    def step(self) -> float:
        """Simulated time of one step [s]."""
        return self.step_duration or 1.0 / self.publish_rate
