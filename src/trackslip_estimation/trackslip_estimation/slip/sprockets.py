# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the sprockets did in an interval, from the samples around it; compiled.

An interval lies between two samples. Where it is longer than the timeout, its first part (as long as the
timeout) is taken to go on as the interval before; the rest is *silence*: how fast the sprockets turned in it
is unknown, whatever the positions at its ends say (a driver that was restarted counts from elsewhere). Beyond
the newest sample it is the same. The longer speeds are taken to go on, the more they may have changed, up to
what silence leaves of them (``coasting``). Between a start and the first sample, where that comes within the
timeout, the speeds are those that it shows, and may have been others (``coasting.widen_start``).

While a branch assumes that the machine does not move as its sprockets turn (``events.FAILED``), all is
silence.

Speeds come from the difference of positions where there are positions and they do not jump; else from the
speeds of the sample that closes the interval. Either are counted (``counts``), by the angle of a count.

    sample    record of ``SAMPLE``: the last sample, and the speeds of the interval that it closes
    closing   record of ``MEASUREMENT``: the next sample; of another kind where there is none
    c         record of ``config.CONFIG``
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.counts import begin_counts, follow, keep
from trackslip_estimation.slip.records import SPROCKETS, TRACKS
from trackslip_estimation.slip.source_faults import IS_FAILED

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.motion import SpeedsRecord
    from trackslip_estimation.slip.records import MeasurementRecord, SprocketSample, State


@compiled
def set_speeds(state: State, closing: MeasurementRecord, stamp_ns: int, c: Config) -> int:
    """Mean speeds up to ``stamp_ns`` into ``state.speeds``; returns the stamp until which they are known.

    That is ``stamp_ns``, or an earlier one beyond which there is silence.
    """
    sample, speeds = state.sample, state.speeds
    state.time_since_sample = 0.0
    if state.fault[TRACKS] == IS_FAILED:
        return NEVER_NS
    closed = closing.kind == SPROCKETS
    if not sample.seen:  # its stamp is that of the start
        in_time = closed and closing.stamp_ns - sample.stamp_ns <= c.sprocket_timeout_ns
        return stamp_ns if in_time and interval_speeds(sample, closing, c, speeds) else NEVER_NS
    if closed and closing.stamp_ns - sample.stamp_ns <= c.sprocket_timeout_ns:
        return stamp_ns if interval_speeds(sample, closing, c, speeds) else sample.stamp_ns
    if not sample.known:
        return int(sample.stamp_ns)
    _copy(sample.speeds, speeds)
    known_ns = int(min(stamp_ns, sample.stamp_ns + c.sprocket_timeout_ns))
    state.time_since_sample = ((state.stamp_ns - sample.stamp_ns) + (known_ns - sample.stamp_ns)) / 2.0 * 1e-9
    return known_ns


@compiled
def interval_speeds(
    sample: SprocketSample, closing: MeasurementRecord, c: Config, speeds: SpeedsRecord
) -> bool:
    """Mean speeds between ``sample`` and ``closing`` into ``speeds``; whether they are known."""
    left, right, dt = _shown(sample, closing, c)
    a_count = c.encoder_resolution / dt if dt > 0.0 else 0.0
    if max(abs(left), abs(right)) > c.max_sprocket_speed + a_count:
        return False
    speeds.left, speeds.right, speeds.variance, speeds.angle_variance = left, right, 0.0, 0.0
    if dt > 0.0:
        followed = follow(sample.counts, left, right, dt, c)
        speeds.left, speeds.right = followed.left.mean, followed.right.mean
        speeds.variance, speeds.angle_variance = followed.mean_variance, followed.variance
    return True


@compiled
def _shown(sample: SprocketSample, closing: MeasurementRecord, c: Config) -> tuple[float, float, float]:
    """Left and right speed by the encoder, rad/s, and over which time, s; 0: ``closing`` continues none."""
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
    """Whether the positions of ``closing`` are the continuation of those of ``sample``, to a count."""
    if not has_angles(sample, closing):
        return False
    left, right = closing.left_angle - sample.left_angle, closing.right_angle - sample.right_angle
    furthest = c.max_sprocket_speed * (closing.stamp_ns - sample.stamp_ns) * 1e-9 + c.encoder_resolution
    return bool(max(abs(left), abs(right)) <= furthest)


@compiled
def jumps(sample: SprocketSample, closing: MeasurementRecord, c: Config) -> bool:
    """Whether its positions are not the continuation of those before, though it came in time."""
    in_time = has_angles(sample, closing) and closing.stamp_ns - sample.stamp_ns <= c.sprocket_timeout_ns
    return in_time and not is_continuous(sample, closing, c)


@compiled
def store_sample(state: State, closing: MeasurementRecord, c: Config) -> None:
    """Makes ``closing`` the last sample of ``state``."""
    sample = state.sample
    left, right, dt = _shown(sample, closing, c)
    sample.known = interval_speeds(sample, closing, c, sample.speeds)
    if sample.known and dt > 0.0:
        keep(follow(sample.counts, left, right, dt, c), sample.counts)
    else:
        begin_counts(sample.counts, c)
    sample.seen, sample.stamp_ns = True, closing.stamp_ns
    sample.left_angle, sample.right_angle = closing.left_angle, closing.right_angle


@compiled
def _copy(source: SpeedsRecord, target: SpeedsRecord) -> None:
    target.left, target.right = source.left, source.right
    target.variance, target.angle_variance = source.variance, source.angle_variance


@compiled
def set_zero_speeds(speeds: SpeedsRecord) -> None:
    """No motion."""
    speeds.left = speeds.right = speeds.variance = speeds.angle_variance = 0.0
