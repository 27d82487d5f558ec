# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes of drives that leave the laser's view and return: errors match the covariance, by beam count."""

import numpy as np
import pytest
from fixtures.box_drives import scored_drive

CLASSES = {"few": (0, 6), "some": (6, 12), "many": (12, 400)}
LEAST = 100  # fixes for a mean


@pytest.fixture(scope="module")
def fixes():
    """About 2500 fixes, from four headings; half of the drives stay in view and keep their heading."""
    kinds = ({"farthest": 36.0, "hides": True}, {"farthest": 26.0, "hides": False})
    drives = [scored_drive(seed, 70.0, seed % 4 * np.pi / 2.0, **kinds[seed // 4]) for seed in range(8)]
    return [fix for scored, _ in drives for fix in scored]


@pytest.mark.slow
@pytest.mark.parametrize("name", CLASSES)
def test_errors_of_position_and_heading_agree_with_their_covariance(fixes, name):
    low, high = CLASSES[name]
    chosen = [fix for fix in fixes if low <= fix.beams < high]
    headings = [fix.heading for fix in chosen if fix.claims_heading]
    assert len(headings) > LEAST
    assert 0.7 < np.mean([fix.position for fix in chosen]) / 2.0 < 1.5
    assert 0.7 < np.mean(headings) < 1.5


@pytest.mark.slow
def test_certain_headings_are_never_a_quarter_turn_off(fixes):
    claimed = [fix for fix in fixes if fix.claims_heading]
    assert max(fix.heading for fix in claimed) < 4.0**2
    assert max(abs(fix.error[2]) for fix in claimed) < 0.5
