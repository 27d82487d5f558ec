# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Standstill corrects the gyro bias and the pose, but no slip."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from trackslip_estimation.slip.measurements import PoseFix
from trackslip_estimation.slip.motion import Motion

S = 1_000_000_000
Run = Callable[..., Any]


def test_gyro_bias_is_estimated_at_standstill(drive: Callable[..., Any], thesis_run: Run) -> None:
    """Without the estimate, 0.02 rad/s would turn the heading by 0.2 rad in 10 s of driving."""
    go = (10.0, 2.0, 2.0, 0.1, 0.1, 0.0)
    options: dict[str, Any] = {"gyro_bias": 0.02, "fix_every": 10**9}
    errors = {}
    for standing in (0.0, 20.0):
        segments = [(standing, 0.0, 0.0, 0.0, 0.0, 0.0), go] if standing else [go]
        driven = drive(segments, **options)
        found = [m for m in driven.measurements if not isinstance(m, PoseFix)]
        last = thesis_run(found, initial_yaw_stddev=0.001, noise__initial_gyro_bias=0.03).estimates[-1]
        errors[standing] = abs(last.pose[2] - driven.truth[last.stamp_ns][2])
    assert errors[20.0] < 0.03
    assert errors[0.0] > 2.0 * errors[20.0]


def test_slips_are_frozen_at_standstill(drive: Callable[..., Any], thesis_run: Run) -> None:
    segments = [(5.0, 2.0, 2.0, 0.1, 0.1, 0.0), (6.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    driven = drive(segments)
    found = [m for m in driven.measurements if not (isinstance(m, PoseFix) and m.stamp_ns > 5 * S)]
    standing = [e for e in thesis_run(found).estimates if e.motion is Motion.STANDING]
    assert len(standing) > 200
    first, last = standing[0], standing[-1]
    assert (np.diag(last.outputs.slip_covariance) <= np.diag(first.outputs.slip_covariance) + 1e-12).all()
    np.testing.assert_allclose(last.outputs.slips, first.outputs.slips, atol=3e-3)
    np.testing.assert_allclose(last.pose, first.pose, atol=5e-3)
    assert (np.diag(last.pose_covariance) <= np.diag(first.pose_covariance) + 1e-6).all()


def test_slips_keep_their_prior_at_standstill_from_the_start(
    drive: Callable[..., Any], thesis_run: Run
) -> None:
    last = thesis_run(drive([(5.0, 0.0, 0.0, 0.0, 0.0, 0.0)]).measurements).estimates[-1]
    np.testing.assert_allclose(last.outputs.slips, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(last.outputs.slip_covariance)), (0.1, 0.1, 0.01), rtol=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
def test_fixes_at_standstill_leave_the_variance_of_their_common_part(
    drive: Callable[..., Any], thesis_run: Run, share: float
) -> None:
    found = drive([(10.0, 0.0, 0.0, 0.0, 0.0, 0.0)]).measurements
    changes = {"initial_position_stddev": 1.0, "sources__box_pose__standing_share": share}
    last = thesis_run(found, **changes).estimates[-1]
    expected = 0.03 * np.sqrt(share + (1.0 - share) / 51)
    assert np.sqrt(last.pose_covariance[0, 0]) == pytest.approx(expected, rel=0.05)
    assert np.hypot(*last.pose[:2]) < 0.03
    assert np.sqrt(last.pose_covariance[2, 2]) < 0.02  # heading errors are not correlated
