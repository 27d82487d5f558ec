# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a replay withheld, and how far off the estimate was meanwhile and at the end of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackslip_bags.input_filters import InputFilters, Withhold
from trackslip_common.arrays import FloatArray, Rows
from trackslip_tools.replay.errors import PathErrors
from trackslip_tools.replay.inputs import Logged
from trackslip_tools.replay.scoring import Score
from trackslip_tools.replay.series import reduced


@dataclass(frozen=True)
class Withheld:
    """One ``--withhold``; errors are those of the position, None where nothing is compared."""

    given: Withhold
    messages: int
    score: Score | None  # inside
    end: float | None  # m, at the last sample of the reference inside

    def __str__(self) -> str:
        """For a terminal."""
        start, stop = self.given.start_s, self.given.stop_s
        when = f" from {start:g} to {stop:g} s" if np.isfinite(start) else ""
        line = f"withheld: {self.messages} messages of {self.given.topic}{when}"
        if self.score is None or self.end is None:
            return line
        return (
            f"{line}; position off by {self.score.position:.4f} m RMS meanwhile, {self.end:.4f} m at the end"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        rmse = None if self.score is None else self.score.position
        return {"topic": self.given.topic, "messages": self.messages, "rmse": rmse, "end": self.end}


class WithheldErrors:
    """Gathers them while a bag is replayed; ``start_ns``: of the bag."""

    def __init__(self, filters: InputFilters, start_ns: int) -> None:
        self._given, self._start_ns = filters.withhold, start_ns
        self._errors = [PathErrors() for _ in self._given]

    def add(self, estimates: Rows, reference: Logged | None) -> None:
        """More of both: (n,) ESTIMATE."""
        for given, errors in zip(self._given, self._errors, strict=True):
            inside = (
                None if reference is None else reduced(reference.rows[given.covers(self._times(reference))])
            )
            errors.add_estimates(estimates, inside)

    def result(self, counts: Sequence[int]) -> list[Withheld]:
        """When all was added; ``counts``: messages hidden by each."""
        return [
            Withheld(given, count, errors.score, errors.last_position)
            for given, errors, count in zip(self._given, self._errors, counts, strict=True)
        ]

    def _times(self, logged: Logged) -> FloatArray:
        return np.asarray((logged.log_times_ns - self._start_ns) * 1e-9, np.float64)
