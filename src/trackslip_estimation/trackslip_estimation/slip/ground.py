# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that detect a change of ground from consecutive readings."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class GroundParameters(Parameters):
    """Limits for yaw rates by a gyro, and for increments by odometry."""

    against_tracks: float = parameter(
        "largest yaw rate by a gyro against the turn of its tracks, in standard deviations", gt=0.0
    )
    lag: float = parameter(
        "largest yaw rate against the turn of the tracks, over the yaw rate without slip", ge=0.0
    )
    other_turn: float = parameter(
        "change of the yaw rate without slip at which a gyro cannot repeat a reading to the last bit",
        unit="rad/s",
        gt=0.0,
    )
    longer_row: float = parameter(
        "row of equal readings, over the longest earlier one, that shows a frozen gyro", ge=1.0
    )
    agreement: float = parameter(
        "largest difference of consistent yaw rates, over the yaw rate without slip", gt=0.0
    )
    persists: float = parameter(
        "smallest departure of a further reading, over that of the first one", gt=0.0, le=1.0
    )
    increments_time: float = parameter("memory of increments that indicate a slip", unit="s", gt=0.0)
    slowest: float = parameter(
        "track speed below which increments are not used to detect slip", unit="m/s", gt=0.0
    )
    significant: float = parameter(
        "standard deviations beyond which a slip by increments inflates the covariance", gt=0.0
    )
