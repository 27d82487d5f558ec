# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The delay of fixes: when it is observable and when it is not."""

import math

import numpy as np
import pytest
from fixtures.drawn_machine import RATE, Machine, drive, parameters
from fixtures.filter_steps import Gaussian, state_of
from fixtures.pose_errors import PoseErrors, errors_over
from hypothesis import given
from hypothesis import strategies as st

from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.late_stamps import inflate_delay, log_odds_of_delay
from trackslip_estimation.slip.models.model import FIX_DELAY

STAMP_ERROR = 0.03  # s


def delays(machine: Machine) -> tuple[np.ndarray, np.ndarray, PoseErrors]:
    """Estimated delay and its standard deviation, s; errors of the poses."""
    recorded = drive(machine)
    p = parameters(**{"sources.box_pose.stamp_error": STAMP_ERROR})
    errors, estimator = errors_over(recorded.measurements, recorded, p)
    states = estimator.window.best[: estimator.window.count]
    found = states["mean"][:, FIX_DELAY], np.sqrt(states["covariance"][:, FIX_DELAY, FIX_DELAY])
    return STAMP_ERROR * found[0], STAMP_ERROR * found[1], errors


@pytest.mark.parametrize("late", [0.0, 0.1])
def test_delay_of_fixes_is_observable_while_speeds_change(late: float) -> None:
    """A manually driven machine, whose speed is never steady."""
    machine = Machine(duration=90.0, surge=0.7, track_error=0.03, fix_rate=5, fix_late=late, seed=1)
    found, stddevs, errors = delays(machine)
    assert found[-1] == pytest.approx(late, abs=3.0 * stddevs[-1])
    assert stddevs[-1] < 0.75 * STAMP_ERROR
    assert errors.between(25.0).nees(2).mean() < 2.5


@pytest.mark.parametrize("late", [0.2, 0.3])
def test_delay_of_fixes_beyond_its_prior_keeps_the_estimate_consistent(late: float) -> None:
    """The delay must not be attributed to slip at changes of speed."""
    squares = []
    for seed in range(3):
        machine = Machine(duration=120.0, surge=0.5, track_error=0.02, fix_late=late, seed=seed)
        found, stddevs, errors = delays(machine)
        assert found[-1] == pytest.approx(late, abs=3.0 * stddevs[-1])
        squares.append(errors.between(60.0).nees(2).mean())
    assert np.mean(squares) < 4.0


@given(st.floats(0.5, 5.0), st.floats(0.05, 0.4), st.floats(-20.0, 20.0))
def test_odds_and_delay_follow_the_rule_of_bayes(v: float, share: float, z: float) -> None:
    """Given z = δ + noise, odds and update are those of a prior variance w of δ against v."""
    p = parameters(**{"sources.box_pose.stamp_error": STAMP_ERROR})
    c, noise, w = make_config(p)[0], share * v, (p.events.late_stddev / STAMP_ERROR) ** 2
    state = state_of(Gaussian(c["prior_mean"].copy(), c["prior_covariance"].copy()))[0]
    state["mean"][FIX_DELAY] = v / (v + noise) * z
    state["covariance"][FIX_DELAY, FIX_DELAY], state["delay_variance"] = v * noise / (v + noise), v
    densities = [math.exp(-(z**2) / (2.0 * S)) / math.sqrt(S) for S in (w + noise, v + noise)]
    odds = math.log(densities[0] / densities[1] * p.events.late_share)
    assert log_odds_of_delay(state, 0, c) == pytest.approx(odds, rel=1e-6, abs=1e-6)
    inflate_delay(state, 0, c)
    assert state["mean"][FIX_DELAY] == pytest.approx(w / (w + noise) * z, rel=1e-6, abs=1e-6)
    assert state["covariance"][FIX_DELAY, FIX_DELAY] == pytest.approx(w * noise / (w + noise), rel=1e-6)
    assert log_odds_of_delay(state, 0, c) == -math.inf  # already inflated


def test_start_of_a_drive_does_not_correct_the_fix_delay() -> None:
    """The tracks first spin for a centimetre or two, which resembles a delay."""
    found, stddevs, _ = delays(Machine(duration=1.2, fix_rate=RATE))
    assert found[-1] == pytest.approx(0.0, abs=1e-6)
    assert stddevs[-1] >= STAMP_ERROR
