"""The state of a run as one line of `/diagnostics`."""

from collections.abc import Mapping

from cloth_core.simulation import Progress
from cloth_sim_ros.messages import Level, Status

__all__ = ["run_status"]


def run_status(
    node_name: str, level: Level, message: str, progress: Progress | None, details: Mapping[str, object] | None = None
) -> Status:
    """Status of a simulator; `progress` and `details` become its values, numbers rounded to four figures."""
    values: dict[str, object] = {}
    if progress is not None:
        values = {
            "phase": progress.phase,
            "simulated time [s]": progress.simulated_time,
            "speed [simulated s per s]": progress.speed,
            "largest particle speed [m/s]": progress.largest_speed,
            "expected rest at [s]": progress.estimated_rest_time,
        }
    values |= details or {}
    return Status(
        level=level,
        name=f"{node_name.lstrip('/')}: simulation",
        message=message,
        hardware_id="",
        values=tuple((key, _text(value)) for key, value in values.items()),
    )


def _text(value: object) -> str:
    if value is None:
        return "unknown"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
