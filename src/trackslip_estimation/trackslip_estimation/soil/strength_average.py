# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Averages of samples for the strength posterior, compiled."""

import math
from typing import Annotated

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record
from trackslip_estimation.soil.ground_load import GroundLoad
from trackslip_estimation.soil.interpolation import Sample
from trackslip_estimation.soil.strength_parameters import StrengthParameters
from trackslip_estimation.soil.thrust import ThrustRecord

_FASTEST = 1e6  # m/s, of a track that hardly rolls: larger numbers are no measurement
_LARGEST_THRUST = 1e9  # N


class Average(Record):
    """Average of samples; sums over time until it is complete."""

    dt: float  # s, total of its samples
    tracks: Annotated[FloatArray, 2]  # m/s
    twist: Annotated[FloatArray, 3]
    twist_covariance: Annotated[FloatArray, (3, 3)]
    force: Annotated[FloatArray, 2]  # N, reduced to level ground; nan if unknown
    variance: Annotated[FloatArray, 2]  # N²
    swing_variance: Annotated[FloatArray, 2]  # part by the swing angle, time-correlated
    lean: float  # as in ``ground_load``, like the next three
    lean_stddev: float
    stretch: float
    stretch_stddev: float
    motion: int  # of its last sample, like the pose
    pose: Annotated[FloatArray, 3]
    pose_covariance: Annotated[FloatArray, (3, 3)]


GATHERING, COMPLETE, BROKEN, LOST = range(4)  # results of ``add_sample``


@compiled
def add_sample(
    average: Average, sample: Sample, thrust: ThrustRecord, load: GroundLoad, p: StrengthParameters
) -> int:
    """Add a sample with its thrust and load to an average; return the result.

    COMPLETE: the average is complete and must be cleared before the next sample. BROKEN: the sample is not
    usable. LOST: the motion of the tracks since the previous sample is unknown, too; the average is cleared.
    """
    if not _is_usable(sample, p):
        is_lost = not 0.0 < sample.dt <= p.longest_gap
        if is_lost:
            clear_average(average)
        return LOST if is_lost else BROKEN
    _accumulate(average, sample, thrust, load)
    if average.dt < p.interval * (1.0 - 1e-6):
        return GATHERING
    _finish_average(average, sample)
    return COMPLETE


@compiled
def _is_usable(sample: Sample, p: StrengthParameters) -> bool:
    """Whether a sample is in time, and both track speeds are known; all else is checked as an input."""
    is_known = abs(sample.tracks[0]) < _FASTEST and abs(sample.tracks[1]) < _FASTEST
    return bool(is_known and 0.0 < sample.dt <= p.longest_gap)


@compiled
def clear_average(average: Average) -> None:
    """Set the sums of an average to 0."""
    average.dt = average.lean = average.lean_stddev = average.stretch = average.stretch_stddev = 0.0
    for k in range(2):
        average.tracks[k] = average.force[k] = average.variance[k] = average.swing_variance[k] = 0.0
    for i in range(3):
        average.twist[i] = 0.0
        for j in range(3):
            average.twist_covariance[i, j] = 0.0


@compiled
def _accumulate(average: Average, sample: Sample, thrust: ThrustRecord, load: GroundLoad) -> None:
    """Add a sample, with its thrust divided by the ratio g_j of strength to that on level ground."""
    dt = sample.dt
    average.dt += dt
    average.lean += dt * load.lean
    average.lean_stddev += dt * load.lean_stddev
    average.stretch += dt * load.stretch
    average.stretch_stddev += dt * load.stretch_stddev
    for k in range(2):
        force = thrust.force[k] / load.strength[k]
        average.tracks[k] += dt * sample.tracks[k]
        average.force[k] += dt * (force if thrust.is_known else math.nan)
        variance = thrust.variance[k] + force**2 * load.strength_variance[k]
        average.variance[k] += dt * variance / load.strength[k] ** 2
        average.swing_variance[k] += dt * (force / load.strength[k]) ** 2 * load.swing_variance
    for i in range(3):
        average.twist[i] += dt * sample.twist[i]
        for j in range(3):
            average.twist_covariance[i, j] += dt * sample.twist_covariance[i, j]


@compiled
def _finish_average(average: Average, sample: Sample) -> None:
    """Divide the sums by the time, and set pose and motion from the last sample."""
    dt = average.dt
    average.motion = sample.motion
    average.lean /= dt
    average.lean_stddev /= dt
    average.stretch /= dt
    average.stretch_stddev /= dt
    for k in range(2):
        average.tracks[k] /= dt
        average.force[k] /= dt
        average.variance[k] /= dt
        average.swing_variance[k] /= dt
        is_plausible = (
            0.0 < average.variance[k] < _LARGEST_THRUST**2 and abs(average.force[k]) < _LARGEST_THRUST
        )
        if not is_plausible:
            average.force[k] = math.nan
    for i in range(3):
        average.twist[i] /= dt
        average.pose[i] = sample.pose[i]
        for j in range(3):
            average.twist_covariance[i, j] /= dt
            average.pose_covariance[i, j] = sample.pose_covariance[i, j]
