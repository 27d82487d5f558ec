# SPDX-License-Identifier: Apache-2.0
"""How measurements met the estimate: normalised innovations against their gates and their expectation.

ν, S     innovation, its covariance      of the measurement
NIS      νᵀ S⁻¹ ν, χ² with dof degrees of freedom if the filter is consistent
d        pose fix less the estimate published for its stamp, before the fix arrived   m, m, rad
D        covariance of d: the estimate's and the fix's                                 (3, 3)
w        L⁻¹ d with L Lᵀ = D: of variance 1 each if both are consistent
"""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.measurements import Outcome, PoseFix
from trackslip_estimation.slip.models.model import YAW, Gaussian
from trackslip_estimation.slip.sources import PoseSource
from trackslip_tools.report.panel import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    SIGMAS,
    Curve,
    Form,
    Panel,
    colour_in,
)
from trackslip_tools.report.run import Run

FloatArray = NDArray[np.float64]

WINDOW = 25  # innovations in a moving mean
_TAIL = 0.025  # of χ², either side of the band for that mean


class Innovations(NamedTuple):
    """What a source's measurements were found to be, in the order in which they were taken."""

    times: FloatArray  # (n,) s from the bag's first message, by stamp
    nis: FloatArray  # (n,)
    gates: FloatArray  # (n,) limit of nis
    freedoms: FloatArray  # (n,) degrees of freedom
    refused: NDArray[np.bool_]  # (n,) gated

    @property
    def mean_ratio(self) -> float:
        """Mean of NIS over degrees of freedom of what was accepted: 1 if the filter is consistent."""
        taken = ~self.refused
        return float(self.nis[taken].sum() / self.freedoms[taken].sum()) if taken.any() else float("nan")


def innovations_of(run: Run) -> dict[str, Innovations]:
    """By source; of measurements that came as far as being compared with the estimate."""
    rows: dict[str, list[tuple[int, float, float, float, bool]]] = defaultdict(list)
    for report, _ in run.replay.steps:
        if report.dof and np.isfinite(report.nis):
            refused = report.outcome is Outcome.GATED
            rows[report.source].append((report.stamp_ns, report.nis, report.gate, report.dof, refused))
    found = {}
    for source, reports in sorted(rows.items()):
        stamps_ns, nis, gates, freedoms, refused_ones = (np.array(c) for c in zip(*reports, strict=True))
        times = run.recording.seconds(stamps_ns)
        found[source] = Innovations(times, nis, gates, freedoms.astype(np.float64), refused_ones)
    return found


def innovation_panels(runs: Sequence[Run]) -> list[Panel]:
    """NIS of each source; of a single run also the whitened differences of its fixes."""
    found = [(run, innovations_of(run)) for run in runs]
    panels = []
    for source in sorted({source for _, by_source in found for source in by_source}):
        own = [(run, by_source[source]) for run, by_source in found if source in by_source]
        curves = [*_points(own[0][1])] if len(runs) == 1 else []
        curves.append(_expected(own[0][1]))
        for run, innovations in own:
            label = f"mean of {WINDOW}" if len(runs) == 1 else run.label
            curves.append(_moving_mean(innovations, label, colour_in(runs, run, INK)))
        title = f"{source}: squared innovations over what is expected"
        panels.append(Panel(title, "NIS / dof, 1", curves, logarithmic=True))
    return panels + (_whitened_panels(runs[0]) if len(runs) == 1 else [])


def _points(innovations: Innovations) -> Iterator[Curve]:
    """Each measurement, and the gate."""
    ratio = innovations.nis / innovations.freedoms
    order = np.argsort(innovations.times, kind="stable")
    gate = (innovations.gates / innovations.freedoms)[order]
    yield Curve("gate", ORANGE, innovations.times[order], gate, Form.DASHED)
    for label, chosen, form in (
        ("taken", ~innovations.refused, Form.POINTS),
        ("refused", innovations.refused, Form.CROSSES),
    ):
        if chosen.any():
            colour = ORANGE if form is Form.CROSSES else BLUE
            yield Curve(label, colour, innovations.times[chosen], ratio[chosen], form)


def _expected(innovations: Innovations) -> Curve:
    """1, and where 95 % of the moving means of a consistent filter lie."""
    ends = np.array((innovations.times.min(), innovations.times.max()))
    freedom = WINDOW * float(np.median(innovations.freedoms))
    low, high = (np.full(2, chdtri(freedom, tail) / freedom) for tail in (1.0 - _TAIL, _TAIL))
    return Curve("expected, 95 %", GREEN, ends, np.ones(2), Form.DASHED, (low, high))


def _moving_mean(innovations: Innovations, label: str, colour: str) -> Curve:
    """Over the measurements that were taken, at the last one of each window."""
    taken = ~innovations.refused
    order = np.argsort(innovations.times[taken], kind="stable")
    columns = (innovations.nis[taken][order], innovations.freedoms[taken][order])
    nis, freedoms = (np.convolve(column, np.ones(WINDOW), mode="valid") for column in columns)
    times = innovations.times[taken][order][WINDOW - 1 :][: len(nis)]
    return Curve(label, colour, times, nis[: len(times)] / freedoms[: len(times)])


def _whitened_panels(run: Run) -> list[Panel]:
    """Of each source of poses."""
    panels = []
    for source, (times, whitened) in sorted(whitened_fixes(run).items()):
        curves = [
            Curve(label, colour, times, whitened[:, column], Form.POINTS)
            for column, (label, colour) in enumerate((("x", BLUE), ("y", ORANGE), ("heading", GREEN)))
            if np.isfinite(whitened[:, column]).any()
        ]
        title = f"{source}: fix less published estimate, whitened; 95 % belong within ±2"
        panels.append(Panel(title, "w, σ", curves, limits=(-SIGMAS, 0.0, SIGMAS)))
    return panels


def whitened_fixes(run: Run) -> dict[str, tuple[FloatArray, FloatArray]]:
    """By source: times (n,), and w (n, 3), whose heading is nan where it is not a measurement.

    Fixes older than the first estimate, or without one that was published before they came, are left out.
    """
    fixes = {(m.source, m.stamp_ns): m for m in run.inputs if isinstance(m, PoseFix)}
    sources = run.parameters.poses()
    published: list[Estimate] = []
    stamps_ns: list[int] = []
    rows: dict[str, list[tuple[int, FloatArray]]] = defaultdict(list)
    for report, estimate in run.replay.steps:
        fix = fixes.get((report.source, report.stamp_ns))
        if fix is not None and report.source in sources and stamps_ns:
            before = bisect_right(stamps_ns, fix.stamp_ns) - 1
            if before >= 0 and not report.outcome.refused:
                pair = published[before : before + 2]
                rows[fix.source].append((fix.stamp_ns, _whitened(fix, pair, sources[fix.source])))
        if estimate is not None:
            published.append(estimate)
            stamps_ns.append(estimate.stamp_ns)
    found = {}
    for source, whitened in rows.items():
        times = run.recording.seconds(np.array([stamp for stamp, _ in whitened], dtype=np.int64))
        found[source] = (times, np.array([row for _, row in whitened]))
    return found


def _whitened(fix: PoseFix, published: Sequence[Estimate], source: PoseSource) -> FloatArray:
    """w (3,) against the estimate at the fix's stamp, between the two published about it."""
    first, last = published[0], published[-1]
    span_ns = last.stamp_ns - first.stamp_ns
    share = (fix.stamp_ns - first.stamp_ns) / span_ns if span_ns else 0.0
    step = last.pose - first.pose
    step[YAW] = _wrapped(step[YAW])
    expected = source.to_sensor(Gaussian(first.pose + share * step, first.pose_covariance))
    prepared = source.prepared(fix)
    rows = 3 if source.tells_heading(prepared) else 2
    d = prepared.pose - expected.mean
    d[YAW] = _wrapped(d[YAW])
    D = (expected.covariance + prepared.covariance)[:rows, :rows]
    w = np.full(3, np.nan)
    w[:rows] = np.linalg.solve(np.linalg.cholesky(D), d[:rows])
    return w


def _wrapped(angle: float) -> float:
    """In (−π, π]."""
    return float(np.angle(np.exp(1j * angle)))
