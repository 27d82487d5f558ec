# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Normalised innovations of the measurements, against their gates and their expectation.

ν, S     innovation, its covariance      of the measurement
NIS      νᵀ S⁻¹ ν, χ² with dof degrees of freedom if the filter is consistent
d        pose fix less the estimate published for its stamp, before the fix arrived   m, m, rad
D        covariance of d: the sum of estimate's and fix's                              (3, 3)
w        L⁻¹ d with L Lᵀ = D: unit covariance if both are consistent
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from trackslip_common.arrays import BoolArray, FloatArray, Rows
from trackslip_common.orientations import wrap_angles
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.sources import PoseSource
from trackslip_tools.report.panel import BLUE, GREEN, INK, ORANGE, SIGMAS, Curve, Form, Panel
from trackslip_tools.report.run import Run
from trackslip_tools.report.run_styles import curve_colour

WINDOW = 25  # innovations in a moving mean
_TAIL = 0.025  # of χ², on either side of the band of that mean


class Innovations(NamedTuple):
    """Innovations of one source, in order of arrival."""

    times: FloatArray  # (n,) s from the bag's first message, by stamp
    nis: FloatArray  # (n,)
    gates: FloatArray  # (n,) limit of nis
    freedoms: FloatArray  # (n,) degrees of freedom
    gated: BoolArray  # (n,) gated

    @property
    def mean_ratio(self) -> float:
        """Mean of NIS over mean dof of the accepted measurements: 1 if the filter is consistent."""
        accepted = ~self.gated
        if not accepted.any():
            return float("nan")
        return float(self.nis[accepted].sum() / self.freedoms[accepted].sum())


def innovations_of(run: Run) -> dict[str, Innovations]:
    """Source → innovations of the measurements that were compared with the estimate."""
    reports = run.details.reports
    numbers = np.unique(reports["source"]).tolist()
    by_source = {run.details.sources[k]: reports[reports["source"] == k] for k in numbers}
    return {
        source: Innovations(
            run.recording.seconds(rows["stamp_ns"]),
            rows["nis"],
            rows["gate"],
            rows["dof"].astype(np.float64),
            rows["outcome"] == Outcome.GATED,
        )
        for source, rows in sorted(by_source.items())
    }


def innovation_panels(runs: Sequence[Run]) -> list[Panel]:
    """NIS of each source; for a single run also the whitened differences of its fixes."""
    by_run = [(run, innovations_of(run)) for run in runs]
    panels = []
    for source in sorted({source for _, by_source in by_run for source in by_source}):
        of_source = [(run, by_source[source]) for run, by_source in by_run if source in by_source]
        curves = [*_nis_curves(of_source[0][1])] if len(runs) == 1 else []
        curves.append(_expected_band(of_source[0][1]))
        for run, innovations in of_source:
            label = f"mean of {WINDOW}" if len(runs) == 1 else run.label
            curves.append(_moving_mean(innovations, label, curve_colour(runs, run, INK)))
        title = f"{source}: squared innovations over what is expected"
        panels.append(Panel(title, "NIS / dof", curves, logarithmic=True))
    return panels + (_whitened_panels(runs[0]) if len(runs) == 1 else [])


def _nis_curves(innovations: Innovations) -> Iterator[Curve]:
    """NIS of each measurement, and the gate."""
    ratio = innovations.nis / innovations.freedoms
    order = np.argsort(innovations.times, kind="stable")
    gate = (innovations.gates / innovations.freedoms)[order]
    yield Curve("gate", ORANGE, innovations.times[order], gate, Form.DASHED)
    for label, selected, form in (
        ("accepted", ~innovations.gated, Form.POINTS),
        ("rejected", innovations.gated, Form.CROSSES),
    ):
        if selected.any():
            colour = ORANGE if form is Form.CROSSES else BLUE
            yield Curve(label, colour, innovations.times[selected], ratio[selected], form)


def _expected_band(innovations: Innovations) -> Curve:
    """The expected mean 1, and the 95 % band of moving means of a consistent filter."""
    ends = np.array((innovations.times.min(), innovations.times.max()))
    freedom = WINDOW * float(np.median(innovations.freedoms))
    low, high = (np.full(2, chdtri(freedom, tail) / freedom) for tail in (1.0 - _TAIL, _TAIL))
    return Curve("expected, 95 %", GREEN, ends, np.ones(2), Form.DASHED, (low, high))


def _moving_mean(innovations: Innovations, label: str, colour: str) -> Curve:
    """Moving mean of NIS over accepted measurements, at the last one of each window."""
    accepted = ~innovations.gated
    order = np.argsort(innovations.times[accepted], kind="stable")
    columns = (innovations.nis[accepted][order], innovations.freedoms[accepted][order])
    nis, freedoms = (np.convolve(column, np.ones(WINDOW), mode="valid") for column in columns)
    times = innovations.times[accepted][order][WINDOW - 1 :][: len(nis)]
    return Curve(label, colour, times, nis[: len(times)] / freedoms[: len(times)])


def _whitened_panels(run: Run) -> list[Panel]:
    """Whitened differences of each source of poses."""
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
    """Source → times (n,), and w (n, 3), nan for a heading that is not measured.

    Rejected fixes, fixes before the first estimate, and fixes for whose stamp no estimate was published in
    time are left out.
    """
    fixes = run.details.accepted_fixes
    whitened = {}
    for source, parameters in run.parameters.poses().items():
        numbers = [k for k, name in enumerate(run.details.sources) if name == source]
        of_source = fixes[fixes["expected"] & np.isin(fixes["source"], numbers)]
        if len(of_source):
            times = run.recording.seconds(of_source["stamp_ns"])
            whitened[source] = times, _whiten_differences(of_source, parameters)
    return whitened


def _whiten_differences(fixes: Rows, source: PoseSource) -> FloatArray:
    """w (n, 3): fixes less expected poses, whitened."""
    pose, P = _transform_to_sensor(fixes["pose"], fixes["pose_covariance"], source)
    R = fixes["noise"].copy()
    floors = np.array((source.position_floor, source.position_floor, source.heading_floor))
    diagonal = np.arange(3)
    R[:, diagonal, diagonal] = np.maximum(R[:, diagonal, diagonal], floors**2)
    d = fixes["value"] - pose
    d[:, YAW] = wrap_angles(d[:, YAW])
    has_heading = source.use_heading & (fixes["noise"][:, YAW, YAW] <= source.heading_ceiling**2)
    w = np.full((len(fixes), 3), np.nan)
    for rows, selected in ((3, has_heading), (2, ~has_heading)):
        L = np.linalg.cholesky((P + R)[selected, :rows, :rows])
        w[selected, :rows] = np.linalg.solve(L, d[selected, :rows, np.newaxis])[:, :, 0]
    return w


def _transform_to_sensor(
    poses: FloatArray, P: FloatArray, source: PoseSource
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) poses and covariances (n, 3, 3) of base_link, transformed to the sensor."""
    c, s = np.cos(poses[:, YAW]), np.sin(poses[:, YAW])
    x, y = source.lever[:2]
    offset = np.column_stack((c * x - s * y, s * x + c * y))
    moved, J = poses.copy(), np.tile(np.eye(3), (len(poses), 1, 1))
    moved[:, :2] += offset
    J[:, 0, YAW], J[:, 1, YAW] = -offset[:, 1], offset[:, 0]
    return moved, J @ P @ np.swapaxes(J, 1, 2)
