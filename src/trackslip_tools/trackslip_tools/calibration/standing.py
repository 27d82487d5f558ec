# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor offsets at standstill: bias of the gyro, offsets of the pressure transducers."""

from collections.abc import Sequence

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.finding import Finding, found, refused
from trackslip_tools.calibration.recording import Recording, Series
from trackslip_tools.calibration.regression import clustered
from trackslip_tools.calibration.spans import blocks, spans

_LEAST_BLOCKS = 3
_CLOSED = 0.02  # share of a spool's stroke
_ODD = 6.0  # robust standard deviations


def gyro_bias(recordings: Sequence[Recording]) -> Finding:
    """Mean rate of the gyro about its z axis at standstill."""
    return _at_rest([(recording, recording.gyro, 2) for recording in recordings], "gyro", "rad/s")


def pressure_offsets(recordings: Sequence[Recording]) -> dict[str, Finding]:
    """Mean pressures at standstill with closed spools.

    A stop may trap oil in the lines: seconds that differ from most are left out. A pressure common to all
    standstills, as on a slope, cannot be distinguished from an offset.
    """
    closed = [(recording, _closed(recording.hydraulics)) for recording in recordings]
    return {
        f"{side}_pressure_offset": _at_rest([(r, series, k) for r, series in closed], "hydraulics", "Pa")
        for k, side in enumerate(("left", "right"))
    }


def _closed(hydraulics: Series) -> Series:
    """The readings with both spools closed; readings without spool positions (nan) are kept."""
    t, values = hydraulics
    kept = ~(np.abs(values[:, 2:]) > _CLOSED).any(axis=1)
    return Series(t[kept], values[kept])


def _at_rest(series: Sequence[tuple[Recording, Series, int]], sensor: str, unit: str) -> Finding:
    """Mean of a column over standstill seconds without outliers; errors may be correlated within a second."""
    readings, clusters = [], []
    for k, (recording, own, column) in enumerate(series):
        for span in spans(recording, Motion.STANDING, 1.0):
            inside = own.between(*span)
            readings.append(own.values[inside, column])
            clusters.append(blocks(own.t[inside], 1.0, k))
    z = np.concatenate(readings) if readings else np.empty(0)
    cluster = np.concatenate(clusters) if clusters else np.empty(0, dtype=np.int64)
    usual = _usual(z, cluster)
    fit = clustered(np.ones((int(usual.sum()), 1)), z[usual], cluster[usual]) if len(z) else None
    if fit is None or fit.dof < _LEAST_BLOCKS:
        return refused(f"the machine does not stand for {_LEAST_BLOCKS} s with its {sensor} recorded", unit)
    return found(fit.values[0], fit.spread(), unit, f"{fit.dof + 1} s of standing")


def _usual(z: FloatArray, cluster: IntArray) -> BoolArray:
    """(n,) whether a reading belongs to a cluster whose mean is no outlier."""
    if not len(z):
        return np.zeros(0, dtype=np.bool_)
    _, of = np.unique(cluster, return_inverse=True)
    means = np.bincount(of, z) / np.bincount(of)
    away = np.abs(means - np.median(means))
    usual: BoolArray = (away <= _ODD * 1.4826 * np.median(away))[of]
    return usual
