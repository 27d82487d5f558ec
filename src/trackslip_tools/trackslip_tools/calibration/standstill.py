# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor offsets at standstill: bias of the gyro, offsets of the pressure transducers."""

from collections.abc import Sequence

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.finding import Finding, empty_finding, make_finding
from trackslip_tools.calibration.recording import Recording, Series
from trackslip_tools.calibration.regression import fit_clustered
from trackslip_tools.calibration.spans import block_numbers, motion_spans

_LEAST_BLOCKS = 3
_CLOSED_SPOOL = 0.02  # share of a spool's stroke
_OUTLIER_SIGMAS = 6.0  # robust standard deviations


def gyro_bias(recordings: Sequence[Recording]) -> Finding:
    """Mean rate of the gyro about its z axis at standstill."""
    return _standstill_mean([(recording, recording.gyro, 2) for recording in recordings], "gyro", "rad/s")


def pressure_offsets(recordings: Sequence[Recording]) -> dict[str, Finding]:
    """Mean pressures at standstill with closed spools.

    A stop may trap oil in the lines: seconds that differ from most are left out. A pressure common to all
    standstills, as on a slope, cannot be distinguished from an offset.
    """
    closed = [(recording, _closed_spool_readings(recording.hydraulics)) for recording in recordings]
    return {
        f"{side}_pressure_offset": _standstill_mean(
            [(r, series, k) for r, series in closed], "hydraulics", "Pa"
        )
        for k, side in enumerate(("left", "right"))
    }


def _closed_spool_readings(hydraulics: Series) -> Series:
    """The readings with both spools closed; readings without spool positions (nan) are kept."""
    t, values = hydraulics
    is_closed = ~(np.abs(values[:, 2:]) > _CLOSED_SPOOL).any(axis=1)
    return Series(t[is_closed], values[is_closed])


def _standstill_mean(series: Sequence[tuple[Recording, Series, int]], sensor: str, unit: str) -> Finding:
    """Mean of a column over standstill seconds without outliers; errors may be correlated within a second."""
    readings, clusters = [], []
    for k, (recording, own, column) in enumerate(series):
        for span in motion_spans(recording, Motion.STANDING, 1.0):
            inside = own.slice_between(*span)
            readings.append(own.values[inside, column])
            clusters.append(block_numbers(own.t[inside], 1.0, k))
    z = np.concatenate(readings) if readings else np.empty(0)
    cluster = np.concatenate(clusters) if clusters else np.empty(0, dtype=np.int64)
    inlier = _is_inlier(z, cluster)
    fit = fit_clustered(np.ones((int(inlier.sum()), 1)), z[inlier], cluster[inlier]) if len(z) else None
    if fit is None or fit.dof < _LEAST_BLOCKS:
        return empty_finding(
            f"the machine does not stand for {_LEAST_BLOCKS} s with its {sensor} recorded", unit
        )
    return make_finding(fit.values[0], fit.half_width(), unit, f"{fit.dof + 1} s of standing")


def _is_inlier(z: FloatArray, cluster: IntArray) -> BoolArray:
    """(n,) whether a reading belongs to a cluster whose mean is no outlier."""
    if not len(z):
        return np.zeros(0, dtype=np.bool_)
    _, index = np.unique(cluster, return_inverse=True)
    means = np.bincount(index, z) / np.bincount(index)
    deviations = np.abs(means - np.median(means))
    inlier: BoolArray = (deviations <= _OUTLIER_SIGMAS * 1.4826 * np.median(deviations))[index]
    return inlier
