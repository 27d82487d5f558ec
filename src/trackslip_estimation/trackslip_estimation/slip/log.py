# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Whole logs in the order of their stamps: what is worked out once, for many runs with other parameters.

Nothing comes late here, so every state is settled: each run gives what the estimator ends with on the same
measurements. Blocks keep it in bounded memory; machine code holds no lock, so threads share the cores.
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
    copy_first,
    enlarged,
    keep_tail,
    make_like,
)

_BLOCK = 512  # entries: fewer are carried over too often, more do not stay near the processor
_NO_ARRIVALS, _NO_RESULTS = np.empty(0, MEASUREMENT), np.empty(0, RESULT)
_USED = (Outcome.ACCEPTED, Outcome.GATED, Outcome.JUMPED, Outcome.BEGUN)


class Log(NamedTuple):
    """What an estimator takes of a log, as records of ``MEASUREMENT`` in the order of their stamps."""

    begin: Records  # (b,) up to the one that the estimate starts from, with it
    rest: Records  # (k,) after it


class Block(NamedTuple):
    """A stretch of a run; the entries before ``begin`` are carried over from the block before."""

    first: int  # number in ``Log.rest`` of its first entry
    begin: int  # its first entry in the window
    window: Window  # is used again for the next block

    @property
    def measurements(self) -> Records:
        """(m,) those of the block."""
        return self.window.measurements[self.begin : self.window.count]

    @property
    def states(self) -> Records:
        """(m,) the states after them, of the most probable branch."""
        return self.window.best[self.begin : self.window.count]

    @property
    def updates(self) -> Records:
        """(m,) what became of them."""
        return self.window.updates[self.begin : self.window.count]

    @property
    def priors(self) -> Records:
        """(m,) what was known before each, of a run with a script; else ()."""
        return self.window.priors[self.begin : self.window.count]


def make_log(arrivals: Records, p: SlipEstimatorParameters) -> Log:
    """What the estimator uses of (n,) records of ``MEASUREMENT``, each once.

    Raises:
        InputError: there is none to start from.
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
    used = np.isin(outcomes, _USED)
    used[: begins[0]] = (outcomes[: begins[0]] == Outcome.WAITING) & (
        arrivals["kind"][: begins[0]] == SPROCKETS
    )
    head = begins[0] + 1
    rest = arrivals[head:]  # of a long bag they are hundreds of MB: no copy where all are used
    return Log(arrivals[:head][used[:head]], rest if used[head:].all() else rest[used[head:]])


def stamp_order(measurements: Records) -> NDArray[np.int64]:
    """(n,) places in which (n,) records of ``MEASUREMENT`` stand by stamp, kind and source."""
    keys = measurements["source"], measurements["kind"], measurements["stamp_ns"]
    return np.lexsort(keys).astype(np.int64, copy=False)


def run_log(log: Log, p: SlipEstimatorParameters, script: Records | None = None) -> Iterator[Block]:
    """The estimator that the parameters choose over a log, block by block; each ends at a sprocket sample.

    From those that the log was made with they may differ in all but what is a measurement at all.
    ``script``: (n,) of ``EVENT``, the only events of the run.
    """
    start, config = begin_log(log, p, script)
    return run_blocks(log.rest, start, config)


def begin_log(
    log: Log, p: SlipEstimatorParameters, script: Records | None = None
) -> tuple[Window, ConfigRecord]:
    """The window at the start of a log, and the record of the parameters; ``script`` as in ``run_log``."""
    estimator = SlipEstimator(p, script=script)
    estimator.process_records(log.begin)
    return estimator.window, estimator.config


def run_blocks(rest: Records, start: Window, config: ConfigRecord) -> Iterator[Block]:
    """Runs over measurements in the order of their stamps, from the first entry of ``start``."""
    window = _begin(start, 3 * _BLOCK)  # with those that later ones look back to
    first = 0
    while first < len(rest):
        last = _end_of_block(rest, first)
        begin, count = window.count, window.count + last - first
        while len(window.measurements) < count + SPARE:
            window = enlarged(window)
        _extend(window, rest[first:last], config)
        yield Block(first, begin, window)
        keep_tail(window)
        first = last


def run_whole(rest: Records, start: Window, config: ConfigRecord) -> Window:
    """``run_blocks`` in one block: all states at once, for logs that are short."""
    window = _begin(start, len(rest))
    _extend(window, rest, config)
    return window


def script_of(log: Log, p: SlipEstimatorParameters) -> Records:
    """(n,) of ``EVENT``: what the bank finds that happened in a log, by its most probable branch at the end.

    A run with this script has the states of that branch.
    """
    found: list[Any] = []
    for block in run_log(log, p):
        branch = block.window.branches[0, block.window.count - 1]
        count = int(branch["events"])
        del found[count:]
        for n in range(max(count - HISTORY, 0), count):
            event = branch["history"][n % HISTORY].copy()
            if n < len(found) and found[n] == event:
                continue
            del found[n:]
            found.append(event)
    script = np.zeros(len(found), EVENT)
    for n, event in enumerate(found):
        script[n] = event
    order = script["stamp_ns"], script["kind"], script["of"], script["after"]
    return script[np.lexsort(order[::-1])]


def _begin(start: Window, entries: int) -> Window:
    """A window with room for so many entries after the first one of ``start``."""
    window = make_like(start, entries + 1 + SPARE)
    window.status["played"] = window.status["begun"] = start.status["played"]
    copy_first(window, start)
    window.status["started"], window.status["count"], window.status["known"] = True, 1, 1
    return window


def _extend(window: Window, measurements: Records, config: ConfigRecord) -> None:
    """The states after (m,) further measurements.

    Raises:
        InputError: the estimate diverges.
    """
    known = window.count
    count = known + len(measurements)
    window.measurements[known:count] = measurements
    window.status["count"], window.status["known"] = count, known
    before = int(window.status["divergences"][0])
    process(window, _NO_ARRIVALS, _NO_RESULTS, config)
    if window.status["divergences"][0] > before:
        raise InputError(
            f"measurements: the estimate diverges between {measurements['stamp_ns'][0]} and "
            f"{measurements['stamp_ns'][-1]} ns; leave out the source that it follows there"
        )


def _end_of_block(rest: Records, first: int) -> int:
    """After a sprocket sample, so that every interval is closed inside its block."""
    last = min(first + _BLOCK, len(rest))
    samples = np.flatnonzero(rest["kind"][first:last] == SPROCKETS)
    return first + int(samples[-1]) + 1 if samples.size and last < len(rest) else last
