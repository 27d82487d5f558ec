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

import trackslip as ts
from trackslip_common.config_files import config_file
from trackslip_common.orientations import wrap_angles
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.offline import START_NS, record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.truth.record import Truth

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
ONE_ANTENNA: Mapping[str, Any] = {"settings": {"slip_estimator.heading_sources": [""]}}
INPUTS: Mapping[str, Mapping[str, Any]] = {
    "two antennas": {},
    "one antenna": ONE_ANTENNA,
    "silent IMU": {"withhold": ["imu/data_raw:30:60"]},
    "late IMU": {"withhold": ["imu/data_raw:0:40"]},
    "silent sprockets": {"withhold": ["sprockets:30:60"]},
    "late sprockets": {"withhold": ["sprockets:0:40"]},
    "silent fixes": {"withhold": ["gnss_pose:30:60"]},
    "silent headings": {"withhold": ["heading:30:60"]},
}
WINDOW = 5.0  # s
MOST_NEES, MOST_NEES_OF_WINDOW = 6.0, 30.0  # of the position: 2 if consistent
MOST_HEADING_NEES, MOST_HEADING_NEES_OF_WINDOW = 4.0, 16.0  # 1 if consistent
KNOWN_HEADING = 1.0  # rad, standard deviation
WRONG: Mapping[tuple[str, str, str], str] = {}


class Drive(NamedTuple):
    """A recorded drive, its truth, and the time of the bag at which the truth begins, s."""

    bag: Path
    truth: Truth
    lead_in: float


@pytest.fixture(scope="module")
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    scenario, soil = request.param
    p = load_emulator_parameters({"scenario": scenario, "soil": soil, "vehicle": "excavator_20t", "seed": 0})
    truth, bag = simulate_drive(p), tmp_path_factory.mktemp(scenario) / "bag"
    record_drive(p, truth, bag)
    return Drive(bag, truth, p.lead_in)


def errors(drive: Drive, inputs: Mapping[str, Any]) -> PoseErrors:
    """Errors of the estimates during the drive whose heading is known."""
    e = ts.replay(drive.bag, params=[str(config_file("gnss.yaml"))], **inputs).estimates
    t = (e.stamp_ns - START_NS) * 1e-9 - drive.lead_in
    is_known = e.pose_covariance[:, 2, 2] < KNOWN_HEADING**2
    used = (t >= 0.0) & (t <= drive.truth.duration) & is_known
    at = drive.truth.interpolate(t[used])
    off = e.pose[used] - np.column_stack((at.x, at.y, at.yaw))
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
    found = errors(drive, INPUTS[name])
    assert found.t.size > 0
    assert np.mean(found.nees(2)) < MOST_NEES
    assert max(np.mean(part.nees(2)) for part in windows(found)) < MOST_NEES_OF_WINDOW
    assert found.heading_nees < MOST_HEADING_NEES
    assert max(part.heading_nees for part in windows(found)) < MOST_HEADING_NEES_OF_WINDOW
