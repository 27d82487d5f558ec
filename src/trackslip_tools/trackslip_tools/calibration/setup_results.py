# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the setup check that complete a calibration, and findings that it contradicts."""

import math
from collections.abc import Mapping, Sequence

from trackslip_estimation.setup_check.finding import MeasuredValue, Result
from trackslip_tools.calibration.finding import Finding, empty_finding, make_finding

_TURNS = ("turning_efficiency", "effective_tread", "asymmetry")
_DISTANCES = ("effective_rolling_radius", "rolling_radius", "common_slip")
_GYRO = ("gyro_sign", "gyro_scale")
_TRACKS = (*_GYRO, *_TURNS, *_DISTANCES, "gyro_delay")
_CONTRADICTED_FINDINGS: Mapping[str, Sequence[str]] = {  # cause → findings that are wrong then
    "tracks_swapped": _TRACKS,
    "left_track_sign": _TRACKS,
    "right_track_sign": _TRACKS,
    "both_tracks_sign": _TRACKS,
    "position_axes_swapped": (*_GYRO, "pose_delay"),
    "position_sign": (*_GYRO, "pose_delay"),
    "heading_convention": (*_GYRO, "pose_delay"),
    "gyro_axis": (*_GYRO, *_TURNS, "gyro_bias"),
    "imu_mounting": (*_GYRO, *_TURNS, "gyro_bias"),
    "gyro_frozen": (*_GYRO, *_TURNS, "gyro_bias", "gyro_delay", "pose_delay"),
    "gyro_unit": (*_GYRO, *_TURNS),
    "speed_unit": (*_TURNS, *_DISTANCES),
    "travel_gear": (*_TURNS, *_DISTANCES),
    "twist_frame": (*_TURNS, *_DISTANCES),
    "time_unit": (*_TRACKS, "gyro_bias", "pose_delay"),
    "missing_value": (*_TURNS, *_DISTANCES),
}


def remove_contradicted(findings: Mapping[str, Finding], setups: Sequence[Result]) -> dict[str, Finding]:
    """The findings, without the values that a mistake of the setup makes wrong."""
    remaining = dict(findings)
    wrong = {
        cause.cause: _CONTRADICTED_FINDINGS.get(cause.cause, ()) for setup in setups for cause in setup.causes
    }
    wrong |= {question.what: _TRACKS for setup in setups for question in setup.open_questions}
    for cause, names in wrong.items():
        for name in names:
            if name in remaining and remaining[name].has_value:
                remaining[name] = empty_finding(f"{cause}: undo it first", remaining[name].unit)
    return remaining


def combine_measured(setups: Sequence[Result]) -> dict[str, Finding]:
    """Lever arms, yaw offsets and delays by source, combined over all bags."""
    groups: dict[str, list[MeasuredValue]] = {}
    for setup in setups:
        for value in setup.measured:
            groups.setdefault(f"{value.name} of {value.source}", []).append(value)
    return {name: _weighted_mean(values) for name, values in groups.items()}


def _weighted_mean(values: Sequence[MeasuredValue]) -> Finding:
    weights = [1.0 / max(measured.half_width, 1e-9) ** 2 for measured in values]
    total = sum(weights)
    value = sum(w * measured.value for w, measured in zip(weights, values, strict=True)) / total
    scatter = sum(w * (measured.value - value) ** 2 for w, measured in zip(weights, values, strict=True))
    spread = math.sqrt(max(1.0, scatter / max(len(values) - 1, 1)) / total)
    basis = "; ".join(dict.fromkeys(measured.basis for measured in values))
    return make_finding(value, spread, values[0].unit, basis)
