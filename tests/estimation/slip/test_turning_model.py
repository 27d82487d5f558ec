# SPDX-License-Identifier: Apache-2.0
"""What a gentle turn costs, by the turning model; the equations as such are in ``property``."""

import numpy as np
import pytest
from trackslip_estimation.slip.filter import Filter

from trackslip_estimation.slip.models.turning import LOSS
from trackslip_estimation.slip.motion import Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters, make_filter

P = load_slip_parameters()
RADIUS, GENTLE = P.vehicle.rolling_radius, P.turning.gentle_turn


@pytest.fixture(scope="module")
def model() -> Filter:
    return make_filter(P)


def lag(model: Filter, left: float, right: float) -> float:
    """s, m/s: what η of 1 takes of the speed of a machine that does not slip otherwise."""
    state = model.initial(np.zeros(3), np.eye(3))
    state.mean[3:] = 0.0
    state.mean[LOSS] = 1.0
    twist = model.outputs(state, Speeds(left, right, 0.0, differenced=False)).twist
    return RADIUS * (left + right) / 2.0 - float(twist[0])


def test_a_gentle_turn_costs_half(model: Filter) -> None:
    half = 1.5 * GENTLE
    assert lag(model, 1.5 - half, 1.5 + half) == pytest.approx(RADIUS * half / 2.0)


def test_rounded_counts_hardly_slow_a_straight_drive(model: Filter) -> None:
    """|D| of rounding alone has a mean, and would be taken for slip: 1 % of 0.22 m/s, were no turn gentle."""
    t = np.arange(1001) * 0.01
    angles = np.floor(np.outer(t, (1.4, 1.4)) / P.encoder_resolution + (0.2, 0.7)) * P.encoder_resolution
    speeds = (np.diff(angles, axis=0) / 0.01).tolist()
    taken = np.mean([lag(model, left, right) for left, right in speeds])
    rectified = np.mean([RADIUS * abs(right - left) / 2.0 for left, right in speeds])
    assert rectified > 0.008 * RADIUS * 1.4
    assert 0.0 < taken < 0.5 * rectified
