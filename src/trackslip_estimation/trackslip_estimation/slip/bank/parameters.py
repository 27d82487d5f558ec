# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers by which explanations compete: odds, sizes and times."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class BankParameters(Parameters):
    """When a branch has children, and how long it stays; when a measurement is an outlier."""

    pruned: float = parameter("ln of the odds against a branch that is pruned", gt=0.0)
    least_healthy: float = parameter(
        "ln of the odds against the last branch without a fault at the most", gt=0.0
    )
    merge_distance: float = parameter(
        "mean squared distance of two branches that are one, over the sum of their variances", gt=0.0
    )
    spawns: float = parameter("ln of the odds against a branch that has no children", gt=0.0)
    steps: int = parameter("that children may make at one measurement: 10 ms", ge=1)
    cusum_drift: float = parameter("of the CUSUM of innovations, in standard deviations", gt=0.0)
    cusum_limit: float = parameter("CUSUM beyond which a branch has children", gt=0.0)
    cusum_largest: float = parameter("standard deviations of one innovation in the CUSUM at the most", gt=0.0)
    cusum_calm: float = parameter("CUSUM below which a measurement agrees", gt=0.0)
    look_back: int = parameter("measurements, of which one began whatever shows now", ge=1)
    look_back_time: float = parameter("for which a branch looks back at the most", unit="s", gt=0.0)
    shortest_time: float = parameter("in which an event may have happened at the least", unit="s", gt=0.0)
    slip_excess: float = parameter("standard deviation by which the common slip may leave its range", gt=0.0)
    least_distance: float = parameter(
        "by the tracks, with which heading and slip show in the place", unit="m", ge=0.0
    )
    often_outliers: float = parameter(
        "share of outliers of a source that has had some recently", gt=0.0, lt=1.0
    )
    correlated_penalty: float = parameter(
        "ln of the odds against an event of the machine where fixes err to one side", ge=0.0
    )
    least_jump: float = parameter("size of a jump or an offset at the least", unit="m", gt=0.0)
    outlier_sizes: float = parameter(
        "ln of the largest over the smallest error of an outlier: any size is as likely, by its logarithm",
        gt=0.0,
    )
    share_memory: float = parameter("of a measurement in the share of outliers", gt=0.0, lt=1.0)
    outlier_share: float = parameter("share of outliers that an outlier shows", gt=0.0, lt=1.0)
    healthy_share: float = parameter("share of outliers that a sound measurement shows", gt=0.0, lt=1.0)
    repeat_stddev: float = parameter("of a fix that repeats the one before", unit="m", gt=0.0)
    repeat_jitter: float = parameter("share of frozen sources whose fixes jitter on", gt=0.0, lt=1.0)
    longest_interval: float = parameter("between fixes that show what tracks err by", unit="s", gt=0.0)
    initial_outlier_share: float = parameter(
        "share of outliers of a source that nothing is known of", gt=0.0, lt=1.0
    )
    least_slip: float = parameter("common slip at the least: tracks are hardly outrun on the flat")
    most_slip: float = parameter("common slip at the most")


@dataclass(frozen=True, kw_only=True)
class ReceiverParameters(Parameters):
    """How errors of fixes last."""

    precise: float = parameter("standard deviation that a precise fix states at the most", unit="m", gt=0.0)
    floating: float = parameter(
        "standard deviation of the worse of those whose ambiguities float", unit="m", gt=0.0
    )
    other_quality: float = parameter("ratio of two standard deviations that are not of one solution", gt=1.0)
    longest_time: float = parameter(
        "time constant of an offset at the most: what errs for longer is a part of the place",
        unit="s",
        gt=0.0,
    )
    memory: float = parameter("of what is known of a receiver, from one fix to the next", gt=0.0, lt=1.0)
    most_odds: float = parameter(
        "ln of the odds at the most that errors of precise fixes remain of the kind that they were", gt=0.0
    )
    jump: float = parameter(
        "squared standard deviations, of two numbers, beyond which precise fixes jumped and show no error",
        gt=0.0,
    )
    least_rest: float = parameter(
        "share of what precise fixes state and do not jitter by, from which on it lasts", gt=0.0, lt=1.0
    )
    interval: float = parameter(
        "between fixes that are learned from, once errors are correlated", unit="s", ge=0.0
    )
    distance_error: float = parameter("of the way driven, random walk", unit="√s", ge=0.0)
    displacement_walk: float = parameter("random walk of the way while nothing drives", unit="m/√s", ge=0.0)
    direction_error: float = parameter("by which the way errs beyond heading and slip", unit="rad", ge=0.0)
    direction_time: float = parameter("for which it does", unit="s", gt=0.0)
    most_spread: float = parameter(
        "variance of the heading beyond which no way is known", unit="rad²", gt=0.0
    )
    observed: float = parameter(
        "times its time constant, after which a coarse receiver may correct the bias of a gyro", ge=0.0
    )
    most_correlated: float = parameter(
        "share of what precise fixes state that lasts, at the most: their times err, too", gt=0.0, lt=1.0
    )
    white_odds: float = parameter("ln of the odds that errors of precise fixes are white", ge=0.0)
    precise_time: float = parameter("for which an error of precise fixes lasts", unit="s", gt=0.0)
    largest_inflation: float = parameter(
        "variance of an offset at the most by fixes that surprise, over its prior", gt=1.0
    )
