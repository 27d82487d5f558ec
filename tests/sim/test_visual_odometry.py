# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An emulated drive like Test Five with a camera's odometry: half a minute without fixes, and replay."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.commands import json_of
from fixtures.visual_odometry import LEVER, MOUNTING, TOPIC, with_visual_odometry
from fixtures.whole_inputs import read_inputs

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.config_files import config_file, read_yaml
from trackslip_estimation.slip.conversions import odometry_pose
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import ODOMETRY, to_records
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import parse_scenario
from trackslip_sim.truth.simulate import simulate

SEGMENTS = 12  # of the field trial: 85 s, which after the lead-in covers the outage
SETTINGS = {
    "odometry_sources": [TOPIC],
    f"sources.{TOPIC}.covariance": "declared",
    **{f"sources.{TOPIC}.lever_arm_{axis}": value for axis, value in zip("xyz", LEVER, strict=True)},
    f"sources.{TOPIC}.mounting_pitch": MOUNTING[1],
    f"sources.{TOPIC}.mounting_yaw": MOUNTING[2],
}
CLAY = {"soil": "clayey_soil", "from_x": 6.0, "to_x": 100.0, "from_y": -100.0, "to_y": 100.0}


def record(path: Path, segments: int, patches: list[dict[str, Any]]) -> Path:
    """A bag of the first segments of the field trial."""
    tree = dict(read_yaml(config_file("scenarios/field_trial.yaml")))
    tree |= {"segments": tree["segments"][:segments], "patches": patches}
    parameters = load_emulator_parameters({"lead_in": 6.0, "seed": 5})
    record_drive(parameters, simulate(parse_scenario(tree)), path / "plain")
    return with_visual_odometry(path / "plain", path / "bag")


def without_fixes(bag: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Summary of a replay without fixes and gyro for 30 s."""
    hidden = [f"--withhold={topic}:60:90" for topic in ("box_pose", "imu/data_raw")]
    sets = [f"--set=slip_estimator.{name}={json.dumps(value)}" for name, value in settings.items()]
    command = ["replay", bag, *hidden, *sets, "--reference", "truth/odometry"]
    summary: dict[str, Any] = json_of(bag.parent, *command)
    return summary


@pytest.mark.slow
@pytest.mark.parametrize("patches", [[], [CLAY]], ids=["sand", "clay ahead"])
def test_half_a_minute_without_fixes_is_bridged(patches: list[dict[str, Any]], tmp_path: Path) -> None:
    """The drift is 1 %, below that of the sprockets alone."""
    bag = record(tmp_path, SEGMENTS, patches)
    blind, summary = without_fixes(bag, {}), without_fixes(bag, SETTINGS)
    assert summary["rmse"]["withheld"]["end"] < min(0.06, 0.8 * blind["rmse"]["withheld"]["end"])
    assert summary["rmse"]["heading"] < 0.006 < blind["rmse"]["heading"]
    assert summary["nees"] < 6.0
    assert summary["nees_position"] < 4.5
    assert set(summary["rejected"][TOPIC]) == {"begun", "waiting"}


def test_replay_reads_odometry_as_the_node_does(tmp_path: Path) -> None:
    bag = record(tmp_path, 3, [])
    p = load_slip_parameters(SETTINGS)
    numbers = {name: k for k, name in enumerate(p.timeouts_ns())}
    with open_bag(bag) as opened:
        messages = [opened.deserialize(m.raw, m.type_name) for m in opened.messages([f"/{TOPIC}"])]
        rows = read_inputs(opened, p, InputFilters(), ()).measurements(numbers)
    poses: list[Any] = [odometry_pose(m, TOPIC, p.odometries()[TOPIC]) for m in messages]
    expected = to_records(poses, numbers)
    odometry = rows[rows["kind"] == ODOMETRY]
    assert len(odometry) == len(expected) > 200
    for name in ("stamp_ns", "source", "value", "noise", "orientation", "frame"):
        np.testing.assert_array_equal(odometry[name], expected[name])
