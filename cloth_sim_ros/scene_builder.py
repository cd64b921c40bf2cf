"""Turns patterns and bodies into runs, in a thread of its own: meshing a garment takes seconds."""

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

from cloth_core.errors import ClothError
from cloth_core.report import Report
from cloth_core.scene import Scene
from cloth_sim_ros.free_memory import give_back_free_memory
from cloth_sim_ros.scene_inputs import Limits, ReceivedBody, SceneInputs, SceneParameters, build_scene
from cloth_sim_ros.scheduled_simulation import ScheduledSimulation

__all__ = ["Change", "Run", "SceneBuilder"]

Change = Callable[[SceneInputs], SceneInputs]
"""Puts a new pattern or body into the inputs; raises ClothError if it cannot be used."""


@dataclass(eq=False)
class Run:
    """A built scene and its simulation."""

    inputs: SceneInputs
    scene: Scene
    simulation: ScheduledSimulation
    description: dict[str, Any]
    """`Simulation.describe` at the start, which other threads can read while it runs."""
    report: Report | None = None
    """Once it is at rest."""


class SceneBuilder:
    """Builds what is asked for, the latest of each kind. What cannot be built is refused, and all else stays as it was.

    Args:
        parameters: of the first scene; `parameters` may be set at any time for the next one
        limits: of a scene; likewise
        accepted: called from the builder's thread with the inputs that hold from now on, and with the run, if there is
            a pattern
        refused: called from the builder's thread with one line
    """

    def __init__(
        self,
        parameters: SceneParameters,
        limits: Limits,
        accepted: Callable[[SceneInputs, Run | None], None],
        refused: Callable[[str], None],
    ) -> None:
        self.parameters = parameters
        self.limits = limits
        self._accepted = accepted
        self._refused = refused
        self._wake = threading.Condition()
        self._closing = False
        self._changes: dict[str, Change] = {}
        self._rebuild = False
        self._busy = False
        self._busy_with_garment = False
        self._inputs = SceneInputs(parameters=parameters)
        self._present: Run | None = None
        self._thread = threading.Thread(target=self._loop, name="cloth_sim builder", daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a garment is being built or waits to be."""
        with self._wake:
            return self._busy_with_garment or self._rebuild or "pattern" in self._changes

    def request(self, kind: str, change: Change) -> None:
        """Asks for a change; one of the same kind that still waits is dropped."""
        with self._wake:
            self._changes[kind] = change
            self._wake.notify()

    def body_has_moved(self, find: Callable[[ReceivedBody], ReceivedBody | None]) -> ReceivedBody | None:
        """Replaces the body of the present run by what `find` makes of it, without another run.

        None, and nothing done, if `find` says so, there is no body, or another scene is being built or waits to be.
        """
        with self._wake:
            before, present = self._inputs.body, self._present
            if before is None or present is None or self._busy or self._changes or self._rebuild:
                return None
            moved = find(before)
            if moved is not None:
                self._inputs = replace(self._inputs, body=moved)
            return moved

    def rebuild(self) -> None:
        """Asks for the present garment at its start, with the parameters as they are then."""
        with self._wake:
            self._rebuild = True
            self._wake.notify()

    def close(self, timeout: float) -> None:
        """Ends the thread; a scene being built is waited for no longer than `timeout` [s]."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout)

    def _loop(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._changes or self._rebuild)
                if self._closing:
                    return
                changes, self._changes = self._changes, {}
                self._rebuild = False
                self._busy = True
                self._busy_with_garment = self._inputs.pattern is not None or "pattern" in changes
            refusals = self._accept(list(changes.items()))
            with self._wake:
                self._busy = self._busy_with_garment = False
            for line in refusals:
                self._refused(line)
            give_back_free_memory()

    def _accept(self, changes: list[tuple[str, Change]]) -> list[str]:
        """Takes all changes together, so that a pattern and a body that arrive together cost one scene; if that fails,
        one after the other. Returns why some were not taken.
        """
        inputs = replace(self._inputs, parameters=self.parameters)
        try:
            inputs = reduce(lambda so_far, change: change[1](so_far), changes, inputs)
            run = self._build(inputs)
        except Exception as error:  # whatever a message brought about, the next one is served
            if len(changes) > 1:
                return [line for change in changes for line in self._accept([change])]
            return [_line(error, changes[0][0] if changes else "reset")]
        self._inputs, self._present = inputs, run
        self._accepted(inputs, run)
        return []

    def _build(self, inputs: SceneInputs) -> Run | None:
        if inputs.pattern is None:
            return None
        last = self._present
        if last is not None and inputs.same_scene(last.inputs):
            scene = last.scene
        else:
            scene = build_scene(inputs, self.limits)
        self.limits.check_particles(scene.garment.particle_count)
        simulation = ScheduledSimulation(scene)
        return Run(inputs, scene, simulation, simulation.describe())


def _line(error: Exception, what: str) -> str:
    if isinstance(error, ClothError):
        return f"{what} refused: {error}"
    where = traceback.extract_tb(error.__traceback__)[-1].name
    text = " ".join(str(error).split())
    return f"{what} refused: {type(error).__name__} in {where}: {text}; please report it with what you sent"
