"""The services of `simulation_interfaces`, by which tools drive simulators of any kind.

That package comes with ROS 2 (apt), not from PyPI: the services are there where it can be imported. What the answers
mean is here and knows no ROS graph; the message classes are handed in.
"""

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Protocol

from cloth_core.errors import ClothError

__all__ = ["SERVICES", "SimulationServices", "Worker", "import_types"]

SERVICES = ("GetSimulatorFeatures", "GetSimulationState", "SetSimulationState", "ResetSimulation", "StepSimulation")
MESSAGES = ("Result", "SimulationState", "SimulatorFeatures")

FEATURES = (
    "SIMULATION_RESET",
    "SIMULATION_STATE_GETTING",
    "SIMULATION_STATE_SETTING",
    "SIMULATION_STATE_PAUSE",
    "STEP_SIMULATION_SINGLE",
    "STEP_SIMULATION_MULTIPLE",
)
"""What is offered. Nothing can be spawned or deleted, and time is not reset without the garment."""
INFORMATION = (
    "cloth_sim_ros: one garment on one body. A reset puts both time and garment back; stamps go on, so that time never "
    "runs backwards for those who listen. ~/describe tells scene, state and parameters as JSON."
)


class Worker(Protocol):
    """What of a `SimulationWorker` is driven."""

    def start(self) -> str:
        """Lets it move."""

    def pause(self) -> str:
        """Halts it."""

    def reset(self) -> str:
        """Puts it back."""

    def step(self, count: int = 1) -> str:
        """Moves it by steps."""

    def describe(self) -> dict[str, Any]:
        """State and progress."""


def import_types() -> SimpleNamespace | None:
    """The classes of all services and messages above; None if the package is not there or lacks one of them."""
    try:
        services, messages = (importlib.import_module(f"simulation_interfaces.{part}") for part in ("srv", "msg"))
        found = {name: getattr(services, name) for name in SERVICES} | {
            name: getattr(messages, name) for name in MESSAGES
        }
    except (ImportError, AttributeError):
        return None
    return SimpleNamespace(**found)


class SimulationServices:
    """Answers requests, each method one service.

    Args:
        worker: that is driven
        types: classes of services and messages
        quit: ends the node soon, after the answer has been sent
    """

    def __init__(self, worker: Worker, types: Any, quit: Callable[[], None]) -> None:
        self._worker = worker
        self._types = types
        self._quit = quit
        self._begun = False
        """Whether a garment that has not moved yet has been asked to wait in a paused state."""

    def get_simulator_features(self, request: Any, response: Any) -> Any:
        """What this simulator can do; features that the installed version does not know are left out."""
        known = self._types.SimulatorFeatures
        response.features.features = [getattr(known, name) for name in FEATURES if hasattr(known, name)]
        response.features.custom_info = INFORMATION
        return response

    def get_simulation_state(self, request: Any, response: Any) -> Any:
        """Playing while it moves, stopped at the start, else paused."""
        response.state.state = self.state()
        response.result.result = self._types.Result.OK
        return response

    def set_simulation_state(self, request: Any, response: Any) -> Any:
        """Plays, pauses, stops (which resets) or quits."""
        states, codes = self._types.SimulationState, self._types.SetSimulationState.Response
        wanted, result = request.state.state, response.result
        if wanted == self.state():
            result.result, result.error_message = codes.ALREADY_IN_TARGET_STATE, "it is in that state already"
            return response
        commands: dict[int, Callable[[], str]] = {
            states.PLAYING: self._worker.start,
            states.PAUSED: self._worker.pause,
            states.STOPPED: self._worker.reset,
            states.QUITTING: self._end,
        }
        if wanted not in commands:
            result.result = self._types.Result.FEATURE_UNSUPPORTED
            result.error_message = f"there is no state {wanted}"
            return response
        self._run(commands[wanted], result, codes.STATE_TRANSITION_ERROR)
        if result.result == self._types.Result.OK:
            self._begun = wanted == states.PAUSED
        return response

    def reset_simulation(self, request: Any, response: Any) -> Any:
        """Puts time and garment back together, paused; one of them alone cannot be."""
        kinds = self._types.ResetSimulation.Request
        both = kinds.SCOPE_TIME | kinds.SCOPE_STATE
        if request.scope != kinds.SCOPE_DEFAULT and request.scope & both != both:
            response.result.result = self._types.Result.FEATURE_UNSUPPORTED
            response.result.error_message = "time and state are only reset together; use SCOPE_ALL"
            return response
        self._begun = False
        self._run(self._worker.reset, response.result, self._types.Result.OPERATION_FAILED)
        return response

    def begin_steps(self, request: Any, response: Any) -> bool:
        """Starts the steps of `StepSimulation`; true if there is something to wait for until the answer is sent."""
        codes = self._types.Result
        if self.state() == self._types.SimulationState.PLAYING:
            response.result.result = codes.INCORRECT_STATE
            response.result.error_message = "the simulation is not paused; pause it first"
        elif request.steps < 1:
            response.result.result = codes.OPERATION_FAILED
            response.result.error_message = f"{request.steps} steps are none; ask for at least one"
        else:
            self._begun = True
            self._run(lambda: self._worker.step(request.steps), response.result, codes.OPERATION_FAILED)
            return bool(response.result.result == codes.OK)
        return False

    def steps_are_done(self) -> bool:
        """Whether what `begin_steps` started is over."""
        return bool(self.state() != self._types.SimulationState.PLAYING)

    def state(self) -> int:
        """One of the constants of `SimulationState`."""
        states = self._types.SimulationState
        found = self._worker.describe()
        if found["state"] in ("running", "draping", "stepping"):
            return int(states.PLAYING)
        progress = found["progress"]
        moved = progress is not None and progress["simulated_time"] > 0.0
        return int(states.PAUSED if moved or self._begun else states.STOPPED)

    def _end(self) -> str:
        self._worker.pause()
        self._quit()
        return "quitting"

    def _run(self, command: Callable[[], str], result: Any, failure: int) -> None:
        try:
            command()
        except ClothError as error:
            result.result, result.error_message = failure, str(error)
        else:
            result.result = self._types.Result.OK
