# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the estimate while a replay withheld a topic, and at the end of that time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackslip_bags.input_filters import InputFilters, Withhold
from trackslip_common.arrays import Rows
from trackslip_tools.replay.inputs import LoggedMessages
from trackslip_tools.replay.scoring import PathErrors, Score
from trackslip_tools.replay.series import reduce_columns


@dataclass(frozen=True)
class WithholdResult:
    """Messages withheld by one ``--withhold``, and position errors; None without compared samples."""

    withhold: Withhold
    messages: int
    score: Score | None  # over the withheld time
    end: float | None  # m, at the last sample of the reference in the withheld time

    def __str__(self) -> str:
        """A line for the terminal."""
        start, stop = self.withhold.start_s, self.withhold.stop_s
        when = f" from {start:g} to {stop:g} s" if np.isfinite(start) else ""
        line = f"withheld: {self.messages} messages of {self.withhold.topic}{when}"
        if self.score is None or self.end is None:
            return line
        return (
            f"{line}; position off by {self.score.position:.4f} m RMS meanwhile, {self.end:.4f} m at the end"
        )

    def as_dict(self) -> dict[str, Any]:
        """The entry of ``--json``."""
        rmse = None if self.score is None else self.score.position
        return {"topic": self.withhold.topic, "messages": self.messages, "rmse": rmse, "end": self.end}


class WithheldErrors:
    """Collects the errors during a replay; ``start_ns``: log time of the bag's first message."""

    def __init__(self, filters: InputFilters, start_ns: int) -> None:
        self._withholds, self._start_ns = filters.withhold, start_ns
        self._errors = [PathErrors() for _ in self._withholds]

    def add(self, estimates: Rows, reference: LoggedMessages | None) -> None:
        """Add (n,) ESTIMATE and rows of the reference."""
        for withhold, errors in zip(self._withholds, self._errors, strict=True):
            rows = None
            if reference is not None:
                t = np.asarray((reference.log_times_ns - self._start_ns) * 1e-9, np.float64)
                rows = reduce_columns(reference.rows[withhold.covers(t)])
            errors.add_estimates(estimates, rows)

    def result(self, counts: Sequence[int]) -> list[WithholdResult]:
        """Results after the last part; ``counts``: messages hidden by each ``--withhold``."""
        return [
            WithholdResult(withhold, count, errors.score, errors.last_position)
            for withhold, errors, count in zip(self._withholds, self._errors, counts, strict=True)
        ]
