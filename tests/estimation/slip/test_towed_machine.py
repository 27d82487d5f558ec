# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A machine moves for a minute while its tracks stand: it is towed."""

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS, Machine, drive, parameters, with_coarse_fixes
from fixtures.pose_errors import PoseErrors, errors_over

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import YawRate

TOWED = 60.0, 120.0  # s
DURATION = 180.0  # s


def errors_of(fix_rate: int, *, coarse: bool, has_gyro: bool) -> tuple[PoseErrors, SlipEstimator]:
    """Errors of the estimate, and the estimator, with precise or coarse fixes."""
    recording = drive(Machine(duration=DURATION, fix_rate=fix_rate, towed=TOWED))
    measurements = with_coarse_fixes(recording, 1.5, 60.0) if coarse else recording.measurements
    used = [m for m in measurements if has_gyro or not isinstance(m, YawRate)]
    return errors_over(used, recording, parameters(**GNSS))


@pytest.mark.parametrize("fix_rate", [1, 5])
@pytest.mark.parametrize("has_gyro", [True, False])
def test_heading_is_found_again_once_the_tracks_of_a_towed_machine_drive(
    has_gyro: bool, fix_rate: int
) -> None:
    errors, _ = errors_of(fix_rate, coarse=False, has_gyro=has_gyro)
    after = errors.between(TOWED[1] + 12.0)
    assert np.abs(after.off[:, 2]).max() < 0.15
    assert after.heading_nees < 3.0
    assert after.rms < 0.05


@pytest.mark.parametrize("fix_rate", [1, 5])
def test_coarse_fixes_of_a_towed_machine_are_followed(fix_rate: int) -> None:
    errors, estimator = errors_of(fix_rate, coarse=True, has_gyro=True)
    meanwhile = errors.between(TOWED[0] + 30.0, TOWED[1])
    assert meanwhile.rms < 6.0
    assert meanwhile.nees(2).mean() < 6.0
    assert Event.FAILED in {e.event for e in estimator.read_events() if e.source == "sprockets"}
