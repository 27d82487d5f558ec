# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs many pieces of work in this process, in other processes, or on the workers of a Dask scheduler.

A piece is a function of data shared by all pieces and of an item of its own. The function belongs to a
module, so that another process can import it. Shared data goes to each process once. The results come in the
order of the items. They are therefore the same for any number of workers.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing import resource_tracker
from signal import SIG_BLOCK, SIG_SETMASK, SIGINT, pthread_sigmask, signal
from threading import current_thread, main_thread
from typing import Any, Protocol, TypeVar

from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.soil.records import Hydraulics
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

Item = TypeVar("Item")
Result = TypeVar("Result")

_SCHEDULER_TIMEOUT_S = 10.0  # timeout for a scheduler, s
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

_shared: Any = None  # shared data, in a process of a pool


class Map(Protocol):
    """``map`` over some workers."""

    def __call__(self, function: Callable[[Any, Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield ``function(shared, item)`` of each item, in order; an exception is raised at its item."""


def core_count() -> int:
    """Number of CPU cores available to this process."""
    return len(os.sched_getaffinity(0))


def open_workers(count: int, scheduler: str | None = None, shared: Any = None) -> AbstractContextManager[Map]:
    """Context of a ``Map`` over ``count`` processes (1: this one), or over a Dask scheduler's workers.

    Raises:
        InputError: no scheduler answers, it has no workers, or a worker ended.
    """
    if scheduler is not None:
        return _dask_cluster(scheduler, shared)
    if count > 1:
        return _process_pool(count, shared)
    return nullcontext(lambda function, items: (function(shared, item) for item in items))


@contextmanager
def _process_pool(count: int, shared: Any) -> Iterator[Map]:
    """Processes with one thread each; this process compiles the kernels while the others import modules."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        count, multiprocessing.get_context("spawn"), initializer=_initialise_process, initargs=(shared,)
    )

    def map_items(function: Callable[[Any, Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        try:
            with _process_environment():  # for processes that start later
                futures = [pool.submit(_call_function, function, item) for item in items]
            yield from _results(futures)
        except BrokenProcessPool as error:
            raise InputError(
                f"--workers {count}: a process was ended (out of memory?); accepted: fewer"
            ) from error

    try:
        with _process_environment():
            for _ in range(count):
                pool.submit(os.getpid)  # starts a process
        _compile_kernels()
        yield map_items
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _compile_kernels() -> None:
    """Compile both estimators by a step of each, so that workers find them compiled; fast if they are."""
    estimator = SlipEstimator(load_slip_parameters({"start": "initial_pose"}))
    samples = [Sprockets("sprockets", k * 10_000_000, 1.0, 1.0, (0.01 * k, 0.01 * k)) for k in range(3)]
    estimator.process_records(to_records(samples, estimator.sources))
    SoilEstimator(load_soil_parameters()).advance(Hydraulics(0, 0.0, 0.0, 0.0, 0.0))


def _initialise_process(shared: Any) -> None:
    """Initialise a new process of the pool."""
    global _shared  # a pool offers no other way to pass data
    _shared = shared


def _call_function(function: Callable[[Any, Item], Result], item: Item) -> Result:
    return function(_shared, item)


def _results(futures: list["Future[Result]"]) -> Iterator[Result]:
    """Yield the results; each future is dropped at once."""
    futures.reverse()
    while futures:
        yield futures.pop().result()


@contextmanager
def _process_environment() -> Iterator[None]:
    """Processes started within this context have one thread and ignore Ctrl-C: this process ends them.

    A Ctrl-C takes effect at the end of the context, even if another thread receives it. A half-started
    process would print a traceback.
    """
    resource_tracker.ensure_running()  # starting it later would unblock the signal
    pressed: list[int] = []
    handler = None
    if current_thread() is main_thread():
        handler = signal(SIGINT, lambda number, _: pressed.append(number))
    mask = pthread_sigmask(SIG_BLOCK, {SIGINT})
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if handler is not None:
            signal(SIGINT, handler)
        pthread_sigmask(SIG_SETMASK, mask)
    if pressed:
        raise KeyboardInterrupt


@contextmanager
def _dask_cluster(address: str, shared: Any) -> Iterator[Map]:
    """Context of a ``Map`` over a scheduler's workers.

    The workers need our packages installed. Whoever reaches the scheduler can run code on them.
    """
    from distributed import Client, KilledWorker  # takes a second

    try:
        client = Client(address, timeout=_SCHEDULER_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers; accepted: tcp://host:port"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_SCHEDULER_TIMEOUT_S)
            sent = client.scatter([shared], broadcast=True)[0]
        except TimeoutError as error:
            raise InputError(f"--scheduler {address}: it has no workers; accepted: one at least") from error

        def map_items(function: Callable[[Any, Item], Result], items: Iterable[Item]) -> Iterator[Result]:
            futures = [client.submit(function, sent, item, pure=False) for item in items]
            try:
                yield from _results(futures)
            except ModuleNotFoundError as error:
                raise InputError(f"--scheduler {address}: its workers lack {error.name}") from error
            except (KilledWorker, CancelledError) as error:  # during the work, or while shared data was sent
                raise InputError(
                    f"--scheduler {address}: it or its workers ended (out of memory?)"
                ) from error

        yield map_items
