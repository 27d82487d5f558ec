# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Run the estimator over whole logs in the order of their stamps, many times with different parameters.

No measurement is late here, so every state is settled: each run ends with the same states as the estimator
on the same measurements. Blocks bound the memory. Compiled code holds no lock, so threads share the cores.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.errors import InputError
from trackslip_estimation.slip.config import ConfigRecord
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.process import process
from trackslip_estimation.slip.records import EVENT, HISTORY, MEASUREMENT, RESULT, SPROCKETS
from trackslip_estimation.slip.window import (
    SPARE,
    Records,
    Window,
    copy_first_entry,
    enlarged_copy,
    make_like,
    remove_unneeded_entries,
)

_BLOCK = 512  # entries: fewer cost more copies between blocks, more exceed the processor's cache
_NO_ARRIVALS, _NO_RESULTS = np.empty(0, MEASUREMENT), np.empty(0, RESULT)
_USED_OUTCOMES = (Outcome.ACCEPTED, Outcome.GATED, Outcome.JUMPED, Outcome.BEGUN)


class Log(NamedTuple):
    """Measurements of a log that an estimator uses, as records of ``MEASUREMENT`` in the order of stamps."""

    begin: Records  # (b,) up to and including the start of the estimate
    rest: Records  # (k,) after the start


class Block(NamedTuple):
    """A block of a run; the entries before ``begin`` belong to the previous block."""

    first: int  # index in ``Log.rest`` of its first entry
    begin: int  # its first entry in the window
    window: Window  # reused by the next block

    @property
    def measurements(self) -> Records:
        """(m,) measurements of the block."""
        return self.window.measurements[self.begin : self.window.count]

    @property
    def states(self) -> Records:
        """(m,) states after the measurements, of the most probable branch."""
        return self.window.best[self.begin : self.window.count]

    @property
    def updates(self) -> Records:
        """(m,) results of the steps, of ``UPDATE``."""
        return self.window.updates[self.begin : self.window.count]

    @property
    def priors(self) -> Records:
        """(m,) states before the updates, of ``PRIOR``, of a run with a script; else empty."""
        return self.window.priors[self.begin : self.window.count]


def make_log(arrivals: Records, p: SlipEstimatorParameters) -> Log:
    """Select from (n,) records of ``MEASUREMENT`` those that the estimator uses, each once.

    Raises:
        InputError: no measurement starts the estimate.
    """
    order = stamp_order(arrivals)
    arrivals = arrivals if (np.diff(order) == 1).all() else arrivals[order]
    estimator = SlipEstimator(p)
    outcomes = np.empty(len(arrivals), np.int64)
    for first in range(0, len(arrivals), _BLOCK):
        part = slice(first, first + _BLOCK)
        outcomes[part] = estimator.process_records(arrivals[part])["outcome"]
    begins = np.flatnonzero(outcomes == Outcome.ACCEPTED)
    if not begins.size:
        raise InputError(f"measurements: none of {len(arrivals)} to start from (start: {p.start})")
    used = np.isin(outcomes, _USED_OUTCOMES)
    used[: begins[0]] = (outcomes[: begins[0]] == Outcome.WAITING) & (
        arrivals["kind"][: begins[0]] == SPROCKETS
    )
    head = begins[0] + 1
    rest = arrivals[head:]  # up to hundreds of MB: no copy if all are used
    return Log(arrivals[:head][used[:head]], rest if used[head:].all() else rest[used[head:]])


def stamp_order(measurements: Records) -> NDArray[np.int64]:
    """(n,) indices that sort (n,) records of ``MEASUREMENT`` by stamp, kind and source."""
    keys = measurements["source"], measurements["kind"], measurements["stamp_ns"]
    return np.lexsort(keys).astype(np.int64, copy=False)


def run_log(log: Log, p: SlipEstimatorParameters, script: Records | None = None) -> Iterator[Block]:
    """Run an estimator over a log, block by block; each block ends at a sprocket sample.

    The parameters may differ from those of ``make_log``, except in which measurements they use.
    ``script``: (n,) of ``EVENT``, the only events of the run.
    """
    start, config = start_of_log(log, p, script)
    return run_blocks(log.rest, start, config)


def start_of_log(
    log: Log, p: SlipEstimatorParameters, script: Records | None = None
) -> tuple[Window, ConfigRecord]:
    """Window at the start of a log, and its (1,) of ``CONFIG``; ``script`` as in ``run_log``."""
    estimator = SlipEstimator(p, script=script)
    estimator.process_records(log.begin)
    return estimator.window, estimator.config


def run_blocks(rest: Records, start: Window, config: ConfigRecord) -> Iterator[Block]:
    """Run over measurements in the order of their stamps, from the first entry of ``start``."""
    window = _window_from_start(start, 3 * _BLOCK)  # including older entries that snapshots refer to
    first = 0
    while first < len(rest):
        last = _end_of_block(rest, first)
        begin, count = window.count, window.count + last - first
        while len(window.measurements) < count + SPARE:
            window = enlarged_copy(window)
        _add_measurements(window, rest[first:last], config)
        yield Block(first, begin, window)
        remove_unneeded_entries(window)
        first = last


def run_in_one_block(rest: Records, start: Window, config: ConfigRecord) -> Window:
    """Run over measurements in one block, for short logs: the window holds all states."""
    window = _window_from_start(start, len(rest))
    _add_measurements(window, rest, config)
    return window


def best_branch_script(log: Log, p: SlipEstimatorParameters) -> Records:
    """(n,) of ``EVENT``: events of the branch that is most probable at the end of a log.

    A run with this script has the states of that branch.
    """
    events: list[Any] = []
    for block in run_log(log, p):
        branch = block.window.branches[0, block.window.count - 1]
        count = int(branch["events"])
        del events[count:]
        for n in range(max(count - HISTORY, 0), count):
            event = branch["history"][n % HISTORY].copy()
            if n < len(events) and events[n] == event:
                continue
            del events[n:]
            events.append(event)
    script = np.zeros(len(events), EVENT)
    for n, event in enumerate(events):
        script[n] = event
    keys = [script[name] for name in ("after", "step_source", "step_kind", "stamp_ns")]
    return script[np.lexsort(keys)]


def _window_from_start(start: Window, entries: int) -> Window:
    """Make a window of the first entry of ``start``, with room for ``entries`` more."""
    window = make_like(start, entries + 1 + SPARE)
    window.status["played"] = window.status["begun"] = start.status["played"]
    copy_first_entry(window, start)
    window.status["started"], window.status["count"], window.status["known"] = True, 1, 1
    return window


def _add_measurements(window: Window, measurements: Records, config: ConfigRecord) -> None:
    """Add (m,) measurements to a window, and compute their states.

    Raises:
        InputError: the estimate diverges.
    """
    known = window.count
    count = known + len(measurements)
    window.measurements[known:count] = measurements
    window.status["count"], window.status["known"] = count, known
    divergences = int(window.status["divergences"][0])
    process(window, _NO_ARRIVALS, _NO_RESULTS, config)
    if window.status["divergences"][0] > divergences:
        raise InputError(
            f"measurements: the estimate diverges between {measurements['stamp_ns'][0]} and "
            f"{measurements['stamp_ns'][-1]} ns; leave out the source that it follows there"
        )


def _end_of_block(rest: Records, first: int) -> int:
    """End of the block from ``first``: after a sprocket sample, which closes the last interval."""
    last = min(first + _BLOCK, len(rest))
    samples = np.flatnonzero(rest["kind"][first:last] == SPROCKETS)
    return first + int(samples[-1]) + 1 if samples.size and last < len(rest) else last
