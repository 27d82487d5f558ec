# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Detects implausible pressures: dropped, stuck, swapped, of the wrong sign or unit, beyond relief.

Evidence for each fault is a time: a sample for it adds its duration, a sample against it subtracts it.
Pressures are unused from the first sample for a fault (a stuck one: after ``grace_time``, for gateways
repeat readings). The fault is reported once its evidence reaches ``report_time``, and until it falls to 0.
A sample that one fault explains is no evidence about those after it.

The sum of both pressures drives the machine against its resistance wherever it does not roll downhill, in
turns too. A smaller sum has the wrong unit or sign. Driving straight under an even load, each side bears its
share. Transducers without sign show it only in reverse: both directions have evidence of their own.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.interpolation import Sample

_STRAIGHT, _TURNING = int(Motion.STRAIGHT), int(Motion.TURNING)


class UnusedReason(Enum):
    """Why pressures are not used although no fault is reported."""

    BRIEF = "implausible pressures, too short to report"
    AT_REST = "pressures at standstill too large for an offset: digging, a slope or trapped oil"


class PressureFault(Enum):
    """Faults of the pressures, with their texts in diagnostics."""

    DROPPED = "hydraulics silent, or readings further apart than moments.longest_gap"
    LEFT_STUCK = "left pressure stuck"
    RIGHT_STUCK = "right pressure stuck"
    BEYOND_RELIEF = "pressure above the relief pressure"
    LEFT_LOW = "left pressure far below the right one, driving straight: transducer, sign or unit of one"
    RIGHT_LOW = "right pressure far below the left one, driving straight: transducer, sign or unit of one"
    IN_KPA = "pressure in kPa instead of Pa"
    IN_PSI = "pressure in psi instead of Pa"
    IN_BAR = "pressure in bar instead of Pa"
    IN_MPA = "pressure in MPa instead of Pa"
    TOO_LOW = "too little pressure to drive, in any unit"
    WRONG_SIGN = "pressures brake while the tracks drive: a wrong sign, or a slope that no IMU measures"
    SWAPPED = "left and right pressure swapped"


# For compiled code: index of each in ``PressureFault``
(
    DROPPED,
    _LEFT_STUCK,
    _RIGHT_STUCK,
    _BEYOND_RELIEF,
    _LEFT_LOW,
    _RIGHT_LOW,
    _IN_KPA,
    _IN_PSI,
    _IN_BAR,
    _IN_MPA,
    _TOO_LOW,
    _WRONG_SIGN,
    _SWAPPED,
) = range(13)
_SAME_SPOOLS = 0.1  # relative difference of the spools up to which they ask for no turn
_ZERO_SHARE = 0.005  # ratio to the other pressure up to which a pressure counts as zero, 0.2 bar of 45
NO_FAULT = -1
_RIGHT_UNIT = -2
_UNITS = np.array((1e3, 6894.757, 1e5, 1e6))  # Pa, from kPa to MPa
_FOR, _AGAINST, _OPEN = 1, 0, -1  # evidence of a sample for a fault


class PressureWatch(Record):
    """Evidence for faults, and the newest reading."""

    seconds: Annotated[
        FloatArray, (len(PressureFault), 2)
    ]  # for each fault, less those against: forward, in reverse
    is_reported: Annotated[IntArray, len(PressureFault)]
    reading: Annotated[FloatArray, 2]


@dataclass(frozen=True, kw_only=True)
class WatchParameters(Parameters):
    """Limits of plausible pressures."""

    report_time: float = parameter(
        "duration of the evidence after which a fault is reported", unit="s", gt=0.0
    )
    grace_time: float = parameter("time for which equal readings may be chance", unit="s", ge=0.0)
    least_share: float = parameter(
        "least ratio of a pressure to the other one while driving straight", gt=0.0, lt=1.0
    )
    relief_margin: float = parameter("margin over the relief pressure, as share of it", ge=0.0)
    least_pressure: float = parameter("least sum of both pressures while driving", unit="Pa", gt=0.0)
    typical_pressure: float = parameter(
        "typical pressure over a travel motor while driving", unit="Pa", gt=0.0
    )
    least_speed: float = parameter("track speed above which a track drives", unit="m/s", gt=0.0)
    least_swap_difference: float = parameter(
        "pressure difference in a turn from which swapped sides are detectable", unit="Pa", gt=0.0
    )


def reported_faults(watch: PressureWatch) -> tuple[PressureFault, ...]:
    """Return the faults that are reported at present."""
    return tuple(
        fault for fault, is_reported in zip(PressureFault, watch["is_reported"], strict=True) if is_reported
    )


@compiled
def evaluate_pressures(
    watch: PressureWatch,
    sample: Sample,
    p: WatchParameters,
    relief_pressure: float,
    downhill: bool,
    even: bool,
) -> int:
    """Return the index of the fault that makes the pressures of a sample unusable, or NO_FAULT.

    ``downhill``: whether the weight pulls the machine in the direction in which it moves; ``even``: whether
    both tracks are known to bear about the same weight.
    """
    unusable, likely_unit = NO_FAULT, _OPEN if downhill else _likely_unit(sample, p)
    for fault in range(_SWAPPED + 1):
        if fault == DROPPED:
            evidence = _AGAINST if sample.has_pressures else _FOR
        elif not sample.has_pressures:
            return DROPPED
        elif fault <= _RIGHT_STUCK:
            evidence = _stuck_evidence(watch, fault, sample, p)
        elif fault == _BEYOND_RELIEF:
            highest = max(abs(sample.pressures[0]), abs(sample.pressures[1]))
            evidence = _FOR if highest > (1.0 + p.relief_margin) * relief_pressure else _AGAINST
        elif unusable != NO_FAULT:
            evidence = _OPEN
        elif fault <= _RIGHT_LOW:
            evidence = _OPEN if downhill else _low_evidence(fault - _LEFT_LOW, sample, p, even)
        elif fault == _SWAPPED:
            evidence = _swap_evidence(sample, p)
        elif likely_unit == _OPEN:
            evidence = _OPEN
        else:
            evidence = _FOR if fault == likely_unit else _AGAINST
        if _accumulate_evidence(watch, fault, sample, evidence, p) and unusable == NO_FAULT:
            unusable = fault
    return unusable


@compiled
def _accumulate_evidence(
    watch: PressureWatch, fault: int, sample: Sample, evidence: int, p: WatchParameters
) -> bool:
    """Add the evidence of a sample; return whether the fault makes its pressures unusable."""
    has_direction = fault in (_LEFT_LOW, _RIGHT_LOW, _WRONG_SIGN)
    direction = int(has_direction and sample.tracks[0] + sample.tracks[1] < 0.0)
    seconds = watch.seconds[fault]
    if evidence != _OPEN:
        seconds[direction] += sample.dt if evidence == _FOR else -sample.dt
        seconds[direction] = min(max(seconds[direction], 0.0), p.report_time)
    most = max(seconds[0], seconds[1])
    watch.is_reported[fault] = most > 0.0 and (watch.is_reported[fault] or most >= p.report_time)
    grace = p.grace_time if fault in (_LEFT_STUCK, _RIGHT_STUCK) else 0.0
    return bool(watch.is_reported[fault] or (evidence == _FOR and seconds[direction] > grace))


@compiled
def _stuck_evidence(watch: PressureWatch, fault: int, sample: Sample, p: WatchParameters) -> int:
    """Return the evidence for a stuck transducer: equal readings.

    At standstill readings may be equal, and no change refutes the fault.
    """
    side = fault - _LEFT_STUCK
    reading = sample.reading[side]
    is_equal, watch.reading[side] = reading == watch.reading[side], reading
    if not (abs(sample.tracks[0]) > p.least_speed or abs(sample.tracks[1]) > p.least_speed):
        return _OPEN
    if is_equal:
        return _FOR
    watch.seconds[fault, 0] = 0.0  # a changed reading refutes the fault
    return _OPEN


@compiled
def _low_evidence(side: int, sample: Sample, p: WatchParameters, even: bool) -> int:
    """Return the evidence for a side that drives far less than the other while both drive straight.

    Spools that ask for a turn, which the ground resists, are no evidence. Under an uneven load, as across a
    slope of 15°, one side may bear a tenth of the other, but not nothing.
    """
    left, right = sample.tracks[0], sample.tracks[1]
    difference = abs(sample.spools[0] - sample.spools[1])
    if difference > _SAME_SPOOLS * max(abs(sample.spools[0]), abs(sample.spools[1])):
        return _OPEN
    if sample.motion != _STRAIGHT or min(abs(left), abs(right)) <= p.least_speed or left * right <= 0.0:
        return _OPEN
    forward = math.copysign(1.0, left)
    low, high = forward * sample.pressures[side], forward * sample.pressures[1 - side]
    if high < p.least_pressure:
        return _OPEN
    if low >= p.least_share * high:
        return _AGAINST
    return _FOR if even or abs(low) <= _ZERO_SHARE * high else _OPEN


@compiled
def _likely_unit(sample: Sample, p: WatchParameters) -> int:
    """Return the fault of sign or unit: the unit in which the mean pressure is nearest to the typical one.

    Driving against rolling resistance needs ``least_pressure``; a lower number is in a larger unit, or too
    low in any. _RIGHT_UNIT: the pressures suffice; _OPEN: the tracks do not drive in one direction.
    """
    left, right = sample.tracks[0], sample.tracks[1]
    is_driving = sample.motion == _STRAIGHT or sample.motion == _TURNING
    if not (is_driving and min(abs(left), abs(right)) > p.least_speed and left * right > 0.0):
        return _OPEN
    reading = 0.5 * (abs(sample.pressures[0]) + abs(sample.pressures[1]))
    driving = math.copysign(1.0, left) * (sample.pressures[0] + sample.pressures[1])
    if driving >= p.least_pressure:
        return _RIGHT_UNIT if driving >= reading else _OPEN  # one side brakes
    if 2.0 * reading >= p.least_pressure:
        return _WRONG_SIGN
    if reading <= 0.0:
        return _TOO_LOW
    best = 0
    for unit in range(len(_UNITS)):
        if _log_distance(reading, unit, p) < _log_distance(reading, best, p):
            best = unit
    return _IN_KPA + best if _log_distance(reading, best, p) < math.log(10.0) else _TOO_LOW


@compiled
def _log_distance(reading: float, unit: int, p: WatchParameters) -> float:
    """Return |ln| of the ratio of a reading in a unit to the typical pressure."""
    return abs(math.log(reading * _UNITS[unit] / p.typical_pressure))


@compiled
def _swap_evidence(sample: Sample, p: WatchParameters) -> int:
    """Return the evidence for swapped sides: the faster track of a turn has the larger pressure.

    It slips more, forwards and in reverse. Nearly equal speeds at the start or end of a turn are no evidence:
    the pressures are transient.
    """
    difference = sample.pressures[1] - sample.pressures[0]
    speed_difference = sample.tracks[1] - sample.tracks[0]
    is_turning = sample.motion == _TURNING and abs(speed_difference) > p.least_speed
    if not is_turning or abs(difference) < p.least_swap_difference:
        return _OPEN
    return _FOR if difference * speed_difference < 0.0 else _AGAINST
