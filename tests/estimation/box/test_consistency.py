# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance of the box's pose is consistent with its errors, over random poses and noise."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from trackslip_common.config_files import node_defaults
from trackslip_common.parameters import flat_fields, from_flat
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.scan import Scan
from trackslip_sim.machine.scan_model import (
    ANGLE_INCREMENT,
    ANGLE_MIN,
    TIME_INCREMENT,
    SiteParameters,
    SiteScanner,
)

BOX = load_vehicle().box
NODE = node_defaults("box_localizer", "site.yaml", "box_localizer.yaml")
NAMES = {name for name, _, _ in flat_fields(BoxLocalizerParameters)}
PARAMETERS = dataclasses.replace(
    from_flat(BoxLocalizerParameters, {name: NODE[name] for name in NAMES}, "box_localizer.yaml"),
    laser_x=0.0,
    laser_y=0.0,
    laser_yaw=0.0,
    initial_reach=0.5,
)


def site(stddev, resolution=0.01):
    return SiteParameters(
        laser_x=0.0,
        laser_y=0.0,
        laser_yaw=0.0,
        range_stddev=stddev,
        range_resolution=resolution,
        range_max=50.0,
        walls=(),
        posts=(),
    )


def first_fix(pose, prediction, stddev, seed, resolution=0.01):
    """The fix of one scan of a vehicle at standstill, with the predicted pose given."""
    parameters = dataclasses.replace(
        PARAMETERS,
        initial_x=float(prediction[0]),
        initial_y=float(prediction[1]),
        initial_yaw=float(prediction[2]),
        range_stddev=max(stddev, 1e-4),
        range_resolution=resolution,
    )
    ranges = SiteScanner(site(stddev, resolution), BOX, seed).scan(
        0.0, lambda times: (times * 0.0 + pose[0], times * 0.0 + pose[1], times * 0.0 + pose[2])
    )
    scan = Scan(0, ranges, ANGLE_MIN, ANGLE_INCREMENT, TIME_INCREMENT)
    return BoxLocalizer(parameters, BOX).locate(scan)


def miss(fix, pose):
    turned = fix.yaw - pose[2]
    return np.array([fix.x - pose[0], fix.y - pose[1], np.arctan2(np.sin(turned), np.cos(turned))])


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
    for seed in range(300):
        distance, bearing, yaw = random.uniform([2.0, -1.2, -np.pi], [12.0, 1.2, np.pi])
        pose = np.array([distance * np.cos(bearing), distance * np.sin(bearing), yaw])
        fix = first_fix(pose, pose + 0.05 * random.standard_normal(3), stddev, seed)
        if isinstance(fix, BoxFix):
            errors.append(miss(fix, pose))
            nees.append(errors[-1] @ np.linalg.solve(fix.covariance, errors[-1]))
    assert len(errors) >= 299
    lower, upper = chi2.ppf([0.005, 0.995], 3 * len(nees)) / len(nees)
    assert 0.9 * lower < np.mean(nees) < upper
    assert np.mean(np.array(nees) > chi2.ppf(0.99, 3)) < 0.03
    x, y, yaw = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.hypot(x, y) < position
    assert yaw < heading


@settings(max_examples=60, deadline=None, derandomize=True)
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
    assert miss(fix, pose) == pytest.approx(0.0, abs=4e-3)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    st.lists(
        st.one_of(st.floats(0.0, 60.0), st.sampled_from([np.nan, np.inf, -np.inf, 8.0, 8.01, 8.4])),
        min_size=0,
        max_size=361,
    )
)
def test_any_scan_gives_a_finite_fix_or_a_rejection(ranges):
    localizer = BoxLocalizer(dataclasses.replace(PARAMETERS, initial_x=8.0, initial_reach=50.0), BOX)
    outcome = localizer.locate(Scan(0, np.array(ranges), ANGLE_MIN, ANGLE_INCREMENT, TIME_INCREMENT))
    if isinstance(outcome, BoxFix):
        assert np.all(np.isfinite([outcome.x, outcome.y, outcome.yaw]))
        assert np.all(np.linalg.eigvalsh(outcome.covariance) > 0.0)
