# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes that are used: what they teach of their delay, and what not."""

import numpy as np
import pytest
from fixtures.drawn_machine import RATE, Machine, drive, parameters

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.models.model import FIX_DELAY

STAMP_ERROR = 0.03  # s


def delays(machine: Machine) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Delay found and its standard deviation, s, and squared errors of the position over their covariance."""
    recorded = drive(machine)
    estimator = SlipEstimator(parameters(**{"sources.box_pose.stamp_error": STAMP_ERROR}))
    published = [e for _, e in estimator.process_all(recorded.measurements) if e is not None]
    errors = np.array([e.pose for e in published])[:, :2] - recorded.poses[1:, :2]
    nees = [v @ np.linalg.solve(e.pose_covariance[:2, :2], v) for v, e in zip(errors, published, strict=True)]
    window = estimator.window
    states = window.best[: window.count]
    found = states["mean"][:, FIX_DELAY], np.sqrt(states["covariance"][:, FIX_DELAY, FIX_DELAY])
    return STAMP_ERROR * found[0], STAMP_ERROR * found[1], nees


@pytest.mark.parametrize("late", [0.0, 0.1])
def test_the_delay_of_fixes_shows_while_speeds_change(late: float) -> None:
    """Of a machine that somebody drives by hand, which never goes steadily."""
    machine = Machine(duration=90.0, surge=0.7, track_error=0.03, fix_rate=5, fix_late=late, seed=1)
    found, stddevs, nees = delays(machine)
    assert found[-1] == pytest.approx(late, abs=3.0 * stddevs[-1])
    assert stddevs[-1] < 0.75 * STAMP_ERROR
    assert np.mean(nees[500:]) < 2.5


def test_a_start_does_not_correct_the_delay() -> None:
    """The tracks run on the spot for a centimetre or two first: that looks like one."""
    found, stddevs, _ = delays(Machine(duration=1.2, fix_rate=RATE))
    assert found[-1] == pytest.approx(0.0, abs=1e-6)
    assert stddevs[-1] >= STAMP_ERROR
