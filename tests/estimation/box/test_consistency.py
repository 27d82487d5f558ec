# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance of the box's pose is consistent with its errors, over random poses and noise."""

import dataclasses

import numpy as np
import pytest
from fixtures.box_site import AT_ORIGIN, BARE_AT_ORIGIN, BOX, error, locate, standing
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_sim.machine.scan_model import SiteScanner

SCANS = 150


def first_fix(pose, prediction, stddev, seed, resolution=0.01):
    """The fix of one scan of a vehicle at standstill, with the predicted pose given."""
    x, y, yaw = prediction.tolist()
    noise = {"range_stddev": max(stddev, 1e-4), "range_resolution": resolution}
    parameters = dataclasses.replace(
        AT_ORIGIN, initial_x=x, initial_y=y, initial_yaw=yaw, initial_reach=0.5, **noise
    )
    site = dataclasses.replace(BARE_AT_ORIGIN, range_stddev=stddev, range_resolution=resolution)
    return locate(BoxLocalizer(parameters, BOX), 0.0, SiteScanner(site, BOX, seed).scan(0.0, standing(*pose)))


@pytest.mark.parametrize(
    ("stddev", "position", "heading"),
    [
        pytest.param(0.01, 0.008, 0.016, marks=pytest.mark.slow),
        (0.025, 0.012, 0.034),
        pytest.param(0.05, 0.021, 0.07, marks=pytest.mark.slow),
    ],
)
def test_errors_agree_with_their_covariance(stddev, position, heading):
    random = np.random.default_rng(17)
    errors, nees = [], []
    for seed in range(SCANS):
        distance, bearing, yaw = random.uniform([2.0, -1.2, -np.pi], [12.0, 1.2, np.pi])
        pose = np.array([distance * np.cos(bearing), distance * np.sin(bearing), yaw])
        fix = first_fix(pose, pose + 0.05 * random.standard_normal(3), stddev, seed)
        if isinstance(fix, BoxFix):
            errors.append(error(fix, standing(*pose)))
            nees.append(errors[-1] @ np.linalg.solve(fix.covariance, errors[-1]))
    assert len(errors) >= SCANS - 1
    lower, upper = chi2.ppf([0.005, 0.995], 3 * len(nees)) / len(nees)
    assert 0.9 * lower < np.mean(nees) < upper
    assert np.mean(np.array(nees) > chi2.ppf(0.99, 3)) < 0.03
    x, y, yaw = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.hypot(x, y) < position
    assert yaw < heading


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    distance=st.floats(2.0, 5.0),
    bearing=st.floats(-1.2, 1.2),
    corner=st.floats(0.45, 1.1),
    quarter=st.integers(0, 3),
)
def test_exact_without_noise_where_two_sides_are_seen(distance, bearing, corner, quarter):
    pose = np.array(
        [distance * np.cos(bearing), distance * np.sin(bearing), bearing + corner + quarter * np.pi / 2]
    )
    fix = first_fix(pose, pose + np.array([0.1, -0.1, 0.1]), stddev=0.0, seed=0, resolution=0.0)
    assert isinstance(fix, BoxFix)
    assert error(fix, standing(*pose)) == pytest.approx(0.0, abs=4e-3)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    st.lists(
        st.one_of(st.floats(0.0, 60.0), st.sampled_from([np.nan, np.inf, -np.inf, 8.0, 8.01, 8.4])),
        min_size=0,
        max_size=361,
    )
)
def test_any_scan_gives_a_finite_fix_or_a_rejection(ranges):
    localizer = BoxLocalizer(dataclasses.replace(AT_ORIGIN, initial_x=8.0, initial_reach=50.0), BOX)
    outcome = locate(localizer, 0.0, np.array(ranges))
    if isinstance(outcome, BoxFix):
        assert np.all(np.isfinite([outcome.x, outcome.y, outcome.yaw]))
        assert np.all(np.linalg.eigvalsh(outcome.covariance) > 0.0)
