# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Withholds and thins arrivals during reading, as set by ``InputFilters``."""

from collections.abc import Sequence

import numpy as np

from trackslip_bags.input_filters import InputFilters, Thin
from trackslip_common.arrays import BoolArray, Rows
from trackslip_estimation.slip.records import POSE


class ArrivalFilter:
    """Removes arrivals that the filters hide from the estimator; ``origin_ns``: first log time of the bag."""

    def __init__(self, filters: InputFilters, sources: Sequence[str], origin_ns: int) -> None:
        self._filters, self._sources, self._origin_ns = filters, sources, origin_ns
        self.hidden = [0] * len(filters.withhold)  # withheld messages, by filter
        self._thinners = [_Thinner(thin, sources, filters.seed) for thin in filters.thin]

    def __call__(self, rows: Rows) -> Rows:
        """The arrivals (in log order) that remain, with the noise that thinning adds."""
        t = (rows["log_time_ns"] - self._origin_ns) * 1e-9
        is_hidden = np.zeros(len(rows), np.bool_)
        for k, withhold in enumerate(self._filters.withhold):
            if withhold.topic in self._sources:
                is_source = rows["source"] == self._sources.index(withhold.topic)
                is_withheld = withhold.covers(t) & is_source
                self.hidden[k] += int(is_withheld.sum())
                is_hidden |= is_withheld
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
