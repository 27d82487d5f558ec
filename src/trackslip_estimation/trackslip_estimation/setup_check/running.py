# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check of a running estimator, on its latest measurements.

The check reports the causes that the last two minutes show. A cause is withdrawn once the newest part of them
has enough motion to decide and does not show it; older measurements are then dropped. A certain mistake that
is one of several is reported once two evaluations in a row show one: single ones may vanish.
"""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.check import check
from trackslip_estimation.setup_check.collect import Columns, log_of_columns
from trackslip_estimation.setup_check.finding import Result
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    HeadingFix,
    Measurement,
    PoseFix,
    Sprockets,
    SwingAngle,
    YawRate,
)
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import HEADING, ON_SWING, POSE, SPROCKETS, YAW_RATE

LONGEST_S = 150.0  # s of measurements that are evaluated
RECENT_S = 45.0  # s of the newest part, which withdraws a cause
_PERIOD_NS = 20_000_000  # ns between stamps of one source that are kept: the check needs no more
_MOST_READINGS = int(LONGEST_S / 0.02)  # readings of a source
_NO_ANGLES = (np.nan, np.nan)

_Row = tuple[int, tuple[float, ...]]


class RunningCheck:
    """Takes measurements from the estimator's thread; ``evaluate`` runs in another one."""

    def __init__(self, p: SlipEstimatorParameters) -> None:
        self._parameters = p
        self._lock = threading.Lock()
        self._rows: dict[tuple[int, str], deque[_Row]] = {}
        self._was_open = False  # whether the previous evaluation had an open question
        self.result = Result()

    def add(self, m: Measurement) -> None:
        """Keep a measurement as the estimator receives it; this takes about a microsecond."""
        row = _to_row(m)
        if row is None:
            return
        key, values = row
        with self._lock:
            rows = self._rows.get(key)
            if rows is None:
                rows = self._rows[key] = deque(maxlen=_MOST_READINGS)
            if not rows or not 0 < m.stamp_ns - rows[-1][0] < _PERIOD_NS:
                rows.append((m.stamp_ns, values))

    def restart(self, p: SlipEstimatorParameters) -> None:
        """Drop measurements and result: the parameters changed, or the estimate restarted."""
        with self._lock:
            self._parameters = p
            self._rows = {}
            self._was_open = False
            self.result = Result()

    def evaluate(self) -> Result:
        """Run the check on the kept measurements; return, and keep, the causes that hold now.

        The result of an evaluation during which the check restarts is dropped.
        """
        evaluated_rows = self._rows
        result = self._check_latest(LONGEST_S)
        if result.causes and _is_decided(recent := self._check_latest(RECENT_S)):
            names = {cause.cause for cause in recent.causes}
            causes = tuple(cause for cause in result.causes if cause.cause in names)
            if len(causes) < len(result.causes):
                self._keep_recent()
            result = replace(result, causes=causes)
        is_open = bool(result.open_questions)
        with self._lock:
            if self._rows is not evaluated_rows:
                return self.result
            if is_open and not self._was_open:
                undetermined = tuple(replace(question, is_wrong=False) for question in result.undetermined)
                result = replace(result, undetermined=undetermined)
            self._was_open = is_open
            self.result = result
        return result

    def _check_latest(self, length_s: float) -> Result:
        log = log_of_columns(self._columns(length_s), self._parameters)
        return Result() if log is None else check(log)

    def _columns(self, length_s: float) -> Columns:
        with self._lock:
            newest_ns = self._newest_ns()
            rows = {key: list(source_rows) for key, source_rows in self._rows.items() if source_rows}
        columns: Columns = {}
        for key, source_rows in rows.items():
            stamps = np.array([stamp for stamp, _ in source_rows], np.int64)
            values: FloatArray = np.array([value for _, value in source_rows], np.float64)
            new = stamps > newest_ns - int(length_s * 1e9)
            if new.any():
                columns[key] = stamps[new], values[new]
        return columns

    def _newest_ns(self) -> int:
        return max((source_rows[-1][0] for source_rows in self._rows.values() if source_rows), default=0)

    def _keep_recent(self) -> None:
        with self._lock:
            oldest_ns = self._newest_ns() - int(RECENT_S * 1e9)
            for source_rows in self._rows.values():
                while source_rows and source_rows[0][0] <= oldest_ns:
                    source_rows.popleft()


class BackgroundCheck:
    """Evaluates a running check in a thread of its own, one evaluation at a time."""

    def __init__(self, running: RunningCheck, on_failure: Callable[[Exception], None]) -> None:
        self._running, self._on_failure = running, on_failure
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin an evaluation, unless one is running."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._evaluate, name="setup check", daemon=True)
            self._thread.start()

    def join(self) -> None:
        """Wait for a running evaluation."""
        if self._thread is not None:
            self._thread.join()

    def _evaluate(self) -> None:
        try:
            self._running.evaluate()
        except Exception as error:  # noqa: BLE001 (whatever is measured, the estimator goes on)
            self._on_failure(error)


def _is_decided(result: Result) -> bool:
    """Whether there was enough motion to decide signs."""
    return bool(result.facts) and not any(
        question.what.startswith(("signs", "everything")) for question in result.undetermined
    )


def _to_row(m: Measurement) -> tuple[tuple[int, str], tuple[float, ...]] | None:
    """Kind and source, and the values in the order of ``collect.Columns``; None for other measurements."""
    if isinstance(m, Sprockets):
        return (SPROCKETS, m.source), (m.left_speed, m.right_speed, *(m.positions or _NO_ANGLES))
    if isinstance(m, YawRate):
        p, q = m.tilt_rates
        return (YAW_RATE, m.source), (p, q, m.rate, *m.tilt_variances, m.variance, *m.acceleration)
    if isinstance(m, PoseFix):
        if m.source == SET_POSE:
            return None
        R = m.covariance
        return (POSE, m.source), (*m.pose, R[0, 0], R[1, 1], R[2, 2])
    if isinstance(m, HeadingFix):
        return (HEADING, m.source), (m.heading,)
    if isinstance(m, SwingAngle):
        return (ON_SWING, m.source), (m.angle,)
    return None
