# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Events that explain a contradiction, and the states that each one opens; compiled.

The prior probability of an event over a time Δt is its rate times Δt. The rates of a source are its
parameters ``fault_rate`` and ``jump_rate``; the others are those of ``EventParameters``. "Before": just
before the measurement that the event explains. "Since": after the latest consistent measurement.

    event            opens                                               time
    OUTLIER          nothing; this one measurement is left out           at the measurement
    OFFSET           the position offset of a source: two states         before
                     the velocity offset of a source: two states         before, or since
    WANDERS          nothing; its positions drift                        since
    HEADING_OFF      the offset of its headings or swing angles          before
    HEADING_WANDERS  the same offset, which walks                        before, or since
    HEADING_REPEATS  nothing; bit-identical headings of fixes            before
    REPEATS          nothing; bit-identical fixes, angles or velocities  before
                     nothing; the same angle of a swing encoder          since
    STAYS            nothing; fixes that jitter about one position       before, or since
    SCATTERS         nothing; measurements uniform over an area          before
    RECOVERED        nothing; a fault of the source ended                before
    MOVED            x, y                                                before
    TURNED           heading, and the states estimated through it        since
    SWUNG            σ, σ̇ of the upper structure                         since
    SLIPPED          i₀; or i₀, about 1: the machine is stuck            since
                     i₀, and the offset of a coarse receiver             or earlier
    SKIDDED          x, y, by a share of the distance since the latest   before
                     consistent fix
    SLID             i₀, k; on a slope                                   since
    NOISE            noise factor of the source                          since
    FAILED           speed and yaw rate: the sprockets do not measure    since
                     the motion (encoder fault, towed, slides); the
                     same, and the offset of a coarse receiver; or       or earlier
                     i₀: they measure it to a factor; or
                     heading: the gyros do not measure the yaw rate; or
                     i₀: odometry measures another motion; or
                     σ̇: the upper structure swings while the tracks drive
    LATE             delay of all fixes                                  before all of them
    BIASED           bias of the first gyro, and the heading             since
                     the same, and the offset of a coarse receiver       or earlier
    BECAME_JUMP      the offset of the source, which becomes a jump of   before
                     the measured state; of swing angles nothing: the
                     offset stays

Source: Willsky & Jones (1976), a generalised likelihood ratio test for jumps of a state.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from trackslip_common.parameters import Parameters, parameter


class Event(IntEnum):
    """An event of a branch."""

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
    BECAME_JUMP = 12
    SKIDDED = 13
    FAILED = 14
    WANDERS = 15
    BIASED = 16
    STAYS = 17
    HEADING_OFF = 18
    HEADING_WANDERS = 19
    LATE = 20
    HEADING_REPEATS = 21


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
    BECAME_JUMP,
    SKIDDED,
    FAILED,
    WANDERS,
    BIASED,
    STAYS,
    HEADING_OFF,
    HEADING_WANDERS,
    LATE,
    HEADING_REPEATS,
) = map(int, Event)

HEADINGS = 8  # branches of an unknown heading, one for each sector of the circle
ANY_HEADING = math.pi / math.sqrt(3.0)  # rad, standard deviation of a uniform heading
REVERSED = HEADINGS // 2  # ``part``: half a turn
MEASURED = -1  # ``part``: the heading is that of a compass
STUCK = 1  # ``part``: both tracks slip by 100 %
ANGLES = 1  # ``part``: the fault of headings or swing angles ended
HIDDEN = 1  # ``part``: the sprockets failed earlier, which the offset of a coarse receiver hid


@dataclass(frozen=True, kw_only=True)
class EventParameters(Parameters):
    """Prior rates of events."""

    fault_time: float = parameter("mean time that a fault of a source lasts", unit="s", gt=0.0)
    wander_share: float = parameter("rate of fixes that drift, over the source's fault_rate", gt=0.0)
    wander_speed: float = parameter("largest speed of fixes that drift", unit="m/s", gt=0.0)
    wander_walk: float = parameter("random walk of that speed", unit="m/s/√s", gt=0.0)
    heading_walk: float = parameter("random walk of a heading offset", unit="rad/√s", ge=0.0)
    swing_walk: float = parameter("random walk of a swing-angle offset", unit="rad/√s", ge=0.0)
    velocity_stddev: float = parameter("standard deviation of a velocity offset", unit="m/s", gt=0.0)
    velocity_walk: float = parameter("random walk of a velocity offset", unit="m/s/√s", ge=0.0)
    scatter_share: float = parameter("rate of scattered fixes, over the source's fault_rate", gt=0.0)
    heading_rate: float = parameter("rate at which the heading is found to be wrong", unit="1/s", gt=0.0)
    slip_rate: float = parameter("rate at which the common slip changes suddenly", unit="1/s", gt=0.0)
    slide_rate: float = parameter("rate at which the machine slides on a slope", unit="1/s", gt=0.0)
    skid_rate: float = parameter("rate at which the machine skids", unit="1/s", gt=0.0)
    skid_time: float = parameter("largest duration of a skid", unit="s", gt=0.0)
    skid_share: float = parameter("standard deviation of a skid, over the distance meanwhile", gt=0.0)
    skid_stddev: float = parameter(
        "largest stated standard deviation of a fix that shows a skid", unit="m", gt=0.0
    )
    failure_rate: float = parameter("rate at which sprockets, gyros or an odometry fail", unit="1/s", gt=0.0)
    failure_heading: float = parameter(
        "standard deviation of the heading error by gyros that failed", unit="rad", ge=0.0
    )
    swing_rate: float = parameter(
        "rate at which the upper structure begins to swing while the tracks drive", unit="1/s", gt=0.0
    )
    bias_rate: float = parameter("rate at which the bias of a gyro changes suddenly", unit="1/s", gt=0.0)
    bias_stddev: float = parameter("standard deviation of such a change", unit="rad/s", gt=0.0)
    bias_unseen: float = parameter(
        "time in which a changed bias turns the heading before a fix shows it", unit="s", ge=0.0
    )
    late_share: float = parameter("probability that stamps err by more than stamp_error", gt=0.0, lt=1.0)
    late_stddev: float = parameter("standard deviation of such a delay", unit="s", gt=0.0)
    noise_rate: float = parameter("rate at which the noise of a source changes", unit="1/s", gt=0.0)
    slip_stddev: float = parameter("standard deviation of a changed common slip", gt=0.0)
    stuck_share: float = parameter("share of slip changes after which the machine is stuck", gt=0.0, lt=1.0)


def event_rates(
    e: EventParameters, fault_rate: float, jump_rate: float, repeat_jitter: float
) -> Mapping[Event, float]:
    """Event → rate of it, 1/s, by the two rates of a source."""
    return {
        Event.OFFSET: fault_rate,
        Event.HEADING_OFF: fault_rate,
        Event.HEADING_WANDERS: fault_rate,
        Event.HEADING_REPEATS: fault_rate,
        Event.REPEATS: fault_rate,
        Event.STAYS: fault_rate * repeat_jitter,
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
