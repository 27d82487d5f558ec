# SPDX-License-Identifier: Apache-2.0
"""Many runs of one filter at once: N sets of parameters or N noise seeds over logs in stamp order, compiled.

Nothing comes late here, so a run is one loop; each run gives what the estimator ends with on the same
measurements. Machine code holds no lock: threads share the cores. What a filter cannot be asked in machine
code (silence of the sprockets, a pose that a user gives) is rare: there the loop hands over to ``Aside``.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.filter import Filter, RecordArray, predict
from trackslip_estimation.slip.gating import Gates, log_det, measure
from trackslip_estimation.slip.models.dispatch import size
from trackslip_estimation.slip.models.model import SPROCKETS, Gaussian, Measured
from trackslip_estimation.slip.motion import MotionState, Speeds

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

ASIDE = -1  # and all below it: kinds of rows that are the caller's
EVERYTHING = Gates(np.full(4, np.inf), 1.0, np.ones(1, np.int64), np.zeros((1, 2)))

Aside = Callable[[int, Gaussian], Gaussian]
"""Number of the row, state before → state after."""


class Row(NamedTuple):
    """One measurement of a log, with what drives the prediction to it."""

    dt: float  # s since the row before, or since the start
    speeds: Speeds
    motion: MotionState
    source: int  # number in ``Gates``
    measured: Measured


class Log(NamedTuple):
    """Rows as arrays, in the order of their stamps."""

    times: FloatArray  # (k, 2) dt, stretch of the sprocket speeds, s
    speeds: FloatArray  # (k, 3) left, right, departure from their recent mean, rad/s
    flags: IntArray  # (k, 5) kind, source, motion, changing, differenced
    values: FloatArray  # (k, 3) z, padded
    noises: FloatArray  # (k, 3, 3) R, padded


class Run(NamedTuple):
    """The filter after each row of a log, or after those that were asked for (m of k)."""

    means: FloatArray  # (m, n)
    covariances: FloatArray  # (m, n, n)
    nis: FloatArray  # (k,) nan where nothing was measured
    log_dets: FloatArray  # (k,) ln |S| of the innovation, nan where nothing was gated
    accepted: BoolArray  # (k,) inside the gate


def make_log(rows: Sequence[Row]) -> Log:
    """Rows as arrays."""
    log = Log(
        np.array([(row.dt, row.speeds.stretch) for row in rows]).reshape(-1, 2),
        np.array([(row.speeds.left, row.speeds.right, row.motion.departure) for row in rows]).reshape(-1, 3),
        np.array([_flags(row) for row in rows], dtype=np.int64).reshape(-1, 5),
        np.zeros((len(rows), 3)),
        np.zeros((len(rows), 3, 3)),
    )
    for k, (_, value, noise) in enumerate(row.measured for row in rows):
        log.values[k, : value.size] = value
        log.noises[k, : value.size, : value.size] = noise
    return log


def run(
    log: Log,
    filter_: Filter,
    start: Gaussian,
    gates: Gates = EVERYTHING,
    aside: Aside | None = None,
    keep: BoolArray | None = None,
) -> Run:
    """One run over one log; ``keep`` (k,) says after which rows the state is wanted, if not after all."""
    count, n = len(log.times), start.mean.size
    slots = np.arange(count) if keep is None else np.where(keep, np.cumsum(keep) - 1, -1)
    kept = int(slots.max(initial=-1)) + 1
    found = Run(
        np.empty((kept, n)),
        np.empty((kept, n, n)),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.ones(count, np.bool_),
    )
    gates, agreed_ns = _of_each(gates, log), np.zeros(_sources(log), np.int64)
    shared: tuple[Any, ...] = (*log, clock_ns(log), agreed_ns, *gates, filter_.constants, slots, *found)
    k, x, P = 0, *start
    while True:
        k, x, P = _loop(k, x, P, *shared)
        if k == count:
            return found
        if aside is None:
            raise ValueError(f"row {k} is of kind {log.flags[k, 0]}, and there is nobody to ask")
        x, P = aside(k, Gaussian(x, P))
        if slots[k] >= 0:
            found.means[slots[k]], found.covariances[slots[k]] = x, P
        k += 1


def run_all(runs: Iterable[tuple[Log, Filter, Gaussian, Gates]], threads: int | None = None) -> Iterator[Run]:
    """``run`` of each, in their order; any number of them may share a log or a filter."""
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(lambda arguments: run(*arguments), runs)


def _flags(row: Row) -> tuple[int, int, int, int, int]:
    motion = row.motion
    differenced = int(row.speeds.differenced)
    return row.measured.kind, row.source, int(motion.motion), int(motion.changing), differenced


def clock_ns(log: Log) -> IntArray:
    """(k,) time of the rows since the start."""
    return np.cumsum(np.rint(log.times[:, 0] * 1e9).astype(np.int64))


def _sources(log: Log) -> int:
    """How many sources the log's numbers allow for."""
    return int(log.flags[log.flags[:, 0] > SPROCKETS, 1].max(initial=-1)) + 1


def _of_each(gates: Gates, log: Log) -> Gates:
    """Gates with a row for each source of the log: one holds for all."""
    sources, rows = _sources(log), len(gates.timeouts_ns)
    if rows == 1:
        return gates._replace(
            timeouts_ns=np.repeat(gates.timeouts_ns, sources), levers=np.repeat(gates.levers, sources, axis=0)
        )
    if rows < sources:
        raise ValueError(f"gates of {rows} sources for a log of {sources}")
    return gates


@compiled
def _loop(
    first: int,
    x: FloatArray,
    P: FloatArray,
    times: FloatArray,
    speeds: FloatArray,
    flags: IntArray,
    values: FloatArray,
    noises: FloatArray,
    now_ns: IntArray,
    agreed_ns: IntArray,
    limits: FloatArray,
    relaxation: float,
    timeouts_ns: IntArray,
    levers: FloatArray,
    constants: RecordArray,
    slots: IntArray,
    means: FloatArray,
    covariances: FloatArray,
    nis: FloatArray,
    log_dets: FloatArray,
    accepted: BoolArray,
) -> tuple[int, FloatArray, FloatArray]:
    """From row ``first`` on: the first row that is aside, or their count, and the state before it."""
    c = constants[0]
    count = times.shape[0]
    for k in range(first, count):
        dt, stretch = times[k]
        left, right, departure = speeds[k]
        kind, source, motion, changing, counted = flags[k]
        if kind <= ASIDE:
            return k, x, P
        x, P = predict(x, P, left, right, dt, motion, changing, departure, c)
        if kind != SPROCKETS:
            m = size(kind)
            z, R = values[k, :m].copy(), noises[k, :m, :m].copy()
            lever, apart_ns, timeout_ns = levers[source], now_ns[k] - agreed_ns[source], timeouts_ns[source]
            log_dets[k] = log_det(kind, R, x, P, left, right, stretch, counted == 1, lever, c)
            _, _, x, P, nis[k], _, accepted[k], agreed = measure(
                kind,
                z,
                R,
                x,
                P,
                left,
                right,
                stretch,
                counted == 1,
                lever,
                apart_ns,
                timeout_ns,
                limits,
                relaxation,
                c,
            )
            if agreed:
                agreed_ns[source] = now_ns[k]
        if slots[k] >= 0:
            means[slots[k]], covariances[slots[k]] = x, P
    return count, x, P
