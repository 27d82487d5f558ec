# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers at the limits of float64: the estimate stays finite and its covariance positive definite."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import random_steps
from trackslip_common.arrays import FloatArray
from trackslip_estimation.nodes.estimator_health import estimator_health
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import to_tree
from trackslip_estimation.slip.measurements import (
    RESET,
    Command,
    Fault,
    HeadingFix,
    Measurement,
    OdometryPose,
    Outcome,
    PoseFix,
    SlipFix,
    Sprockets,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.source_watch import SourceWatch

MS = 1_000_000
S = 1000 * MS
R = np.diag((1e-4, 1e-4, 1e-4))


def fix(stamp_ns: int, covariance: FloatArray = R, x: float = 0.0) -> PoseFix:
    """A fix at ``x`` m ahead of the origin."""
    return PoseFix("box_pose", stamp_ns, np.array((x, 0.0, 0.0)), covariance)


def after_standstill(end_ns: int, **changed: Any) -> SlipEstimator:
    """An estimator after a standstill from 0 s to ``end_ns``."""
    estimator = SlipEstimator(load_slip_parameters(changed))
    found: list[Measurement] = [fix(0)]
    for stamp_ns in range(10 * MS, end_ns + 1, 10 * MS):
        found += [sample(stamp_ns), YawRate("imu/data_raw", stamp_ns, 0.0, 1e-4)]
        found += [fix(stamp_ns)] if stamp_ns % (100 * MS) == 0 else []
    estimator.process_all(found)
    return estimator


def sample(stamp_ns: int) -> Sprockets:
    return Sprockets("sprockets", stamp_ns, 0.0, 0.0, (0.0, 0.0))


def turned(variances: tuple[float, float], degrees: float) -> FloatArray:
    """A covariance of a fix with rotated axes."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    axes = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(axes @ np.diag((*variances, 1e-4)) @ axes.T)


def correlated(variance: float, correlation: float) -> FloatArray:
    """A covariance with one variance in x and y."""
    covariance = np.diag((variance, variance, 1e-4))
    covariance[0, 1] = covariance[1, 0] = correlation * variance
    return covariance


# One episode of each machine; ``make fuzz`` takes 10⁷ steps
@pytest.mark.parametrize("machine", range(len(random_steps.MACHINES)))
def test_random_steps_leave_finite_numbers_and_a_positive_covariance(machine: int) -> None:
    found = random_steps.episode(machine, 600)
    assert found.faults == []
    outcomes = found.outcomes
    assert outcomes[Outcome.ACCEPTED] > 0.5 * outcomes.sum()
    assert outcomes[Outcome.INVALID] > 0.05 * outcomes.sum()


@pytest.mark.parametrize(
    ("covariance", "fault"),
    [
        (correlated(1e12, 1.0), Fault.VARIANCE_OUT_OF_RANGE),
        (turned((1e11, 1e-4), 30.0), Fault.VARIANCE_OUT_OF_RANGE),
        (turned((1e13, 1.0), 30.0), Fault.VARIANCE_OUT_OF_RANGE),
        (turned((1e7, 1e-6), 30.0), Fault.COVARIANCE_NEARLY_SINGULAR),
        (correlated(1.0, 1.0), Fault.COVARIANCE_NEARLY_SINGULAR),
        (correlated(1.0, 1.1), Fault.COVARIANCE_INDEFINITE),
        (np.diag((1.0, 0.0, 1.0)), Fault.VARIANCE_NOT_POSITIVE),
        (np.diag((np.nan, 1.0, 1.0)), Fault.NOT_FINITE),
        (np.diag((np.inf, 1.0, 1.0)), Fault.NOT_FINITE),
    ],
)
def test_ill_conditioned_fix_is_refused_with_its_reason_and_the_next_one_is_used(
    covariance: FloatArray, fault: Fault
) -> None:
    estimator = after_standstill(S)
    before = estimator.window.best[estimator.window.count - 1].tobytes()
    report, _ = estimator.process(fix(S + MS, covariance))
    assert (report.outcome, report.fault) == (Outcome.INVALID, fault)
    assert estimator.window.best[estimator.window.count - 1].tobytes() == before
    report, _ = estimator.process(fix(S + 2 * MS))
    assert (report.outcome, report.fault) == (Outcome.ACCEPTED, None)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0])
def test_fix_with_one_observed_direction_is_used(degrees: float) -> None:
    """A variance of 1e6 m² marks an unobserved direction, such as along a corridor for a laser."""
    estimator = after_standstill(S)
    report, _ = estimator.process(fix(S + MS, turned((1e6, 1e-4), degrees)))
    assert report.outcome is Outcome.ACCEPTED


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        (YawRate("imu/data_raw", S + MS, 101.0, 1e-4), Fault.OUT_OF_RANGE),
        (YawRate("imu/data_raw", S + MS, 0.0, 1e5), Fault.VARIANCE_OUT_OF_RANGE),
        (YawRate("imu/data_raw", S + MS, 0.0, 1e-4, tilt_rates=(1e3, 0.0)), Fault.OUT_OF_RANGE),
        (YawRate("imu/data_raw", S + MS, 0.0, 1e-4, acceleration=(0.0, 0.0, 1e5)), Fault.OUT_OF_RANGE),
        (fix(S + MS, x=1e9), Fault.OUT_OF_RANGE),
    ],
)
def test_motion_impossible_for_a_ground_vehicle_is_refused(given: Measurement, fault: Fault) -> None:
    report, _ = after_standstill(S).process(given)
    assert (report.outcome, report.fault) == (Outcome.INVALID, fault)


EVERY_KIND = {
    "heading_sources": ["heading"],
    "odometry_sources": ["camera"],
    "slip_sources": ["slip_seed"],
    "velocity_sources": ["fix_velocity"],
}


def heading(angle: float, variance: float) -> HeadingFix:
    return HeadingFix("heading", S + MS, angle, variance)


def odometry(
    position: float = 0.0, turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0), variance: float = 0.0
) -> OdometryPose:
    return OdometryPose("camera", S + MS, np.full(3, position), np.array(turn), 7, np.full((2, 3), variance))


def seed(slips: tuple[float, float], covariance: FloatArray) -> SlipFix:
    return SlipFix("slip_seed", S + MS, np.array(slips), covariance)


def velocity(v: tuple[float, float], covariance: FloatArray) -> VelocityFix:
    return VelocityFix("fix_velocity", S + MS, np.array(v), covariance)


@pytest.mark.parametrize(
    "given",
    [
        heading(0.0, 1e-4),
        odometry(),
        seed((0.0, 0.0), 1e-4 * np.eye(2)),
        velocity((0.0, 0.0), 1e-2 * np.eye(2)),
    ],
)
def test_measurement_of_any_kind_is_valid_in_its_plain_form(given: Measurement) -> None:
    report, _ = after_standstill(S, **EVERY_KIND).process(given)
    assert (report.fault, report.outcome is Outcome.INVALID) == (None, False)


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        (heading(math.nan, 1e-4), Fault.NOT_FINITE),
        (heading(math.inf, 1e-4), Fault.NOT_FINITE),
        (heading(0.1, 0.0), Fault.VARIANCE_NOT_POSITIVE),
        (heading(0.1, -1.0), Fault.VARIANCE_NOT_POSITIVE),
        (heading(0.1, math.nan), Fault.NOT_FINITE),
        (odometry(position=math.nan), Fault.NOT_FINITE),
        (odometry(turn=(0.0, 0.0, 0.0, 0.0)), Fault.NO_ROTATION),
        (odometry(turn=(0.0, 0.0, 0.0, 1.2)), Fault.NO_ROTATION),
        (odometry(variance=-1e-6), Fault.VARIANCE_NOT_POSITIVE),
        (odometry(variance=math.nan), Fault.NOT_FINITE),
        (seed((math.nan, 0.0), np.eye(2)), Fault.NOT_FINITE),
        (seed((0.0, math.inf), np.eye(2)), Fault.NOT_FINITE),
        (seed((0.0, 0.0), np.full((2, 2), math.nan)), Fault.NOT_FINITE),
        (seed((0.0, 0.0), np.zeros((2, 2))), Fault.VARIANCE_NOT_POSITIVE),
        (seed((0.0, 0.0), -np.eye(2)), Fault.VARIANCE_NOT_POSITIVE),
        (seed((0.0, 0.0), np.array(((1.0, 2.0), (2.0, 1.0)))), Fault.COVARIANCE_INDEFINITE),
        (velocity((math.nan, 0.0), np.eye(2)), Fault.NOT_FINITE),
        (velocity((200.0, 0.0), np.eye(2)), Fault.OUT_OF_RANGE),
        (velocity((0.0, 0.0), np.zeros((2, 2))), Fault.VARIANCE_NOT_POSITIVE),
        (velocity((0.0, 0.0), np.diag((1.0, 1e6))), Fault.VARIANCE_OUT_OF_RANGE),
        (velocity((0.0, 0.0), np.ones((2, 2))), Fault.COVARIANCE_NEARLY_SINGULAR),
    ],
)
def test_malformed_measurement_of_any_kind_is_refused_by_name(given: Measurement, fault: Fault) -> None:
    report, _ = after_standstill(S, **EVERY_KIND).process(given)
    assert (report.outcome, report.fault) == (Outcome.INVALID, fault)


@pytest.mark.parametrize("variance", [1e-300, 1e-20, 1e-12])
def test_variance_below_what_any_sensor_has_counts_as_the_least(variance: float) -> None:
    estimator = after_standstill(S)
    for given in (
        YawRate("imu/data_raw", S + MS, 0.0, variance),
        fix(S + 2 * MS, np.diag(np.full(3, variance))),
    ):
        assert estimator.process(given)[0].outcome is Outcome.ACCEPTED
        P = estimator.window.best[estimator.window.count - 1]["covariance"][:14, :14]
        assert np.isfinite(P).all()
        assert np.linalg.eigvalsh(P)[0] > 0.0


@pytest.mark.parametrize("start", ["first_fix", "initial_pose"])
@pytest.mark.parametrize("field", ["mean", "covariance"])
def test_estimate_that_is_not_finite_restarts_and_reports_it(field: str, start: str) -> None:
    estimator = after_standstill(S, start=start)
    watch = SourceWatch(estimator.parameters.timeouts_ns())
    estimator.window.best[field][: estimator.window.count] = np.nan
    report, estimate = estimator.process(YawRate("imu/data_raw", S + MS, 0.0, 1e-4))
    watch.add(report)
    assert (report.outcome, estimate, estimator.divergences) == (Outcome.DIVERGED, None, 1)
    health = estimator_health(estimator, watch, 0.0, {})
    assert "not finite" in health.message
    assert health.values["divergences"] == 1
    given = [fix(S + 5 * MS), sample(S + 10 * MS), fix(S + 11 * MS), sample(S + 20 * MS)]
    reports = [estimator.process(measurement) for measurement in given]
    assert reports[2][0].outcome is Outcome.ACCEPTED
    last = reports[-1][1]
    assert last is not None
    assert np.isfinite(last.pose).all()
    assert estimator.divergences == 1


def test_reset_drops_all_states_that_are_not_finite() -> None:
    estimator = after_standstill(S)
    estimator.window.best["mean"][: estimator.window.count] = np.nan
    assert estimator.learned is None  # the state file keeps its content
    estimator.apply_command(Command(RESET))
    for given in (fix(S), sample(S + MS), sample(S + 11 * MS)):
        assert estimator.process(given)[0].outcome is Outcome.ACCEPTED
    assert estimator.learned is not None
    assert estimator.learned.is_finite
    assert np.isfinite(estimator.estimate().pose).all()
    assert "nan" not in str(to_tree(estimator.learned, estimator.learned_context))


def test_replay_of_a_diverged_estimate_ends_with_the_same_bits() -> None:
    """One by one and all at once, from a state that was made to diverge."""
    ends = []
    given = [
        sample(S + 10 * MS),
        fix(S + 11 * MS),
        sample(S + 20 * MS),
        replace(fix(S + 21 * MS), source="box_pose"),
    ]
    for at_once in (False, True):
        estimator = after_standstill(S)
        estimator.window.best["mean"][: estimator.window.count] = np.nan
        steps = estimator.process_all(given) if at_once else [estimator.process(m) for m in given]
        ends.append([report.outcome for report, _ in steps])
        ends.append(estimator.window.best[estimator.window.count - 1].tobytes())
    assert ends[:2] == ends[2:]
