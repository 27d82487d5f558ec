# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Weights of four headings a quarter turn apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_estimation.box.heading_ambiguity import (
    CERTAIN_WEIGHTS,
    NEGLIGIBLE_PROBABILITY,
    Headings,
    Mode,
    SideEvidence,
    heading_prior,
    mix_modes,
    sides_are_known,
)

QUARTERS = np.pi / 2.0 * np.arange(4)
NARROW = np.diag([0.01, 0.01, 0.03]) ** 2


def modes(log_odds=0.0):
    """Modes about heading 0. The odd ones are shifted by 5 cm and have ``log_odds`` against the others."""
    return [Mode(np.array([0.05 * (k % 2), 0.0, QUARTERS[k]]), NARROW, log_odds * (k % 2)) for k in range(4)]


def after_scans(log_odds, scans, *, moved=0.0):
    """Modes, weights and headings after ``scans`` scans from ``OPEN``, each ``moved`` m from the last."""
    headings, weights = OPEN, None
    for k in range(scans):
        scan_modes = modes(log_odds)
        for mode in scan_modes:
            mode.pose[0] += k * moved
        ordered_modes, weights, headings = headings.update(scan_modes, 0.0, 0.05**2, step=0.1)
        if abs(ordered_modes[0].pose[2]) > 0.1:
            return ordered_modes, weights, headings
    return ordered_modes, weights, headings


def test_heading_predicted_well_leaves_no_ambiguity():
    assert heading_prior(QUARTERS, np.full(4, 0.1**2), CERTAIN_WEIGHTS) == pytest.approx(
        CERTAIN_WEIGHTS, abs=1e-6
    )
    assert sides_are_known(0.3, 0.1**2, CERTAIN_WEIGHTS)
    assert not sides_are_known(0.3, 0.5**2, CERTAIN_WEIGHTS)


def test_unpredicted_heading_is_any_of_four():
    assert heading_prior(QUARTERS, np.full(4, 9.0**2), CERTAIN_WEIGHTS) == pytest.approx(0.25, abs=0.05)


@given(st.floats(-np.pi, np.pi), st.floats(0.02, 3.0), st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4))
def test_prior_is_a_probability_and_turns_with_the_hypotheses(turned, spread, raw):
    weights = np.array(raw) + 1e-3
    weights /= weights.sum()
    variance = np.full(4, spread**2)
    probabilities = heading_prior(turned + QUARTERS, variance, weights)
    assert probabilities.sum() == pytest.approx(1.0)
    again = heading_prior(turned + QUARTERS, variance, np.roll(weights, 1))
    assert again == pytest.approx(np.roll(probabilities, 1), abs=1e-3)


OPEN = Headings(np.array([0.5, 0.2, 0.2, 0.1]), SideEvidence())


@pytest.mark.parametrize("scans", [1, 5])
def test_sides_are_not_settled_within_a_second_however_accurate_the_scans_are(scans):
    _, weights, headings = after_scans(-50.0, scans, moved=0.2)
    assert headings.weights[1] > 0.1
    assert weights[1] > NEGLIGIBLE_PROBABILITY


def test_many_scans_settle_the_sides_and_leave_half_a_turn_open():
    _, weights, headings = after_scans(-3.0, 15, moved=0.2)
    assert headings.weights == pytest.approx([5.0 / 7.0, 0.0, 2.0 / 7.0, 0.0], abs=1e-6)
    assert weights == pytest.approx(headings.weights)


def test_wrong_prior_of_the_sides_is_corrected():
    ordered_modes, _, headings = after_scans(3.0, 15, moved=0.2)
    assert abs(np.sin(ordered_modes[0].pose[2])) == pytest.approx(1.0)
    assert headings.evidence.log_odds < 0.0


def test_scans_from_one_place_count_as_one_piece_of_evidence():
    """The same beams hit and miss in each scan: 100 scans with a ratio of 1 : 2 count as one."""
    assert after_scans(-0.7, 100)[2].evidence.log_odds == pytest.approx(-0.7)
    assert SideEvidence().update(0.5, np.zeros(3), 0.1).rotate_quarter().log_odds == -0.5


def test_absence_forgets_the_evidence():
    headings = after_scans(-0.7, 5, moved=0.2)[2]
    _, _, lost = headings.update(modes(), 0.0, 1.0, step=0.1)
    assert lost.evidence.log_odds == 0.0


def test_covariance_spans_ambiguous_positions():
    """Four fixes per second with the wrong quarter must not add up to a certain position."""
    weights = np.array([0.95, 0.05, 0.0, 0.0])
    pose, covariance = mix_modes(modes(), weights, elapsed=0.25)
    off = modes()[1].pose[:2] - pose[:2]
    squared = float(off @ np.linalg.solve(covariance[:2, :2], off))
    assert squared < 1.2  # four such fixes, in 1 s, exclude nothing
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert covariance[1, 1] == pytest.approx(NARROW[1, 1])  # no hypothesis differs in y


def test_covariance_of_the_mixture_spans_each_position_and_heading():
    pose, covariance = mix_modes(modes(), np.full(4, 0.25), elapsed=30.0)
    assert pose == pytest.approx([0.025, 0.0, 0.0])
    assert covariance[0, 0] == pytest.approx(0.01**2 + 0.025**2)
    assert covariance[2, 2] >= (np.pi / 2.0) ** 2
    _, sides = mix_modes(modes(), np.array([0.999, 0.001, 0.0, 0.0]), elapsed=0.2)
    assert sides[2, 2] == pytest.approx((np.pi / 4.0) ** 2, rel=0.01)
    assert mix_modes(modes(), CERTAIN_WEIGHTS, elapsed=0.2)[1] == pytest.approx(NARROW)
