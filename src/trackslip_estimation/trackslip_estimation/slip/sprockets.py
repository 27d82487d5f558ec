# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Mean speeds of the sprockets in an interval between two samples; compiled.

An interval longer than the timeout has two parts. In the first, as long as the timeout, the speeds of the
previous interval are extrapolated. The rest is *silence*: its speeds are unknown, whatever the positions at
its ends (a restarted driver counts from another origin). The same holds beyond the newest sample. The
variance of extrapolated speeds grows with time, up to that of unknown speeds (``coasting``). Between a start
and a first sample within the timeout, the speeds are those of that sample, with an uncertainty
(``coasting.inflate_start_pose``).

While a branch assumes that the sprockets have failed (``events.FAILED``), all time is silence. While it
assumes that they miscount, the speeds are those measured times ``count_factor``; while it assumes that one
has failed, the speed of its track follows from the other one and a gyro (``one_sprocket``).

Speeds are differences of positions where the positions are continuous; else the speeds of the closing sample.
Both are filtered by their quantisation (``counts``).

    sample    record of ``SAMPLE``: the latest sample, and the speeds of the interval that it closes
    closing   record of ``MEASUREMENT``: the next sample; of another kind where there is none
    c         record of ``config.CONFIG``
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.counts import begin_counts, filter_counts, store_counts
from trackslip_estimation.slip.one_sprocket import set_missing_speed
from trackslip_estimation.slip.records import SPROCKETS, TRACKS
from trackslip_estimation.slip.source_faults import IS_FAILED, count_factor, is_one_failed, is_partly_failed

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.motion import SpeedsRecord
    from trackslip_estimation.slip.records import MeasurementRecord, SprocketSample, State


@compiled
def set_speeds(state: State, closing: MeasurementRecord, stamp_ns: int, c: Config) -> int:
    """Set ``state.speeds`` to the mean speeds up to ``stamp_ns``; returns the end of the known speeds.

    An earlier stamp than ``stamp_ns`` is the start of silence.
    """
    sample, speeds = state.sample, state.speeds
    state.time_since_sample = 0.0
    if state.fault[TRACKS] == IS_FAILED:
        return NEVER_NS
    is_sample = closing.kind == SPROCKETS
    if not sample.seen:  # its stamp is that of the start
        is_in_time = is_sample and closing.stamp_ns - sample.stamp_ns <= c.sprocket_timeout_ns
        return stamp_ns if is_in_time and close_interval(state, closing, c) else NEVER_NS
    if is_sample and closing.stamp_ns - sample.stamp_ns <= c.sprocket_timeout_ns:
        return stamp_ns if close_interval(state, closing, c) else sample.stamp_ns
    if not sample.known:
        return int(sample.stamp_ns)
    _copy_speeds(sample.speeds, speeds)
    if not _correct_speeds(state, c):
        return NEVER_NS
    known_ns = int(min(stamp_ns, sample.stamp_ns + c.sprocket_timeout_ns))
    state.time_since_sample = ((state.stamp_ns - sample.stamp_ns) + (known_ns - sample.stamp_ns)) / 2.0 * 1e-9
    return known_ns


@compiled
def close_interval(state: State, closing: MeasurementRecord, c: Config) -> bool:
    """Set ``state.speeds`` to the mean speeds up to the sample ``closing``; return whether they are known."""
    is_known = _set_interval_speeds(state.sample, closing, c, state.speeds)
    return bool(is_known and _correct_speeds(state, c))


@compiled
def _correct_speeds(state: State, c: Config) -> bool:
    """Correct measured speeds by the fault that the branch assumes; return whether they are known."""
    speeds, fault = state.speeds, state.fault[TRACKS]
    state.one_sprocket = is_one_failed(fault)
    if state.one_sprocket:
        return bool(set_missing_speed(state, speeds, fault, c))
    if is_partly_failed(fault):
        factor = count_factor(fault)
        speeds.left, speeds.right = factor * speeds.left, factor * speeds.right
        speeds.variance *= factor**2
        speeds.angle_variance *= factor**2
    return True


@compiled
def _set_interval_speeds(
    sample: SprocketSample, closing: MeasurementRecord, c: Config, speeds: SpeedsRecord
) -> bool:
    """Set ``speeds`` to the mean speeds between ``sample`` and ``closing``; return whether they are known."""
    left, right, dt = _encoder_speeds(sample, closing, c)
    one_count = c.encoder_resolution / dt if dt > 0.0 else 0.0
    if max(abs(left), abs(right)) > c.max_sprocket_speed + one_count:
        return False
    speeds.left, speeds.right, speeds.variance, speeds.angle_variance = left, right, 0.0, 0.0
    if dt > 0.0:
        estimate = filter_counts(sample.counts, left, right, dt, c)
        speeds.left, speeds.right = estimate.left.mean, estimate.right.mean
        speeds.variance, speeds.angle_variance = estimate.mean_variance, estimate.variance
    return True


@compiled
def shows_standstill(sample: SprocketSample, c: Config) -> bool:
    """Whether the sprocket speeds of a sample count as zero."""
    return bool(max(abs(sample.speeds.left), abs(sample.speeds.right)) <= c.motion_limits.standing_speed)


@compiled
def _encoder_speeds(
    sample: SprocketSample, closing: MeasurementRecord, c: Config
) -> tuple[float, float, float]:
    """Left and right speed of the encoder, rad/s, and their interval, s; 0: no previous sample in time."""
    elapsed_ns = closing.stamp_ns - sample.stamp_ns if sample.seen else 0
    dt = elapsed_ns * 1e-9 if elapsed_ns <= c.sprocket_timeout_ns else 0.0
    if dt > 0.0 and is_continuous(sample, closing, c):
        left, right = closing.left_angle - sample.left_angle, closing.right_angle - sample.right_angle
        return left / dt, right / dt, dt
    return closing.left_speed, closing.right_speed, dt


@compiled
def has_angles(sample: SprocketSample, closing: MeasurementRecord) -> bool:
    """Whether both have positions, with time between them."""
    if not sample.seen or closing.stamp_ns <= sample.stamp_ns:
        return False
    return not (math.isnan(sample.left_angle) or math.isnan(closing.left_angle))


@compiled
def is_continuous(sample: SprocketSample, closing: MeasurementRecord, c: Config) -> bool:
    """Whether the machine can reach the positions of ``closing`` from those of ``sample``, to one count."""
    if not has_angles(sample, closing):
        return False
    left, right = closing.left_angle - sample.left_angle, closing.right_angle - sample.right_angle
    furthest = c.max_sprocket_speed * (closing.stamp_ns - sample.stamp_ns) * 1e-9 + c.encoder_resolution
    return bool(max(abs(left), abs(right)) <= furthest)


@compiled
def has_position_jump(sample: SprocketSample, closing: MeasurementRecord, c: Config) -> bool:
    """Whether the positions of a sample within the timeout are not continuous with the previous ones."""
    is_in_time = has_angles(sample, closing) and closing.stamp_ns - sample.stamp_ns <= c.sprocket_timeout_ns
    return is_in_time and not is_continuous(sample, closing, c)


@compiled
def store_sample(state: State, closing: MeasurementRecord, c: Config) -> None:
    """Store ``closing`` as the latest sample of ``state``."""
    sample = state.sample
    left, right, dt = _encoder_speeds(sample, closing, c)
    sample.known = _set_interval_speeds(sample, closing, c, sample.speeds)
    if sample.known and dt > 0.0:
        store_counts(filter_counts(sample.counts, left, right, dt, c), sample.counts)
    else:
        begin_counts(sample.counts, c)
    sample.seen, sample.stamp_ns = True, closing.stamp_ns
    sample.left_angle, sample.right_angle = closing.left_angle, closing.right_angle


@compiled
def _copy_speeds(source: SpeedsRecord, target: SpeedsRecord) -> None:
    target.left, target.right = source.left, source.right
    target.variance, target.angle_variance = source.variance, source.angle_variance


@compiled
def set_zero_speeds(speeds: SpeedsRecord) -> None:
    """Set speeds and variances to zero."""
    speeds.left = speeds.right = speeds.variance = speeds.angle_variance = 0.0
