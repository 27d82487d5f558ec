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
    WANDERS          nothing; its places go off evenly               since the last consistent measurement
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
                     heading: its gyros do not show how it turns; or
                     i₀: an odometry shows another motion
    LATE             delay of all fixes                                  before all of them
    BIASED           bias of the first gyro, and the heading             since the last consistent measurement
                     the same, and the offset of a coarse receiver       or a while ago
    FOLDED           what the source is off by, which becomes a jump of  just before it
                     what it measures; nothing for one of swing angles,
                     which keeps it

Source: Willsky & Jones (1976), a generalised likelihood ratio test for jumps of a state.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from trackslip_common.parameters import Parameters, parameter


class Event(IntEnum):
    """What may have happened."""

    NONE = 0
    OUTLIER = 1
    OFFSET = 2
    REPEATS = 3
    SCATTERS = 4
    RECOVERED = 5
    MOVED = 6
    TURNED = 7
    SWUNG = 8
    SLIPPED = 9
    SLID = 10
    NOISE = 11
    FOLDED = 12
    SKIDDED = 13
    FAILED = 14
    WANDERS = 15
    BIASED = 16
    STAYS = 17
    HEADING_OFF = 18
    HEADING_WANDERS = 19
    LATE = 20


(
    NONE,
    OUTLIER,
    OFFSET,
    REPEATS,
    SCATTERS,
    RECOVERED,
    MOVED,
    TURNED,
    SWUNG,
    SLIPPED,
    SLID,
    NOISE,
    FOLDED,
    SKIDDED,
    FAILED,
    WANDERS,
    BIASED,
    STAYS,
    HEADING_OFF,
    HEADING_WANDERS,
    LATE,
) = map(int, Event)

HEADINGS = 8  # branches of an unknown heading, each for its share of the circle
UNKNOWN_HEADING = 1.0  # rad, standard deviation beyond which a heading is split into ``HEADINGS``
ANY_HEADING = math.pi / math.sqrt(3.0)  # rad, standard deviation of one that may be any
MEASURED = -1  # part of the circle: the one that a compass shows
LOST = 1  # part of what sprockets count: half of it is lost


@dataclass(frozen=True, kw_only=True)
class EventParameters(Parameters):
    """Prior rates of events."""

    fault_time: float = parameter("mean time that a fault of a source lasts", unit="s", gt=0.0)
    repeat_share: float = parameter("rate of frozen fixes, over the source's fault_rate", gt=0.0)
    wander_share: float = parameter("rate of fixes that wander off, over the source's fault_rate", gt=0.0)
    wander_speed: float = parameter("speed at the most of fixes that wander off", unit="m/s", gt=0.0)
    wander_walk: float = parameter("random walk of that speed", unit="m/s/√s", gt=0.0)
    heading_walk: float = parameter("random walk of headings that are off", unit="rad/√s", ge=0.0)
    velocity_stddev: float = parameter("standard deviation of velocities that are off", unit="m/s", gt=0.0)
    velocity_walk: float = parameter("random walk of velocities that are off", unit="m/s/√s", ge=0.0)
    scatter_share: float = parameter("rate of scattered fixes, over the source's fault_rate", gt=0.0)
    heading_rate: float = parameter("rate at which the heading turns out to be wrong", unit="1/s", gt=0.0)
    slip_rate: float = parameter("rate at which the common slip changes suddenly", unit="1/s", gt=0.0)
    slide_rate: float = parameter("rate at which the machine slides on a slope", unit="1/s", gt=0.0)
    skid_rate: float = parameter("rate at which the machine skids", unit="1/s", gt=0.0)
    skid_time: float = parameter("that it lasts at the most", unit="s", gt=0.0)
    skid_share: float = parameter("its standard deviation, over the way meanwhile", gt=0.0)
    skid_stddev: float = parameter("that a fix states at the most which shows a skid", unit="m", gt=0.0)
    failure_rate: float = parameter(
        "rate at which sprockets, gyros or an odometry no longer show the motion", unit="1/s", gt=0.0
    )
    failure_heading: float = parameter(
        "standard deviation of what such gyros turn the heading by unseen", unit="rad", ge=0.0
    )
    bias_rate: float = parameter("rate at which the bias of a gyro changes suddenly", unit="1/s", gt=0.0)
    bias_stddev: float = parameter("standard deviation of such a change", unit="rad/s", gt=0.0)
    bias_unseen: float = parameter(
        "for which a changed bias turned the heading before a fix shows it", unit="s", ge=0.0
    )
    late_share: float = parameter("probability that stamps err by more than they are said to", gt=0.0, lt=1.0)
    late_stddev: float = parameter("standard deviation of such a delay", unit="s", gt=0.0)
    noise_rate: float = parameter("rate at which the noise of a source changes", unit="1/s", gt=0.0)
    slip_stddev: float = parameter("standard deviation of a changed common slip", gt=0.0)


def event_rates(
    e: EventParameters, fault_rate: float, jump_rate: float, repeat_jitter: float
) -> Mapping[Event, float]:
    """1/s of those events of a source that have one, by its own two rates."""
    return {
        Event.OFFSET: fault_rate,
        Event.HEADING_OFF: fault_rate,
        Event.HEADING_WANDERS: fault_rate,
        Event.REPEATS: fault_rate * e.repeat_share,
        Event.STAYS: fault_rate * e.repeat_share * repeat_jitter,
        Event.WANDERS: fault_rate * e.wander_share,
        Event.SCATTERS: fault_rate * e.scatter_share,
        Event.RECOVERED: 1.0 / e.fault_time,
        Event.MOVED: jump_rate,
        Event.TURNED: e.heading_rate,
        Event.SWUNG: e.heading_rate,
        Event.SLIPPED: e.slip_rate,
        Event.SLID: e.slide_rate,
        Event.SKIDDED: e.skid_rate,
        Event.NOISE: e.noise_rate,
        Event.FAILED: e.failure_rate,
        Event.BIASED: e.bias_rate,
    }
