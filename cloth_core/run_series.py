"""Many measured runs in processes of their own, one for each core; what is finished already is not run again."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path

from cloth_core.errors import ClothError, SimulationError
from cloth_core.measured_run import MeasuredRun, RunRequest, measure, stored_run

__all__ = ["run_series"]

OnDone = Callable[[float, float, int, int], None]

# One thread each: several processes that all use every core would measure each other.
_ONE_THREAD = {
    name: "1" for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
}
_POLL = 0.5  # s


def run_series(
    requests: Sequence[RunRequest],
    folder: Path,
    *,
    processes: int | None = None,
    on_progress: OnDone | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> list[MeasuredRun]:
    """Measure all requests; each result is a file in the folder, so that a series that was stopped goes on later.

    Args:
        requests: in any order; the longest are started first.
        folder: made if need be.
        processes: at once; one for each core if None.
        on_progress: called with the work done and the whole work (in the same unit), and the runs done and all runs.
        should_stop: asked twice a second; True ends the series.

    Returns:
        results in the order of the requests.

    Raises:
        SimulationError: stopped, or a process died.
        ClothError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ClothError(f"'{folder}': {error.strerror}; choose another directory for the results") from None
    wanted = {request.key(): request for request in requests}
    finished = {key: run for key, request in wanted.items() if (run := stored_run(request, folder)) is not None}
    whole = sum(request.expected_work for request in wanted.values())

    def tell() -> None:
        if on_progress is not None:
            done = sum(wanted[key].expected_work for key in finished)
            on_progress(done, whole, len(finished), len(wanted))

    tell()
    missing = sorted((key for key in wanted if key not in finished), key=lambda key: -wanted[key].expected_work)
    if missing:
        with _workers(min(processes or os.cpu_count() or 1, len(missing))) as pool:
            waiting: dict[Future[MeasuredRun], str] = {
                pool.submit(measure, wanted[key], folder): key for key in missing
            }
            while waiting:
                done, _ = wait(waiting, timeout=_POLL, return_when=FIRST_COMPLETED)
                for future in done:
                    key = waiting.pop(future)
                    try:
                        finished[key] = future.result()
                    except BrokenProcessPool:
                        raise SimulationError(
                            f"{wanted[key].recipe.name}, spacing {1000 * wanted[key].settings.spacing:g} mm: a process "
                            "of the series died, probably for want of memory; run it again with fewer processes"
                        ) from None
                    except OSError as error:
                        raise ClothError(
                            f"'{folder}': {error.strerror or error}; make room or choose another"
                        ) from None
                    tell()
                if should_stop is not None and should_stop():
                    raise SimulationError(
                        f"stopped with {len(finished)} of {len(wanted)} runs done; the same command goes on from there"
                    )
    return [finished[request.key()] for request in requests]


@contextmanager
def _workers(count: int) -> Iterator[ProcessPoolExecutor]:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    others = set(multiprocessing.active_children())
    os.environ.update(_ONE_THREAD)
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_leave_to_parent)
    try:
        yield pool
    except BaseException:
        # Results are files that appear whole; a run that is broken off leaves none.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _leave_to_parent() -> None:
    """Ctrl-C reaches every process of a terminal; the parent decides what it means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
