# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the hypothesis bank and of time-correlated fix errors: odds, sizes and times."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class BankParameters(Parameters):
    """When a branch gets children or is pruned; when a measurement is an outlier."""

    pruned: float = parameter("ln of the odds against a branch, beyond which it is pruned", gt=0.0)
    least_healthy: float = parameter("largest ln of the odds against the last branch without a fault", gt=0.0)
    merge_distance: float = parameter(
        "mean squared difference of two branches below which they merge, over the sum of their variances",
        gt=0.0,
    )
    spawns: float = parameter(
        "ln of the odds against a branch, beyond which its children only end a fault of the measured source",
        gt=0.0,
    )
    steps: int = parameter("steps that all children of one measurement may repeat", ge=1)
    child_time: float = parameter(
        "time that they may repeat instead, if that is more: at high rates of the sensors", unit="s", gt=0.0
    )
    cusum_drift: float = parameter("drift of the CUSUM of innovations, in standard deviations", gt=0.0)
    cusum_limit: float = parameter("CUSUM beyond which a branch gets children", gt=0.0)
    cusum_largest: float = parameter(
        "largest contribution of one innovation to the CUSUM, in standard deviations", gt=0.0
    )
    cusum_calm: float = parameter("CUSUM below which a measurement is consistent with a branch", gt=0.0)
    look_back: int = parameter("largest number of fixes since the start of a child", ge=1)
    look_back_time: float = parameter("longest time before now at which children start", unit="s", gt=0.0)
    shortest_time: float = parameter("shortest time in the prior of an event", unit="s", gt=0.0)
    slip_excess: float = parameter("standard deviation of the common slip outside its range", gt=0.0)
    least_distance: float = parameter(
        "shortest track distance that makes heading and slip observable by positions", unit="m", ge=0.0
    )
    often_outliers: float = parameter(
        "share of outliers above which a first contradicting measurement is an outlier", gt=0.0, lt=1.0
    )
    correlated_penalty: float = parameter(
        "ln of the odds against an event of the machine while errors of fixes are time-correlated", ge=0.0
    )
    least_jump: float = parameter("smallest size of a jump or an offset", unit="m", gt=0.0)
    outlier_sizes: float = parameter(
        "ln of the largest over the smallest error of an outlier: the logarithm of its size is uniform",
        gt=0.0,
    )
    share_memory: float = parameter(
        "weight of one measurement in the running share of outliers", gt=0.0, lt=1.0
    )
    outlier_share: float = parameter(
        "value that an outlier contributes to the running share of outliers", gt=0.0, lt=1.0
    )
    healthy_share: float = parameter(
        "value that a sound measurement contributes to the running share of outliers", gt=0.0, lt=1.0
    )
    repeat_stddev: float = parameter(
        "standard deviation of a repeated fix, or velocity, from the previous one", unit="m", gt=0.0
    )
    repeat_jitter: float = parameter("share of frozen sources whose fixes still jitter", gt=0.0, lt=1.0)
    longest_interval: float = parameter(
        "longest time between fixes for an estimate of the track error", unit="s", gt=0.0
    )
    initial_outlier_share: float = parameter(
        "initial share of outliers of a source, and probability of a rejected yaw rate or odometry",
        gt=0.0,
        lt=1.0,
    )
    least_slip: float = parameter(
        "smallest common slip: on level ground a machine hardly moves faster than its tracks"
    )
    most_slip: float = parameter("largest common slip on a slope, or where the tilt is unknown; else 1")


@dataclass(frozen=True, kw_only=True)
class ReceiverParameters(Parameters):
    """Time-correlated errors of fixes."""

    precise: float = parameter("largest stated standard deviation of a precise fix", unit="m", gt=0.0)
    floating: float = parameter(
        "standard deviation below which a fix that is not precise has float ambiguities", unit="m", gt=0.0
    )
    other_quality: float = parameter(
        "ratio of two stated standard deviations above which they belong to different solutions", gt=1.0
    )
    longest_time: float = parameter(
        "longest time constant of an offset: a longer error is part of the position", unit="s", gt=0.0
    )
    memory: float = parameter(
        "share of the log-weights of a receiver's error models that remains at the next fix", gt=0.0, lt=1.0
    )
    most_odds: float = parameter(
        "largest ln of the odds that errors of precise fixes stay of the same kind", gt=0.0
    )
    jump: float = parameter(
        "two-dimensional NIS beyond which precise fixes jumped and do not update their error model",
        gt=0.0,
    )
    least_rest: float = parameter(
        "share of the stated variance beyond the white part, above which it is time-correlated",
        gt=0.0,
        lt=1.0,
    )
    interval: float = parameter(
        "shortest time between fixes that update the error model, once errors are correlated",
        unit="s",
        ge=0.0,
    )
    distance_error: float = parameter(
        "random walk of the predicted displacement, over the speed", unit="√s", ge=0.0
    )
    displacement_walk: float = parameter(
        "random walk of the predicted displacement at any speed", unit="m/√s", ge=0.0
    )
    direction_error: float = parameter(
        "error of the predicted displacement's direction beyond those of heading and slip",
        unit="rad",
        ge=0.0,
    )
    direction_time: float = parameter("correlation time of that direction's error", unit="s", gt=0.0)
    most_spread: float = parameter(
        "variance of the heading beyond which a predicted displacement is unknown", unit="rad²", gt=0.0
    )
    observed: float = parameter(
        "observation time, over its time constant, before a coarse receiver may correct the gyro bias",
        ge=0.0,
    )
    most_correlated: float = parameter(
        "largest time-correlated share of the variance of precise fixes: stamps also have errors",
        gt=0.0,
        lt=1.0,
    )
    white_odds: float = parameter("ln of the prior odds of white errors of precise fixes", ge=0.0)
    precise_time: float = parameter("correlation time of errors of precise fixes", unit="s", gt=0.0)
    largest_inflation: float = parameter(
        "largest variance of an offset after inflation by large innovations, over its prior", gt=1.0
    )
