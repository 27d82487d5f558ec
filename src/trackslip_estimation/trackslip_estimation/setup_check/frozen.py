# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A gyro with readings that stay bit for bit the same while the machine's turn rate changes."""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.drive import HEADING_NOISE, Drive
from trackslip_estimation.setup_check.equal_runs import equal_runs
from trackslip_estimation.setup_check.finding import READ_OFF, Cause
from trackslip_estimation.setup_check.grid import window_sums
from trackslip_estimation.setup_check.log import Gyro

_LEAST_READINGS = 50  # equal readings in a span
_MOST_SPANS = 10  # spans that are examined
_LEAST_TURN = np.radians(40.0)  # of the machine, which the gyro does not show
_LEAST_EFFICIENCY = 0.25  # turning efficiency of the tracks, low as on ice


def frozen_cause(drive: Drive, gyro: Gyro) -> Cause | None:
    """The cause if readings stay bit for bit the same while tracks or headings turn differently."""
    causes = (_judge_span(drive, gyro, *span) for span in frozen_spans(gyro))
    return next((cause for cause in causes if cause is not None), None)


def _judge_span(drive: Drive, gyro: Gyro, begin: float, end: float) -> Cause | None:
    grid = drive.grid
    inside = (grid.edges[:-1] >= begin) & (grid.edges[1:] <= end)
    value = float(gyro.rates[np.searchsorted(gyro.t, begin), 2])
    gyro_turn = window_sums(grid, np.where(inside, value * grid.cell, 0.0))
    difference = window_sums(grid, np.where(inside, grid.tracks[:, 1] - grid.tracks[:, 0], 0.0))
    by_tracks = difference / drive.machine.tread
    by_heading = window_sums(grid, np.where(inside, np.diff(drive.headings), 0.0))
    by_heading = np.where(np.abs(by_heading) <= HEADING_NOISE, 0.0, by_heading)  # nan stays: unknown
    is_by_heading = _unexplained_turn(by_heading, gyro_turn) >= _LEAST_TURN
    if not is_by_heading and _unexplained_turn(by_tracks, gyro_turn) * _LEAST_EFFICIENCY < _LEAST_TURN:
        return None
    also = f", the heading {np.degrees(np.nansum(np.abs(by_heading))):.0f}°" if is_by_heading else ""
    evidence = (
        f"the gyro shows {value:.4g} rad/s without change for {end - begin:.0f} s, while the tracks turn "
        f"{np.degrees(np.nansum(np.abs(by_tracks))):.0f}°{also}"
    )
    without = remedies.parameter("yaw_rate_sources", "[]")
    remedy = f"Check supply and cable of the unit, or leave it out: {without}"
    return Cause("gyro_frozen", gyro.name, evidence, READ_OFF, remedy)


def _unexplained_turn(turns: FloatArray, gyro_turns: FloatArray) -> float:
    """Part of the turns (n,), rad, that no multiple of ``gyro_turns`` (n,) explains.

    A simulated gyro without noise is constant as long as the machine turns evenly.
    """
    usable = np.isfinite(turns)
    turns, gyro_turns = turns[usable], gyro_turns[usable]
    scale = float(turns @ gyro_turns) / max(float(gyro_turns @ gyro_turns), 1e-12)
    return float(min(np.abs(turns).sum(), np.abs(turns - scale * gyro_turns).sum()))


def frozen_spans(gyro: Gyro) -> list[tuple[float, float]]:
    """Spans, s, in which all readings about z are bit for bit the same; by readings, longest first."""
    runs = equal_runs(gyro.rates[:, 2])
    lengths = runs.lengths
    order = [k for k in np.argsort(-lengths, kind="stable")[:_MOST_SPANS] if lengths[k] >= _LEAST_READINGS]
    return [(float(gyro.t[runs.first[k]]), float(gyro.t[runs.last[k]])) for k in order]


def frozen_share(gyro: Gyro) -> float:
    """Share of the gyro's recording in the longest frozen span."""
    spans = frozen_spans(gyro)
    return (spans[0][1] - spans[0][0]) / max(float(gyro.t[-1] - gyro.t[0]), 1e-9) if spans else 0.0
