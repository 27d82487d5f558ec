# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the strength posterior (``config/soil_estimator.yaml``)."""

from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class StrengthParameters(Parameters):
    """Grid, errors and memory of ``StrengthPosterior``."""

    lowest_modulus: float = parameter("smallest shear modulus K of the grid", unit="m", gt=0.0)
    highest_modulus: float = parameter("largest K of the grid", unit="m", gt=0.0, le=1.0)
    modulus_cells: int = parameter("cells of the grid over ln K", ge=8, le=256)
    lowest_limit: float = parameter("smallest F_max of the grid, as share of the weight", gt=0.0)
    highest_limit: float = parameter("largest F_max of the grid, as share of the weight", gt=0.0, le=2.0)
    limit_cells: int = parameter("cells of the grid over ln F_max", ge=8, le=256)
    elements: int = parameter("elements of a track's contact", ge=4, le=100)
    interval: float = parameter("time over which samples are averaged", unit="s", gt=0.0, le=1.0)
    longest_gap: float = parameter(
        "time between two samples beyond which the motion of the tracks is unknown", unit="s", gt=0.0
    )
    slowest_track: float = parameter("track speed below which its slip is not used", unit="m/s", gt=0.0)
    correlation_time: float = parameter("correlation time of slip errors in turns", unit="s", gt=0.0)
    slip_bias_stddev: float = parameter(
        "standard deviation of the constant slip error, by the rolling radius", ge=0.0
    )
    correlated_samples: float = parameter("independent samples that share the time-correlated errors", ge=0.0)
    speed_stddev: float = parameter("least standard deviation of v_x and v_y", unit="m/s", gt=0.0)
    yaw_rate_stddev: float = parameter("least standard deviation of the yaw rate", unit="rad/s", gt=0.0)
    thrust_stddev: float = parameter(
        "standard deviation of a thrust by errors of the shear model", unit="N", gt=0.0
    )
    thrust_share_stddev: float = parameter(
        "time-correlated error of the shear model, as share of F_max", ge=0.0
    )
    thrust_scale_stddev: float = parameter(
        "constant relative thrust error, by the efficiency", ge=0.0, lt=1.0
    )
    shortest_straight: float = parameter(
        "shortest straight whose slip distance is evaluated", unit="m", gt=0.0
    )
    longest_straight: float = parameter("length at which a straight is evaluated", unit="m", gt=0.0)
    most_straight_slip: float = parameter("largest mean slip of a straight that is used", gt=0.0, le=1.0)
    distance_stddev: float = parameter(
        "standard deviation of a straight's slip distance by errors of the shear model", unit="m", ge=0.0
    )
    degrees_of_freedom: float = parameter(
        "degrees of freedom of the Student-t errors; few tolerate outliers", ge=1.0
    )
    change_distance: float = parameter("mean distance on one soil", unit="m", gt=0.0)
    widest_ratio: float = parameter("largest ratio of an interval's ends for an identifiable value", gt=1.0)
    edge_ratio: float = parameter("least ratio of an interval's end to that of the grid", gt=1.0)

    def __post_init__(self) -> None:
        """Check each number, then each range."""
        super().__post_init__()
        for name in ("modulus", "limit"):
            low, high = getattr(self, f"lowest_{name}"), getattr(self, f"highest_{name}")
            if not low < high:
                raise InputError(
                    f"StrengthParameters.highest_{name}: {high!r} is refused; accepted: > {low!r}"
                )
