# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Details of a replay for a report: estimates, innovations, and fixes."""

from collections.abc import Iterable

import numpy as np

from trackslip_common.arrays import IntArray, Rows
from trackslip_common.orientations import wrap_angles
from trackslip_estimation.slip.explanations import CompetingExplanations
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.records import ESTIMATE, POSE
from trackslip_tools.replay.arrivals import ARRIVAL
from trackslip_tools.replay.growing import MOST_DRAWN, GrowingRows
from trackslip_tools.replay.parts import Part

REPORT = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("source", np.int64),  # number in ``Details.sources``
        ("outcome", np.int64),
        ("dof", np.int64),
        ("nis", np.float64),
        ("gate", np.float64),
    ],
    align=True,
)
FIX = np.dtype(
    [
        *((n, REPORT[n]) for n in REPORT.names or ()),
        *((n, ARRIVAL[n]) for n in ("value", "noise")),
        ("expected", np.bool_),  # whether an estimate for its stamp had been published when it came; then:
        ("pose", np.float64, (3,)),  # (3,) estimated pose of base_link at its stamp
        ("pose_covariance", np.float64, (3, 3)),
    ]
)
_RECENT_NS = 60_000_000_000  # largest delay of a fix


class Details:
    """Collects details from the parts of a replay; thins the estimates of long ones."""

    def __init__(self) -> None:
        self.sources: tuple[str, ...] = ()
        self._estimates = GrowingRows(ESTIMATE, MOST_DRAWN)
        self._reports, self._fixes = GrowingRows(REPORT), GrowingRows(FIX)
        self._recent = np.empty(0, ESTIMATE)
        # Records with competing explanations, and after each series of them the first without.
        self.explanations: list[CompetingExplanations] = []

    def add(self, part: Part) -> None:
        """Add a part."""
        self.sources = part.sources
        self.add_explanations(part.explanations)
        results = part.results
        rows = np.zeros(len(results), FIX)
        for name in ("stamp_ns", "outcome", "dof", "nis", "gate"):
            rows[name] = results[name]
        for name in ("source", "value", "noise"):
            rows[name] = part.arrivals[name]
        estimates = part.estimates
        self._estimates.add(estimates)
        self._reports.add(rows[(rows["dof"] > 0) & np.isfinite(rows["nis"])])
        is_pose = part.arrivals["kind"] == POSE
        published = np.cumsum(results["published"]) - results["published"]
        fixes = rows[is_pose]
        if len(estimates) and len(self._recent) and self._recent["stamp_ns"][-1] >= estimates["stamp_ns"][0]:
            self._recent = self._recent[:0]  # clock went back
        recent = np.concatenate((self._recent, estimates))
        _fill_expected_poses(fixes, recent, len(self._recent) + published[is_pose])
        self._fixes.add(fixes)
        if len(recent):
            oldest_ns = recent["stamp_ns"][-1] - _RECENT_NS
            self._recent = recent[np.searchsorted(recent["stamp_ns"], oldest_ns) :]

    def add_explanations(self, explanations: Iterable[CompetingExplanations]) -> None:
        """Add explanations."""
        for competing in explanations:
            if competing.number_competing or (self.explanations and self.explanations[-1].number_competing):
                self.explanations.append(competing)

    @property
    def estimates(self) -> Rows:
        """(n,) ESTIMATE in order of publication."""
        return self._estimates.rows()

    @property
    def reports(self) -> Rows:
        """(n,) REPORT of measurements that were compared with the estimate, in order of arrival."""
        return self._reports.rows()

    @property
    def fixes(self) -> Rows:
        """(n,) FIX of all fixes, with their values and covariances."""
        return self._fixes.rows()

    @property
    def accepted_fixes(self) -> Rows:
        """(n,) FIX of those that were used."""
        accepted: Rows = self.fixes[self.fixes["outcome"] == Outcome.ACCEPTED]
        return accepted


def _fill_expected_poses(fixes: Rows, estimates: Rows, published: IntArray) -> None:
    """Fill in the expected poses of (n,) FIX, each from the first ``published`` (n,) estimates."""
    before = np.searchsorted(estimates["stamp_ns"], fixes["stamp_ns"], "right")
    before = np.minimum(before, published) - 1
    fixes["expected"] = before >= 0
    has_pose = fixes["expected"]
    first = estimates[before[has_pose]]
    last = estimates[np.minimum(before[has_pose] + 1, published[has_pose] - 1)]
    span_ns = np.maximum(last["stamp_ns"] - first["stamp_ns"], 1)
    share = (fixes["stamp_ns"][has_pose] - first["stamp_ns"]) / span_ns
    share *= last["stamp_ns"] > first["stamp_ns"]
    step = last["pose"] - first["pose"]
    step[:, YAW] = wrap_angles(step[:, YAW])
    fixes["pose"][has_pose] = first["pose"] + share[:, np.newaxis] * step
    fixes["pose_covariance"][has_pose] = first["pose_covariance"]
