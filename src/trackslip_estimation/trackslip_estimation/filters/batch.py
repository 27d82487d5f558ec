# SPDX-License-Identifier: Apache-2.0
"""Many runs of one filter at once: N sets of parameters or N noise seeds over logs in stamp order, compiled.

Nothing comes late here, so a run is one loop; each run gives what the estimator ends with on the same
measurements. Machine code holds no lock: threads share the cores.
"""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.compiled import compiled
from trackslip_estimation.filters.filter import Filter, RecordArray, step
from trackslip_estimation.filters.model import SPROCKETS, Gaussian, Measured
from trackslip_estimation.motion import MotionState, Speeds

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Row(NamedTuple):
    """One measurement of a log, with what drives the prediction to it."""

    dt: float  # s since the row before, or since the start
    speeds: Speeds
    motion: MotionState
    source: int
    measured: Measured


class Log(NamedTuple):
    """Rows as arrays, in the order of their stamps."""

    times: FloatArray  # (k, 2) dt, stretch of the sprocket speeds, s
    speeds: FloatArray  # (k, 2) left, right, rad/s
    flags: IntArray  # (k, 5) kind, source, motion, changing, differenced
    values: FloatArray  # (k, 3) z, padded
    noises: FloatArray  # (k, 3, 3) R, padded


class Run(NamedTuple):
    """The filter after each row of a log."""

    means: FloatArray  # (k, n)
    covariances: FloatArray  # (k, n, n)
    nis: FloatArray  # (k,) nan where nothing was measured
    accepted: NDArray[np.bool_]  # (k,) inside the gate, or believed after too many rejections in a row


class Gates(NamedTuple):
    """Which measurements are taken."""

    limits: FloatArray  # (4,) of NIS by degrees of freedom 0 … 3; infinite where all are taken
    patience: int  # rejections in a row from one source after which it is believed


EVERYTHING = Gates(np.full(4, np.inf), 1)


def make_log(rows: Sequence[Row]) -> Log:
    """Rows as arrays."""
    log = Log(
        np.array([(row.dt, row.speeds.stretch) for row in rows]).reshape(-1, 2),
        np.array([(row.speeds.left, row.speeds.right) for row in rows]).reshape(-1, 2),
        np.array([_flags(row) for row in rows], dtype=np.int64).reshape(-1, 5),
        np.zeros((len(rows), 3)),
        np.zeros((len(rows), 3, 3)),
    )
    for k, (_, value, noise) in enumerate(row.measured for row in rows):
        log.values[k, : value.size] = value
        log.noises[k, : value.size, : value.size] = noise
    return log


def run(log: Log, filter_: Filter, start: Gaussian, gates: Gates = EVERYTHING) -> Run:
    """One run over one log."""
    sources = int(log.flags[:, 1].max(initial=0)) + 1
    return Run(*_loop(*log, *start, sources, *gates, filter_.constants))


def run_all(runs: Iterable[tuple[Log, Filter, Gaussian, Gates]], threads: int | None = None) -> Iterator[Run]:
    """``run`` of each, in their order; any number of them may share a log or a filter."""
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(lambda arguments: run(*arguments), runs)


def _flags(row: Row) -> tuple[int, int, int, int, int]:
    motion = row.motion
    differenced = int(row.speeds.differenced)
    return row.measured.kind, row.source, int(motion.motion), int(motion.changing), differenced


@compiled
def _loop(
    times: FloatArray,
    speeds: FloatArray,
    flags: IntArray,
    values: FloatArray,
    noises: FloatArray,
    x: FloatArray,
    P: FloatArray,
    sources: int,
    limits: FloatArray,
    patience: int,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """The fields of ``Run``."""
    c = constants[0]
    count, n = times.shape[0], x.size
    means, covariances = np.empty((count, n)), np.empty((count, n, n))
    nis, accepted = np.full(count, np.nan), np.ones(count, np.bool_)
    rejected_in_a_row = np.zeros(sources, np.int64)
    for k in range(count):
        dt, stretch = times[k]
        left, right = speeds[k]
        kind, source, motion, changing, differenced = flags[k]
        m = 2 if kind == SPROCKETS else kind  # the kinds are numbered so
        z, R = values[k, :m].copy(), noises[k, :m, :m].copy()
        x, P, x_updated, P_updated, nis[k] = step(
            kind, x, P, z, R, left, right, stretch, differenced == 1, dt, motion, changing, c
        )
        if kind != SPROCKETS:
            accepted[k] = nis[k] <= limits[m] or rejected_in_a_row[source] >= patience
            rejected_in_a_row[source] = 0 if accepted[k] else rejected_in_a_row[source] + 1
        if accepted[k]:
            x, P = x_updated, P_updated
        means[k], covariances[k] = x, P
    return means, covariances, nis, accepted
