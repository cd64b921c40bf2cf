"""The adapter to `simulation_interfaces`, alone: that package is not on PyPI.

Its constants are written down here from its definitions (version 1); the classes are plain ones with the same fields.
"""

from types import SimpleNamespace

import pytest

from cloth_core.errors import SceneError
from cloth_sim_ros.simulation_services import SERVICES, SimulationServices, import_types


class State(SimpleNamespace):
    STOPPED, PLAYING, PAUSED, QUITTING = range(4)


class Result(SimpleNamespace):
    FEATURE_UNSUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, OPERATION_FAILED = range(5)


class Features(SimpleNamespace):
    SPAWNING = 0
    SIMULATION_RESET = 20
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    # STEP_SIMULATION_MULTIPLE is missing, as it might in another version.


TYPES = SimpleNamespace(
    SimulationState=State,
    Result=Result,
    SimulatorFeatures=Features,
    SetSimulationState=SimpleNamespace(
        Response=SimpleNamespace(ALREADY_IN_TARGET_STATE=101, STATE_TRANSITION_ERROR=102, INCORRECT_TRANSITION=103)
    ),
    ResetSimulation=SimpleNamespace(
        Request=SimpleNamespace(SCOPE_DEFAULT=0, SCOPE_TIME=1, SCOPE_STATE=2, SCOPE_SPAWNED=4, SCOPE_ALL=255)
    ),
)


class Worker:
    """Keeps what it was asked for."""

    def __init__(self):
        self.calls, self.time, self.mode, self.error = [], 0.0, "paused", None

    def _do(self, call, mode, time=None):
        if self.error:
            raise SceneError(self.error)
        self.calls.append(call)
        self.mode = mode
        self.time = self.time if time is None else time
        return "done"

    def start(self):
        return self._do("start", "running", 0.5)

    def pause(self):
        return self._do("pause", "paused")

    def reset(self):
        return self._do("reset", "paused", 0.0)

    def step(self, count=1):
        return self._do(f"step {count}", "stepping", self.time + count)

    def describe(self):
        return {"state": self.mode, "progress": {"simulated_time": self.time}}


@pytest.fixture
def worker():
    return Worker()


@pytest.fixture
def services(worker):
    return SimulationServices(worker, TYPES, lambda: worker.calls.append("quit"))


def response():
    return SimpleNamespace(result=Result(result=None, error_message=""), state=State(state=None), features=Features())


def set_state(services, state):
    return services.set_simulation_state(SimpleNamespace(state=State(state=state)), response()).result


def state_of(services):
    return services.get_simulation_state(None, response()).state.state


def test_the_package_is_not_there():
    assert import_types() is None
    assert len(SERVICES) == 5


def test_only_what_there_is_is_advertised(services):
    features = services.get_simulator_features(None, response()).features
    assert features.features == [20, 24, 25, 26, 31]
    assert "never runs backwards" in features.custom_info


def test_states_and_their_transitions(services, worker):
    assert state_of(services) == State.STOPPED
    assert set_state(services, State.STOPPED).result == 101
    assert set_state(services, State.PAUSED).result == Result.OK
    assert state_of(services) == State.PAUSED
    assert set_state(services, State.PLAYING).result == Result.OK
    assert state_of(services) == State.PLAYING
    assert set_state(services, State.PLAYING).result == 101
    assert set_state(services, State.PAUSED).result == Result.OK
    assert state_of(services) == State.PAUSED
    assert set_state(services, State.STOPPED).result == Result.OK
    assert state_of(services) == State.STOPPED
    assert worker.calls == ["pause", "start", "pause", "reset"]
    assert set_state(services, State.QUITTING).result == Result.OK
    assert worker.calls[-2:] == ["pause", "quit"]
    assert set_state(services, 9).result == Result.FEATURE_UNSUPPORTED


def test_what_the_simulator_refuses_is_told(services, worker):
    worker.error = "start: there is no garment; publish a pattern first"
    result = set_state(services, State.PLAYING)
    assert (result.result, result.error_message) == (102, worker.error)
    answer = services.reset_simulation(SimpleNamespace(scope=0), response())
    assert answer.result.result == Result.OPERATION_FAILED
    answer = response()
    assert not services.begin_steps(SimpleNamespace(steps=1), answer)
    assert answer.result.error_message == worker.error


@pytest.mark.parametrize(("scope", "code"), [(0, 1), (255, 1), (3, 1), (1, 0), (2, 0), (4, 0)])
def test_time_and_garment_are_reset_together(services, worker, scope, code):
    answer = services.reset_simulation(SimpleNamespace(scope=scope), response())
    assert answer.result.result == code
    assert worker.calls == ["reset"] * code


def test_steps_are_waited_for_and_need_a_pause(services, worker):
    answer = response()
    assert services.begin_steps(SimpleNamespace(steps=3), answer)
    assert worker.calls == ["step 3"]
    assert not services.steps_are_done()
    worker.mode = "paused"
    assert services.steps_are_done()
    set_state(services, State.PLAYING)
    answer = response()
    assert not services.begin_steps(SimpleNamespace(steps=1), answer)
    assert answer.result.result == Result.INCORRECT_STATE
    worker.mode = "paused"
    assert not services.begin_steps(SimpleNamespace(steps=0), answer)
    assert answer.result.result == Result.OPERATION_FAILED
