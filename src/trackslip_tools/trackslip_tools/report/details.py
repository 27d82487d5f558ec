# SPDX-License-Identifier: Apache-2.0
"""What a report shows of a replay beside its scores: every estimate, report and fix, as arrays."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from trackslip_estimation.slip.records import ESTIMATE, POSE
from trackslip_tools.replay.arrivals import ARRIVAL, Rows
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.run import Part

REPORT = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("source", np.int64),  # number in ``Details.sources``
        ("outcome", np.int64),
        ("dof", np.int64),
        ("nis", np.float64),
        ("gate", np.float64),
        ("published", np.int64),  # estimates before it
    ],
    align=True,
)
FIX = np.dtype(
    [*((n, REPORT[n]) for n in REPORT.names or ()), *((n, ARRIVAL[n]) for n in ("value", "noise"))]
)


@dataclass(eq=False)
class Details:
    """Collects them from the parts of a replay."""

    sources: tuple[str, ...] = ()
    _estimates: GrowingRows = field(default_factory=partial(GrowingRows, ESTIMATE))
    _reports: GrowingRows = field(default_factory=partial(GrowingRows, REPORT))
    _fixes: GrowingRows = field(default_factory=partial(GrowingRows, FIX))

    def add(self, part: Part) -> None:
        """More of a replay."""
        self.sources = part.sources
        found, results = np.empty(len(part.results), FIX), part.results
        for name in ("stamp_ns", "outcome", "dof", "nis", "gate"):
            found[name] = results[name]
        for name in ("source", "value", "noise"):
            found[name] = part.arrivals[name]
        found["published"] = len(self._estimates) + np.cumsum(results["published"]) - results["published"]
        self._estimates.add(part.estimates)
        self._reports.add(found)
        self._fixes.add(found[part.arrivals["kind"] == POSE])

    @property
    def estimates(self) -> Rows:
        """(n,) ESTIMATE in the order in which they were published."""
        return self._estimates.rows()

    @property
    def reports(self) -> Rows:
        """(n,) REPORT in the order of arrival."""
        return self._reports.rows()

    @property
    def fixes(self) -> Rows:
        """(n,) FIX, those of poses, with what they stated."""
        return self._fixes.rows()
