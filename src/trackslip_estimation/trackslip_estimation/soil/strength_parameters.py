# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of the strength posterior and of the soil classes (``config/soil_estimator.yaml``)."""

from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class StrengthParameters(Parameters):
    """Grid, errors and memory of ``StrengthPosterior``."""

    lowest_modulus: float = parameter("smallest shear modulus K looked for", unit="m", gt=0.0)
    highest_modulus: float = parameter("largest K looked for", unit="m", gt=0.0, le=1.0)
    modulus_cells: int = parameter("cells of the grid over ln K", ge=8, le=256)
    lowest_limit: float = parameter("smallest F_max looked for, as share of the weight", gt=0.0)
    highest_limit: float = parameter("largest F_max looked for, as share of the weight", gt=0.0, le=2.0)
    limit_cells: int = parameter("cells of the grid over ln F_max", ge=8, le=256)
    elements: int = parameter("pieces of a track's contact", ge=4, le=100)
    interval: float = parameter("time over which samples are averaged to one", unit="s", gt=0.0, le=1.0)
    longest_gap: float = parameter(
        "between two samples, beyond which nobody knows what the tracks did meanwhile", unit="s", gt=0.0
    )
    slowest_track: float = parameter("track speed below which its slip is not used", unit="m/s", gt=0.0)
    correlation_time: float = parameter(
        "time after which slip errors in turns are new ones", unit="s", gt=0.0
    )
    slip_bias_stddev: float = parameter("slip error that never averages: rolling radius", ge=0.0)
    correlated_samples: float = parameter("independent samples that share the errors that last", ge=0.0)
    speed_stddev: float = parameter("least standard deviation of v_x and v_y", unit="m/s", gt=0.0)
    yaw_rate_stddev: float = parameter("least standard deviation of the yaw rate", unit="rad/s", gt=0.0)
    thrust_stddev: float = parameter("what the shear model leaves out of a thrust", unit="N", gt=0.0)
    thrust_share_stddev: float = parameter("the same that lasts, as share of F_max", ge=0.0)
    thrust_scale_stddev: float = parameter("thrust error that never averages: efficiency", ge=0.0, lt=1.0)
    shortest_straight: float = parameter(
        "straight from which on its slip distance is evaluated", unit="m", gt=0.0
    )
    longest_straight: float = parameter("straight that is evaluated at once", unit="m", gt=0.0)
    most_straight_slip: float = parameter("mean slip up to which a straight is used", gt=0.0, le=1.0)
    distance_stddev: float = parameter(
        "what the shear model leaves out of a straight's slip distance", unit="m", ge=0.0
    )
    degrees_of_freedom: float = parameter("of the Student-t errors; few forgive outliers", ge=1.0)
    change_distance: float = parameter("mean distance on one soil", unit="m", gt=0.0)
    widest_ratio: float = parameter("upper over lower end of an interval up to which it counts", gt=1.0)
    edge_ratio: float = parameter("of an interval's end to that of the grid, at the least", gt=1.0)

    def __post_init__(self) -> None:
        """Check each number, then each range."""
        super().__post_init__()
        for name in ("modulus", "limit"):
            low, high = getattr(self, f"lowest_{name}"), getattr(self, f"highest_{name}")
            if not low < high:
                raise InputError(
                    f"StrengthParameters.highest_{name}: {high!r} is refused; accepted: > {low!r}"
                )
