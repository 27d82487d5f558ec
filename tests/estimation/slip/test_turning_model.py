# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speed lost in turns by the turning model; ``test_speed_models`` has the equations."""

import numpy as np
import pytest
from fixtures.filter_steps import (
    Gaussian,
    config_of,
    filter_step,
    outputs_of,
    rate_measured,
    start_of,
)

from trackslip_estimation.slip.models.model import SIZE
from trackslip_estimation.slip.models.turning import EFFICIENCY, LOSS
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters

P = load_slip_parameters()
RADIUS, GENTLE = P.vehicle.kinematics.rolling_radius, P.turning.gentle_turn


CONFIG = config_of()


def speed_loss(left: float, right: float) -> float:
    """s, m/s: speed that η = 1 takes from a machine without other slip."""
    mean = np.zeros(SIZE)
    mean[LOSS] = 1.0
    known = Gaussian(mean, np.zeros((SIZE, SIZE)))
    twist = outputs_of(CONFIG, known, Speeds(left, right))["twist"]
    return RADIUS * (left + right) / 2.0 - float(twist[0])


def test_speed_loss_of_a_gentle_turn_is_half_of_the_full_one() -> None:
    half = 1.5 * GENTLE
    assert speed_loss(1.5 - half, 1.5 + half) == pytest.approx(RADIUS * half / 2.0)


def test_rounded_counts_hardly_slow_a_straight_drive() -> None:
    """Rounding alone gives |D| a mean above 0; in the law of a full turn it would cost 1 % of 0.22 m/s."""
    t = np.arange(1001) * 0.01
    angles = np.floor(np.outer(t, (1.4, 1.4)) / P.encoder_resolution + (0.2, 0.7)) * P.encoder_resolution
    speeds = (np.diff(angles, axis=0) / 0.01).tolist()
    loss = np.mean([speed_loss(left, right) for left, right in speeds])
    rectified = np.mean([RADIUS * abs(right - left) / 2.0 for left, right in speeds])
    assert rectified > 0.008 * RADIUS * 1.4
    assert 0.0 < loss < 0.5 * rectified


def test_lower_turning_efficiency_raises_the_speed_loss() -> None:
    """The prior correlation keeps κ + η at 0.8 ± 0.2."""
    state = start_of(CONFIG, np.zeros(3), np.diag((0.01, 0.01, 0.01)) ** 2)
    turning, speeds = MotionState(Motion.TURNING, changing=False), Speeds(1.0, 2.0)
    measured = rate_measured(0.1 * RADIUS / P.vehicle.kinematics.tread, 1e-8)
    for _ in range(100):
        state = filter_step(CONFIG, state, speeds, 0.02, turning, measured).updated
    assert state.mean[EFFICIENCY] == pytest.approx(0.1, abs=0.02)
    assert state.mean[LOSS] == pytest.approx(0.7, abs=0.03)
    assert np.sqrt(state.covariance[LOSS, LOSS]) == pytest.approx(0.2, abs=0.02)
