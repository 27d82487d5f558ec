# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Events that may explain a contradiction, and the states that each one opens; compiled.

An event has a rate, so its prior probability over a time Δt is about rate · Δt. Rates of a source are its
parameters ``fault_rate`` and ``jump_rate``; the others are those of ``EventParameters``.

    event            opens                                               happened
    OUTLIER          nothing; this one measurement is left out           at the measurement
    OFFSET           the offset of a source's places: two states         just before it
                     the offset of its velocities: two states            just before it, or since the last
                                                                         consistent measurement
    WANDERS          the offset of its places, which begins at zero and  since the last consistent measurement
                     wanders
    HEADING_OFF      the offset of its headings or swing angles          just before it
    HEADING_WANDERS  the same, which goes on to change                   just before it, or since the last
                                                                         consistent measurement
    REPEATS          nothing; bit-identical fixes                        just before it
    STAYS            nothing; fixes that jitter about one place          just before it, or since the last
                                                                         consistent measurement
    SCATTERS         nothing; measurements uniform over an area          just before it
    SOUND            nothing; a fault of the source ended                just before it
    MOVED            x, y                                                just before it
    TURNED           heading, and what was learned through it            since the last consistent measurement
    SWUNG            σ, σ̇ of the upper structure                         since the last consistent measurement
    SLIPPED          i₀                                                  since the last consistent measurement
                     i₀, and the offset of a coarse receiver             or a while ago
    SKIDDED          x, y, by a share of the way since the last          just before it
                     consistent fix
    SLID             i₀, k; on a slope                                   since the last consistent measurement
    NOISE            noise factor of the source                          since the last consistent measurement
    STRAYS           speed and yaw rate: the machine does not move as    since the last consistent measurement
                     its sprockets turn (encoder fault, towed, slides); or
                     i₀, about −1: they count half of the way; or
                     nothing: its gyros do not show how it turns; or
                     i₀: an odometry shows another motion
    BIASED           bias of the first gyro, and the heading             since the last consistent measurement
                     the same, and the offset of a coarse receiver       or a while ago
    FOLDED           the source's offset, which becomes a jump of what   just before it
                     it measures; nothing for one of swing angles,
                     which keeps it

Source: Willsky & Jones (1976), a generalised likelihood ratio test for jumps of a state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import FloatArray
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.single_state import replace_state
from trackslip_estimation.slip.levers import to_sensor
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import (
    DOWNHILL,
    FIX_DELAY,
    GYRO_BIAS,
    GYRO_SCALE,
    SWING,
    SWING_RATE,
    YAW,
    X,
    Y,
)
from trackslip_estimation.slip.models.speed import COMMON_SLIP, ROTATION_OFFSET, SECOND
from trackslip_estimation.slip.own_errors import (
    errors_of,
    number_of,
    to_offset,
    to_shown_heading,
    usual_variance,
)
from trackslip_estimation.slip.records import POSE, TRACKS

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


class Event(IntEnum):
    """What may have happened."""

    NONE = 0
    OUTLIER = 1
    OFFSET = 2
    REPEATS = 3
    SCATTERS = 4
    SOUND = 5
    MOVED = 6
    TURNED = 7
    SWUNG = 8
    SLIPPED = 9
    SLID = 10
    NOISE = 11
    FOLDED = 12
    SKIDDED = 13
    STRAYS = 14
    WANDERS = 15
    BIASED = 16
    STAYS = 17
    HEADING_OFF = 18
    HEADING_WANDERS = 19


class SourceFault(IntEnum):
    """What a branch assumes of a source."""

    SOUND = 0
    OFFSET = 1
    REPEATS = 2
    SCATTERS = 3
    IGNORED = 4  # for one measurement
    STRAYS = 5  # of the sprockets, or of all gyros: they do not show the motion
    STAYS = 6  # where it was, and jitters on
    HEADING_OFF = 7  # its headings are off, not its places
    HEADING_WANDERS = 8  # the same, by something else at any time
    MISCOUNTS = 9  # of the sprockets: they show the motion but for a factor


(
    NONE,
    OUTLIER,
    OFFSET,
    REPEATS,
    SCATTERS,
    SOUND,
    MOVED,
    TURNED,
    SWUNG,
    SLIPPED,
    SLID,
    NOISE,
    FOLDED,
    SKIDDED,
    STRAYS,
    WANDERS,
    BIASED,
    STAYS,
    HEADING_OFF,
    HEADING_WANDERS,
) = map(int, Event)
(
    IS_SOUND,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_IGNORED,
    IS_STRAYING,
    IS_STAYING,
    IS_HEADING_OFF,
    IS_HEADING_WANDERING,
    IS_MISCOUNTING,
) = map(int, SourceFault)

HEADINGS = 8  # branches of an unknown heading, each for its share of the circle
UNKNOWN_HEADING = 1.0  # rad, standard deviation beyond which a heading is split into ``HEADINGS``
ANY_HEADING = math.pi / math.sqrt(3.0)  # rad, standard deviation of one that may be any
AREA = 1e4  # m², of a place of which nothing is known
MEASURED = -1  # part of the circle: the one that a compass shows
LOST = 1  # part of what sprockets count: half of it is lost

_ABOUT_SOURCES = (
    REPEATS,
    STAYS,
    SCATTERS,
    OFFSET,
    WANDERS,
    HEADING_OFF,
    HEADING_WANDERS,
    SOUND,
    FOLDED,
    STRAYS,
)
_LEARNED_BY_HEADING = GYRO_SCALE, FIX_DELAY, SECOND, COMMON_SLIP, ROTATION_OFFSET
_MOST_OPENED = 1 + len(_LEARNED_BY_HEADING)  # states
_SLOPE_STDDEV = 2.0  # of k on a slope on which the machine slides
_STEEP = 0.1  # sine of a slope on which a machine may slide


@dataclass(frozen=True, kw_only=True)
class EventParameters(Parameters):
    """Prior rates of events."""

    fault_time: float = parameter("mean time that a fault of a source lasts", unit="s", gt=0.0)
    repeat_share: float = parameter("rate of frozen fixes, over the source's fault_rate", gt=0.0)
    wander_share: float = parameter("rate of fixes that wander off, over the source's fault_rate", gt=0.0)
    wander: float = parameter("standard deviation of fixes that wander off, at the most", unit="m", gt=0.0)
    wander_speed: float = parameter("speed of fixes that wander, from one to the next", unit="m/s", gt=0.0)
    heading_walk: float = parameter("random walk of headings that are off", unit="rad/√s", ge=0.0)
    velocity_stddev: float = parameter("standard deviation of velocities that are off", unit="m/s", gt=0.0)
    velocity_walk: float = parameter("random walk of velocities that are off", unit="m/s/√s", ge=0.0)
    scatter_share: float = parameter("rate of scattered fixes, over the source's fault_rate", gt=0.0)
    heading_rate: float = parameter("rate at which the heading turns out to be wrong", unit="1/s", gt=0.0)
    slip_rate: float = parameter("rate at which the common slip changes suddenly", unit="1/s", gt=0.0)
    slide_rate: float = parameter("rate at which the machine slides on a slope", unit="1/s", gt=0.0)
    skid_rate: float = parameter("rate at which the machine skids", unit="1/s", gt=0.0)
    skid_share: float = parameter(
        "its standard deviation, over the way since the last consistent fix", gt=0.0
    )
    skid_stddev: float = parameter("that a fix states at the most which shows a skid", unit="m", gt=0.0)
    stray_rate: float = parameter(
        "rate at which sprockets, gyros or an odometry no longer show the motion", unit="1/s", gt=0.0
    )
    bias_rate: float = parameter("rate at which the bias of a gyro changes suddenly", unit="1/s", gt=0.0)
    bias_stddev: float = parameter("standard deviation of such a change", unit="rad/s", gt=0.0)
    bias_unseen: float = parameter(
        "for which a changed bias turned the heading before a fix shows it", unit="s", ge=0.0
    )
    noise_rate: float = parameter("rate at which the noise of a source changes", unit="1/s", gt=0.0)
    slip_stddev: float = parameter("standard deviation of a changed common slip", gt=0.0)


@compiled
def log_rate(event: int, source: int, c: Config) -> float:
    """ln of the rate of an event of a source, 1/s."""
    e = c.events
    if event in (OFFSET, HEADING_OFF, HEADING_WANDERS):
        return math.log(c.fault_rate[source])
    if event == REPEATS:
        return math.log(c.fault_rate[source] * e.repeat_share)
    if event == STAYS:
        return math.log(c.fault_rate[source] * e.repeat_share * c.bank.repeat_jitter)
    if event == WANDERS:
        return math.log(c.fault_rate[source] * e.wander_share)
    if event == SCATTERS:
        return math.log(c.fault_rate[source] * e.scatter_share)
    if event == MOVED:
        return math.log(c.jump_rate[source])
    if event == SLIPPED:
        return math.log(e.slip_rate)
    if event == SLID:
        return math.log(e.slide_rate)
    if event == NOISE:
        return math.log(e.noise_rate)
    if event == SKIDDED:
        return math.log(e.skid_rate)
    if event == STRAYS:
        return math.log(e.stray_rate)
    if event == BIASED:
        return math.log(e.bias_rate)
    if event == SOUND:
        return -math.log(e.fault_time)
    return math.log(e.heading_rate)


@compiled
def wanders(state: State, source: int, c: Config) -> bool:
    """Whether a source is off by what wanders, so that nothing contradicts it as the fault ends."""
    number, fault = number_of(source, c), state.fault[source]
    if fault == IS_OFFSET:
        return bool(number < 0 or state.offsets[number].variance > 0.0)
    return bool(fault == IS_HEADING_WANDERING)


@compiled
def is_heading_off(fault: int) -> bool:
    """Whether a source is assumed to show headings that are off."""
    return fault in (IS_HEADING_OFF, IS_HEADING_WANDERING)


@compiled
def is_trusted(fault: int, kind: int) -> bool:
    """Whether a measurement of a source is taken for sound; places are, though headings of theirs are off."""
    return fault == IS_SOUND or (kind == POSE and is_heading_off(fault))


@compiled
def strays(state: State) -> bool:
    """Whether sprockets, gyros or an odometry are assumed not to show the motion."""
    return bool(((state.fault == IS_STRAYING) | (state.fault == IS_MISCOUNTING)).any())


@compiled
def is_straying(fault: int) -> bool:
    """Whether a unit is assumed not to show the motion, or but for a factor."""
    return fault in (IS_STRAYING, IS_MISCOUNTING)


@compiled
def pass_faults(state: State, dt: float, c: Config) -> None:
    """Headings that wander, and velocities that are off, are so by something else dt later."""
    P = state.covariance
    for source in range(state.fault.size):
        if state.fault[source] == IS_HEADING_WANDERING:
            own = c.yaw_offsets[source]
            P[own, own] += c.events.heading_walk**2 * dt
        elif state.fault[source] == IS_OFFSET and number_of(source, c) < 0:
            for own in (c.offsets[source], c.offsets[source] + 1):
                P[own, own] += c.events.velocity_walk**2 * dt


@compiled
def wander_stddev(state: State, source: int, dt: float, c: Config) -> float:
    """Of fixes of a source that wander, and come dt s after each other, m."""
    time = errors_of(state.offsets[number_of(source, c)], c).time
    return min(c.events.wander_speed * math.sqrt(dt * time / 2.0), c.events.wander)


@compiled
def latest_pose_source(state: State, c: Config) -> int:
    """Number of the source of poses that was consistent last; 0 where there is none."""
    latest = -1
    for k in range(c.offsets.size):
        if number_of(k, c) >= 0 and (latest < 0 or state.consistent_ns[k] > state.consistent_ns[latest]):
            latest = k
    return max(latest, 0)


@compiled
def reach(squared: float) -> float:
    """Standard deviation of a place of which nothing is known but that it may be ``squared`` m² away, m."""
    return math.sqrt(max(AREA / (2.0 * math.pi), squared))


@compiled
def sector(part: int) -> tuple[float, float]:
    """Angle of a share of the circle from its first, rad, and variance inside it, rad²."""
    return 2.0 * math.pi * part / HEADINGS, (math.pi / HEADINGS) ** 2 / 2.0


@compiled
def apply_event(state: State, event: int, source: int, part: int, value: float, c: Config) -> int:
    """Open what an event changes, in a record of ``STATE``; returns the states that are replaced, as bits.

    ``part``: share of the circle; ``MEASURED``: where the source measured the angle ``value``, rad. Of a
    skid, of fixes that are off or wander, and of a machine that was moved it is the standard deviation, m. Of
    a slip and a bias that changed a while ago it is how long, s: an offset of the source took it for its own.
    """
    x, P, renewed, was = state.mean[: c.size], state.covariance[:], 0, state.fault[source]
    lags = event in (SLIPPED, BIASED) and value > 0.0
    _assume(state, event, source, part)
    if event == FOLDED and is_heading_off(was):
        if c.of_swing[source] == 0:  # else its offset is another one from now on
            to_shown_heading(x, P, source, 1.0, c)
            renewed = 1 << YAW
    elif event == FOLDED or lags:
        to_offset(x, P, source, 1.0, c)
        renewed = (1 << X) | (1 << Y)
    elif event == SKIDDED:
        P[X, X] += value * value
        P[Y, Y] += value * value
    if event == BIASED:
        _open_bias(P, max(value, c.events.bias_unseen), c)
    elif event in (SLIPPED, SLID) or (event == STRAYS and source < TRACKS):
        P[COMMON_SLIP, COMMON_SLIP] += c.events.slip_stddev**2
        P[DOWNHILL, DOWNHILL] += _SLOPE_STDDEV**2 if event == SLID else 0.0
    opened = Opened(np.empty(_MOST_OPENED, np.int64), np.empty(_MOST_OPENED), np.empty(_MOST_OPENED))
    count, about = _set_opened(state, event, source, part, value, was, opened, c), -1
    if event == TURNED:
        about = latest_pose_source(state, c) if part == MEASURED else source
        renewed = (1 << X) | (1 << Y)
        to_sensor(x, P, state.attitude.level, about, 1.0, c)
    for i in range(count):
        replace_state(x, P, opened.states[i], opened.means[i], opened.variances[i])
        renewed |= 1 << opened.states[i]
    if event == TURNED:
        to_sensor(x, P, state.attitude.level, about, -1.0, c)
    elif lags:
        to_offset(x, P, source, -1.0, c)
    return renewed


@compiled
def _open_bias(P: FloatArray, unseen: float, c: Config) -> None:
    """The bias of the first gyro, and the heading that it turned for ``unseen`` s; in place."""
    variance = c.events.bias_stddev**2
    P[GYRO_BIAS, GYRO_BIAS] += variance
    P[YAW, YAW] += variance * unseen**2 / 3.0
    P[YAW, GYRO_BIAS] -= variance * unseen / 2.0
    P[GYRO_BIAS, YAW] -= variance * unseen / 2.0


class Opened(NamedTuple):
    """States that an event replaces."""

    states: NDArray[np.int64]
    means: FloatArray
    variances: FloatArray


@compiled
def _assume(state: State, event: int, source: int, part: int) -> None:
    """What a branch assumes of a source from an event on."""
    if event == OUTLIER:
        state.fault[source] = IS_IGNORED
    elif event == NOISE:
        state.adaptation.fix_log_weights[source] = 1e-9
    elif event == MOVED:
        state.rests_on = source
        if state.fault[source] == IS_SCATTERING:
            state.fault_ns[source], state.fault[source] = state.stamp_ns, IS_SOUND
    elif event in _ABOUT_SOURCES:
        state.fault_ns[source], state.fault[source] = state.stamp_ns, IS_SOUND
        if event == REPEATS:
            state.fault[source] = IS_REPEATING
        elif event == STAYS:
            state.fault[source] = IS_STAYING
        elif event == SCATTERS:
            state.fault[source] = IS_SCATTERING
        elif event == STRAYS:
            state.fault[source] = IS_MISCOUNTING if part == LOST else IS_STRAYING
        elif event == HEADING_OFF:
            state.fault[source] = IS_HEADING_OFF
        elif event == HEADING_WANDERS:
            state.fault[source] = IS_HEADING_WANDERING
        elif event in (OFFSET, WANDERS):
            state.fault[source] = IS_OFFSET


@compiled
def _set_opened(
    state: State, event: int, source: int, part: int, value: float, was: int, opened: Opened, c: Config
) -> int:
    """States that an event replaces, their means and variances; how many. ``was``: fault of the source."""
    states, means, variances = opened
    x, count, own = state.mean, 0, c.offsets[source]
    begins = event in (HEADING_OFF, HEADING_WANDERS)
    ends = event == SOUND or (event == FOLDED and c.of_swing[source] == 0)
    if event == WANDERS:
        count, state.offsets[number_of(source, c)].variance = 2, value * value
        for i in range(count):
            states[i], means[i], variances[i] = own + i, 0.0, 0.0
    elif begins or (ends and is_heading_off(was)):
        count, states[0], means[0] = 1, c.yaw_offsets[source], 0.0
        variances[0] = ANY_HEADING**2 if begins else c.prior_variance[states[0]]
    elif own >= 0 and (event in (OFFSET, SOUND, FOLDED) or (event in (SLIPPED, BIASED) and value > 0.0)):
        count, usual, number = 2, 0.0, number_of(source, c)
        if number >= 0:
            usual = usual_variance(state, source, c)
            state.offsets[number].variance = 0.0 if event == OFFSET else usual
        for i in range(count):
            states[i], means[i], variances[i] = own + i, 0.0, value * value if event == OFFSET else usual
    elif source == TRACKS and (was == IS_MISCOUNTING or part == LOST):
        count, states[0], means[0] = 1, COMMON_SLIP, -1.0 if part == LOST else c.prior_mean[COMMON_SLIP]
        variances[0] = c.events.slip_stddev**2
    elif event == MOVED:
        count = 2
        for i in (X, Y):
            states[i], means[i], variances[i] = i, x[i], value * value
    elif event == TURNED:
        turn, variance = sector(part) if part != MEASURED else (0.0, (math.pi / HEADINGS) ** 2)
        about, state.is_sector = source, part != MEASURED
        if part == MEASURED:
            turn, about = wrap(value - c.heading_offset[source] - x[YAW]), latest_pose_source(state, c)
        swing = x[SWING] if c.above[about] == 1 else 0.0
        count, states[0], means[0], variances[0] = 1, YAW, wrap(x[YAW] + turn + swing), variance
        if has_velocity_errors(c):
            for q in _LEARNED_BY_HEADING:
                states[count], means[count], variances[count] = q, c.prior_mean[q], c.prior_variance[q]
                count += 1
    elif event == SWUNG:
        turn, variance = sector(max(part, 0))
        if part == MEASURED:
            turn = wrap(value - c.heading_offset[source] - x[SWING])
        states[0], means[0], variances[0] = SWING, wrap(x[SWING] + turn), variance
        count, states[1], means[1], variances[1] = 2, SWING_RATE, 0.0, c.swing.fastest**2
    return count


@compiled
def is_steep(state: State) -> bool:
    """Whether the ground is so steep that the machine may slide."""
    level = state.attitude.level
    return bool(level.tilted == 1 and level.downhill_x**2 + level.downhill_y**2 > _STEEP**2)
