# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Withholds and thins messages during reading, as set by ``InputFilters``."""

from collections.abc import Sequence

import numpy as np

from trackslip_bags.input_filters import InputFilters, Thin
from trackslip_common.arrays import BoolArray, IntArray, Rows
from trackslip_estimation.slip.records import POSE


class Withholding:
    """Finds and counts the messages that ``--withhold`` hides; ``origin_ns``: first log time of the bag."""

    def __init__(self, filters: InputFilters, origin_ns: int) -> None:
        self._withholds, self._origin_ns = filters.withhold, origin_ns
        self.topics = {withhold.topic for withhold in filters.withhold}
        self.counts = [0] * len(filters.withhold)  # hidden messages, by filter

    def hides(self, topic: str, log_times_ns: IntArray) -> BoolArray:
        """(n,) whether each message of a topic is hidden; adds them to the counts."""
        t = np.asarray((log_times_ns - self._origin_ns) * 1e-9, np.float64)
        is_hidden = np.zeros(len(t), np.bool_)
        for k, withhold in enumerate(self._withholds):
            if withhold.topic == topic:
                is_withheld = withhold.covers(t)
                self.counts[k] += int(is_withheld.sum())
                is_hidden |= is_withheld
        return is_hidden


class ArrivalFilter:
    """Removes arrivals that the filters hide from the estimator."""

    def __init__(self, filters: InputFilters, sources: Sequence[str], withholding: Withholding) -> None:
        self._sources, self._withholding = sources, withholding
        self._thinners = [_Thinner(thin, sources, filters.seed) for thin in filters.thin]

    def __call__(self, rows: Rows) -> Rows:
        """The arrivals (in log order) that remain, with the noise that thinning adds."""
        is_hidden = np.zeros(len(rows), np.bool_)
        for topic in self._withholding.topics.intersection(self._sources):
            is_source = rows["source"] == self._sources.index(topic)
            is_hidden[is_source] = self._withholding.hides(topic, rows["log_time_ns"][is_source])
        rows = rows[~is_hidden]
        for thinner in self._thinners:
            rows = thinner(rows)
        return rows


class _Thinner:
    """One source at a lower rate: the first message at or after each tick."""

    def __init__(self, thin: Thin, sources: Sequence[str], seed: int) -> None:
        self._source = sources.index(thin.topic) if thin.topic in sources else -1
        self._period_ns = round(1e9 / thin.rate_hz)
        self._sigma = thin.sigma
        self._rng = np.random.default_rng(seed)
        self._due_ns: int | None = None

    def __call__(self, rows: Rows) -> Rows:
        indices = np.flatnonzero(rows["source"] == self._source)
        is_kept = self._is_kept(rows["stamp_ns"][indices].tolist())
        remains = np.ones(len(rows), np.bool_)
        remains[indices[~is_kept]] = False
        indices = indices[is_kept]
        if self._sigma is not None and indices.size and (rows["kind"][indices] == POSE).all():
            rows = rows.copy()
            rows["value"][indices, :2] += self._rng.normal(0.0, self._sigma, (indices.size, 2))
            covariances = rows["noise"][indices]
            covariances[:, :2, :] = covariances[:, :, :2] = 0.0
            covariances[:, 0, 0] = covariances[:, 1, 1] = self._sigma**2
            rows["noise"][indices] = covariances
        return rows[remains]

    def _is_kept(self, stamps_ns: list[int]) -> BoolArray:
        is_kept = np.zeros(len(stamps_ns), np.bool_)
        for k, stamp_ns in enumerate(stamps_ns):
            if self._due_ns is None or stamp_ns >= self._due_ns:
                due_ns = stamp_ns if self._due_ns is None else self._due_ns
                self._due_ns = due_ns + self._period_ns * ((stamp_ns - due_ns) // self._period_ns + 1)
                is_kept[k] = True
        return is_kept
