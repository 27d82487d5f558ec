# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Monitor the sources of the estimator: which are lost, and whether their innovations are consistent.

d²    normalised innovation squared (NIS), χ² with n degrees of freedom if consistent
"""

from collections import defaultdict, deque
from collections.abc import Mapping

from trackslip_estimation.kalman import chi_square
from trackslip_estimation.slip.measurements import Outcome, Report
from trackslip_estimation.slip.silence import SilenceMonitor

_WINDOW_NS = 10_000_000_000


def reason_of(report: Report) -> str:
    """Why a measurement was rejected, as it is counted."""
    return (report.fault or report.outcome).name.lower()


class SourceWatch:
    """Collects the reports of all sources; times are stamps."""

    def __init__(self, timeouts_ns: Mapping[str, int]) -> None:
        """``timeouts_ns``: expected source → timeout."""
        self._diverged_ns: int | None = None
        self.set_timeouts(timeouts_ns)
        self.clear()

    def set_timeouts(self, timeouts_ns: Mapping[str, int]) -> None:
        """Replace the timeouts."""
        self._timeouts_ns = timeouts_ns

    def clear(self) -> None:
        """Discard all reports, as the estimate restarts."""
        self._used_ns: dict[str, int] = {}
        self._silences: dict[str, SilenceMonitor] = defaultdict(SilenceMonitor)
        self._innovations: dict[str, deque[Report]] = defaultdict(deque)
        self._reasons: dict[str, str] = {}  # source → why its latest message was rejected

    def add_rejection(self, source: str, reason: str) -> None:
        """Add why a message of a source never became a measurement."""
        self._reasons[source] = reason

    def add(self, report: Report) -> None:
        """Add a report."""
        if report.outcome in (Outcome.RESTARTED, Outcome.DIVERGED):
            self.clear()
        if report.outcome is Outcome.DIVERGED:
            self._diverged_ns = report.stamp_ns
        if report.stamp_ns == 0:  # commands have no stamp
            return
        self._silences[report.source].add(report.stamp_ns)
        if report.outcome.is_rejected:
            self._reasons[report.source] = reason_of(report)
            return
        self._reasons.pop(report.source, None)
        for source in self._timeouts_ns:  # timeouts count from the first report
            self._used_ns.setdefault(source, report.stamp_ns)
        self._used_ns[report.source] = max(report.stamp_ns, self._used_ns.get(report.source, 0))
        if report.dof:
            self._innovations[report.source].append(report)

    def has_diverged(self, now_ns: int) -> bool:
        """Whether the estimate diverged and restarted within the last ``_WINDOW_NS``."""
        return self._diverged_ns is not None and now_ns - self._diverged_ns < _WINDOW_NS

    def lost_sources(self, now_ns: int) -> dict[str, float]:
        """Lost source (``silence``) → seconds since its latest measurement that was not rejected."""
        since = {source: now_ns - self._used_ns.get(source, now_ns) for source in self._timeouts_ns}
        limits = {source: self._silences[source].limit(ns) for source, ns in self._timeouts_ns.items()}
        return {source: ns * 1e-9 for source, ns in since.items() if ns > limits[source]}

    def lost_sources_text(self, now_ns: int) -> str:
        """The lost sources, each with why its latest message was rejected; empty if none is lost."""
        lost = self.lost_sources(now_ns).items()
        reasons = {source: f" ({reason})" for source, reason in self._reasons.items()}
        return ", ".join(f"{source} for {s:.1f} s{reasons.get(source, '')}" for source, s in lost)

    def innovations(self, now_ns: int) -> dict[str, str]:
        """Source → text: mean d² over the last ``_WINDOW_NS``, and its bounds if consistent."""
        texts = {}
        for source, reports in sorted(self._innovations.items()):
            while reports and reports[0].stamp_ns < now_ns - _WINDOW_NS:
                reports.popleft()
            if reports:
                dof, n = sum(r.dof for r in reports), len(reports)
                low, high = (bound / n for bound in chi_square.confidence_interval(dof))
                mean = sum(r.nis for r in reports) / n
                texts[source] = f"{mean:.2f} ({low:.2f} to {high:.2f} if consistent), n {n}"
        return texts
