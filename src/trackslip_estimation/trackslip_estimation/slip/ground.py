# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""When readings in a row show that the ground has become another one."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class GroundParameters(Parameters):
    """Of yaw rates by a gyro, and of increments by odometry."""

    against_tracks: float = parameter("standard deviations that a gyro may show against its tracks", gt=0.0)
    lag: float = parameter(
        "of the yaw rate without slip, by which the machine may still turn the other way", ge=0.0
    )
    agreement: float = parameter(
        "of the yaw rate without slip, by which readings that agree may differ", gt=0.0
    )
    persists: float = parameter(
        "share of the first reading's departure that a further one must have", gt=0.0, le=1.0
    )
    increments_time: float = parameter("for which increments count that agree", unit="s", gt=0.0)
    slowest: float = parameter("speed of the tracks below which increments show no slip", unit="m/s", gt=0.0)
    significant: float = parameter("standard deviations by which a slip by increments differs", gt=0.0)
