# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios of a 20 t excavator on three soils, with RTK and two antennas or one, or with a silent sensor."""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.pose_errors import PoseErrors
from fixtures.whole_inputs import read_inputs

import trackslip as ts
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.arrays import FloatArray
from trackslip_common.config_files import config_file
from trackslip_common.orientations import wrap_angles
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.cli.main import main

SCENARIOS = (
    "dig_cycles",
    "field_trial",
    "hill",
    "patches",
    "side_slope",
    "slalom",
    "soil_change",
    "spot_turn",
    "start_stop",
)
SOILS = ("clayey_soil", "dry_clay", "sandy_loam")
INPUTS: Mapping[str, Mapping[str, Any]] = {
    "two antennas": {},
    "one antenna": {"settings": {"slip_estimator.heading_sources": [""]}},
    "silent IMU": {"withhold": ["imu/data_raw:30:60"]},
    "late IMU": {"withhold": ["imu/data_raw:0:20"]},
    "silent sprockets": {"withhold": ["sprockets:30:60"]},
    "late sprockets": {"withhold": ["sprockets:0:20"]},
    "silent fixes": {"withhold": ["gnss_pose:30:60"]},
    "silent headings": {"withhold": ["heading:30:60"]},
}
WINDOW = 5.0  # s
MOST_NEES, MOST_NEES_OF_WINDOW = 6.0, 30.0  # of the position: 2 if consistent
MOST_HEADING_NEES, MOST_HEADING_NEES_OF_WINDOW = 4.0, 16.0  # 1 if consistent
KNOWN_HEADING = 1.0  # rad, standard deviation
WRONG: Mapping[tuple[str, str, str], str] = {
    ("field_trial", "clayey_soil", "silent fixes"): "nothing measures a slip that changes meanwhile",
    ("hill", "clayey_soil", "one antenna"): "stuck for 90 s; correlated errors look like a slow motion",
    ("side_slope", "clayey_soil", "one antenna"): "the heading is that of the slide",
    ("side_slope", "clayey_soil", "silent IMU"): "the slide follows a tilt that is not measured",
    ("side_slope", "clayey_soil", "late IMU"): "the slide follows a tilt that is not measured",
    ("side_slope", "clayey_soil", "silent sprockets"): "the slide follows tracks that are not measured",
    ("side_slope", "clayey_soil", "late sprockets"): "the slide follows tracks that are not measured",
}
"""Scenario, soil, inputs → why the estimate is wrong."""


class Drive(NamedTuple):
    """A recorded drive, and its truth: times (k,), s, and poses (k, 3) with a continuous heading."""

    scenario: str
    soil: str
    bag: Path
    t: FloatArray
    poses: FloatArray


@pytest.fixture(scope="module")
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    scenario, soil = request.param
    bag = tmp_path_factory.mktemp(scenario) / "bag"
    options = ["--scenario", scenario, "--soil", soil, "--vehicle", "excavator_20t", "--output", str(bag)]
    assert main(["simulate", *options]) == 0
    with open_bag(bag) as recorded:
        inputs = read_inputs(recorded, load_slip_parameters(), InputFilters(), ("truth/odometry",))
    truth = inputs.series["truth/odometry"]
    poses = truth.columns("x", "y", "heading")
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Drive(scenario, soil, bag, truth.stamps_ns * 1e-9, poses)


def errors(drive: Drive, inputs: Mapping[str, Any]) -> PoseErrors:
    """Errors of the estimates during the drive whose heading is known."""
    e = ts.replay(drive.bag, params=[str(config_file("gnss.yaml"))], **inputs).estimates
    t, is_known = e.stamp_ns * 1e-9, e.pose_covariance[:, 2, 2] < KNOWN_HEADING**2
    used = (t >= drive.t[0]) & (t <= drive.t[-1]) & is_known
    off = e.pose[used] - np.column_stack([np.interp(t[used], drive.t, column) for column in drive.poses.T])
    off[:, 2] = wrap_angles(off[:, 2])
    return PoseErrors(t[used], off, e.pose_covariance[used])


def windows(errors: PoseErrors) -> Sequence[PoseErrors]:
    numbers = np.floor(errors.t / WINDOW)
    return [errors.where(numbers == number) for number in np.unique(numbers)]


@pytest.mark.slow
@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("drive", product(SCENARIOS, SOILS), indirect=True, ids="-".join)
def test_position_and_heading_of_each_scenario_are_within_their_covariance(
    drive: Drive, name: str, request: pytest.FixtureRequest
) -> None:
    if reason := WRONG.get((drive.scenario, drive.soil, name)):
        request.applymarker(pytest.mark.xfail(reason=reason, raises=AssertionError, strict=True))
    found = errors(drive, INPUTS[name])
    assert found.t.size > 0
    assert np.mean(found.nees(2)) < MOST_NEES
    assert max(np.mean(part.nees(2)) for part in windows(found)) < MOST_NEES_OF_WINDOW
    assert found.heading_nees < MOST_HEADING_NEES
    assert max(part.heading_nees for part in windows(found)) < MOST_HEADING_NEES_OF_WINDOW
