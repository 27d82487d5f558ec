# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slip or gyro bias changes while the only fixes wander by metres."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS, Machine, drive, parameters, with_coarse_fixes
from fixtures.pose_errors import PoseErrors, errors_over

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import Measurement, Sprockets, YawRate
from trackslip_estimation.slip.models.speed import COMMON_SLIP

S = 1_000_000_000
CHANGE, END = 60.0, 180.0  # s
Change = Callable[[Measurement], Measurement]


def slips(m: Measurement) -> Measurement:
    """The measurement while the tracks run at twice the ground speed."""
    if isinstance(m, Sprockets):
        return replace(m, left_speed=2.0 * m.left_speed, right_speed=2.0 * m.right_speed)
    return m


def biased(m: Measurement) -> Measurement:
    return replace(m, rate=m.rate + 0.03) if isinstance(m, YawRate) else m


def run(change: Change, seed: int, stddev: float = 1.0) -> tuple[PoseErrors, SlipEstimator]:
    """Errors after the change, and the estimator at the end."""
    recording = drive(Machine(duration=END, seed=seed, track_error=0.02))
    coarse = with_coarse_fixes(recording, stddev, 60.0, seed=seed)
    changed = [change(m) if m.stamp_ns > S + CHANGE * S else m for m in coarse]
    found, estimator = errors_over(changed, recording, parameters(**GNSS, max_sprocket_speed=8.0))
    return found.between(CHANGE), estimator


@pytest.mark.parametrize("change", [slips, biased])
def test_slip_or_gyro_bias_is_not_attributed_to_the_receiver(change: Change) -> None:
    """The offset of the receiver must not absorb the change."""
    runs = [run(change, seed)[0] for seed in range(4)]
    assert math.sqrt(np.mean([found.rms**2 for found in runs])) < 3.0
    assert np.mean([found.nees(2).mean() for found in runs]) < 5.0


def test_slip_is_found_from_coarse_fixes_within_90_s() -> None:
    slip = []
    for seed in range(2):
        estimator = run(slips, seed)[1]
        assert Event.SLIPPED in {e.event for e in estimator.read_events()}
        slip.append(estimator.window.best[estimator.window.count - 1]["mean"][COMMON_SLIP])
    assert 0.25 < np.mean(slip) < 0.55  # prior 0 ± 0.25; within 90 s


@pytest.mark.parametrize("stddev", [pytest.param(1.0, marks=pytest.mark.slow), 2.5])
def test_wandering_receiver_causes_no_slip_or_bias_event(stddev: float) -> None:
    for seed in range(2):
        events = {e.event for e in run(lambda m: m, seed, stddev)[1].read_events()}
        assert not events & {Event.SLIPPED, Event.BIASED}
