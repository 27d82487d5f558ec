# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A gyro that repeats one reading to the last bit while the machine turns."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, Recording, drive, parameters
from fixtures.fault_cases.case import seconds

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, Sprockets, YawRate

BEGIN, END = 20.0, 32.0  # s
RADIUS = parameters().vehicle.kinematics.rolling_radius
DIGIT = 0.00175  # rad/s, 0.1 °/s
FAILED = "gyro and motion disagree"

Change = Callable[[YawRate], float]


def recorded(**changed: float) -> Recording:
    return drive(Machine(duration=45.0, track_error=0.03, **changed))


def with_readings(
    recording: Recording, change: Change, begin: float = 0.0, end: float = math.inf
) -> list[Measurement]:
    """The drive with changed readings of the gyro from begin to end, s."""
    return [
        replace(m, rate=change(m)) if isinstance(m, YawRate) and begin <= seconds(m) < end else m
        for m in recording.measurements
    ]


def rejected(measurements: list[Measurement], begin: float = 0.0, end: float = math.inf) -> float:
    """Share of the gyro's readings from begin to end that are rejected."""
    steps = SlipEstimator(parameters()).process_all(measurements)
    outcomes = [
        report.outcome
        for m, (report, _) in zip(measurements, steps, strict=True)
        if isinstance(m, YawRate) and begin <= seconds(m) < end
    ]
    return float(np.mean(np.array(outcomes) == Outcome.GATED))


@pytest.mark.parametrize("fix_rate", [1, 5])
@pytest.mark.parametrize("value", [0.0, 0.07])
def test_frozen_gyro_does_not_hold_the_heading(value: float, fix_rate: int) -> None:
    recording = recorded(fix_rate=fix_rate)
    estimator, truth, named = SlipEstimator(parameters()), recording.poses[:, 2], []
    errors, deviations = [], []
    for m in with_readings(recording, lambda _: value, BEGIN, END):
        _, estimate = estimator.process(m)
        if estimate is not None and BEGIN + 2.0 <= seconds(m) < END:
            errors.append(estimate.pose[2] - np.interp(seconds(m), recording.t, truth))
            deviations.append(math.sqrt(estimate.pose_covariance[2, 2]))
            named += [
                e.probability for e in estimator.competing_explanations.explanations if e.text == FAILED
            ]
    normalized = np.square(np.array(errors) / deviations)
    assert np.abs(errors).max() < 0.15
    assert normalized.mean() <= 5.0
    assert max(named) > 0.5


def test_gyro_that_comes_alive_again_is_used() -> None:
    given = with_readings(recorded(), lambda _: 0.0, BEGIN, END)
    assert rejected(given, BEGIN + 2.0, END) > 0.5
    assert rejected(given, END + 10.0) < 0.05


@pytest.mark.parametrize("digit", [0.005, 0.02])
def test_gyro_with_few_digits_is_used(digit: float) -> None:
    given = with_readings(recorded(gyro_noise=0.0), lambda m: digit * round(m.rate / digit))
    assert rejected(given) < 0.02


@pytest.mark.parametrize("repeated", [0.1, 0.4])
def test_gyro_that_sends_each_reading_several_times_is_used(repeated: float) -> None:
    """Its readings are up to ``repeated`` s old."""
    latest: list[YawRate] = []

    def hold(m: YawRate) -> float:
        if not latest or seconds(m) - seconds(latest[-1]) >= repeated:
            latest.append(m)
        return latest[-1].rate

    assert rejected(with_readings(recorded(), hold)) < 0.02


def test_gyro_with_few_digits_shows_a_stuck_machine() -> None:
    """It repeats 0 while the machine is stuck, as it did at rest."""
    recording = recorded(gyro_noise=0.0, stuck=(BEGIN, END))
    given = with_readings(recording, lambda m: DIGIT * round(m.rate / DIGIT))
    estimator, errors = SlipEstimator(parameters()), []
    for m in given:
        _, estimate = estimator.process(m)
        if estimate is not None and BEGIN <= seconds(m) < END:
            errors.append(estimate.pose[2] - np.interp(seconds(m), recording.t, recording.poses[:, 2]))
    assert np.abs(errors).max() < 0.1


def test_gyro_that_shows_no_turn_of_coarse_encoders_is_used() -> None:
    """On a straight drive with 16 counts a turn, a count more on one side is no turn."""
    count, speed, given = math.pi / 8.0, 2.5, list[Measurement]()
    for m in recorded().measurements:
        t = seconds(m)
        if isinstance(m, Sprockets):
            left, right = (count * math.floor(speed * t / count + begin) for begin in (0.0, 0.4))
            given.append(replace(m, positions=(left, right)))
        elif isinstance(m, YawRate):
            given.append(replace(m, rate=0.0))
        else:
            given.append(replace(m, pose=np.array((RADIUS * speed * t, 0.0, 0.0))))
    assert rejected(given, 5.0) < 0.02
