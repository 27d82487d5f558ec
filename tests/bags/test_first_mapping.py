# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A first mapping of a CSV log: columns are found by their names, and a guess is named as one."""

from pathlib import Path

import pytest
import yaml

from trackslip_bags.importing.first_mapping import FirstMapping, first_mapping
from trackslip_bags.importing.mapping import read_mapping
from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError

SIDES = ("left_velocity", "right_velocity")


def made(folder: Path, names: str) -> FirstMapping:
    log = folder / "log.csv"
    log.write_text(f"{names}\n" + ",".join("1" for _ in names.split(",")) + "\n", encoding="utf-8")
    return first_mapping(log, "excavator_20t", {})


@pytest.mark.parametrize(
    ("names", "found", "guesses"),
    [
        ("t,v_left,v_right", {"time": "t, s", SIDES[0]: "v_left, m/s", SIDES[1]: "v_right, m/s"}, 3),
        ("time_ms,left_kmh,right_kmh", {"time": "time_ms, ms", SIDES[0]: "left_kmh, km/h"}, 0),
        ("t [s],wl [rad/s],wr [rad/s]", {SIDES[0]: "wl [rad/s], rad/s"}, 0),
        ("Time (s),Left Speed (km/h),Right Speed (km/h)", {SIDES[1]: "Right Speed (km/h), km/h"}, 0),
        ("t_s,left_mps,right_mps,yaw_rate_dps", {"angular_velocity_z": "yaw_rate_dps, deg/s"}, 0),
        ("t_s,wheel_left_rpm,wheel_right_rpm,gz_rads", {"angular_velocity_z": "gz_rads, rad/s"}, 0),
        ("t_s,left_mps,right_mps,lat_deg,lon_deg", {"latitude": "lat_deg, deg"}, 1),
        (
            "t_s,leftTicks,rightTicks,gyroZ",
            {"left_position": "leftTicks, rev", "angular_velocity_z": "gyroZ, rad/s"},
            3,
        ),
        ("t_s,meas_left_vel_mps,meas_right_vel_mps,cmd_left_vel", {SIDES[0]: "meas_left_vel_mps, m/s"}, 0),
        ("t_s,enc_l,enc_r", {"right_position": "enc_r, rev"}, 2),
        ("t_s,left_wheel_angle_deg,right_wheel_angle_deg", {"left_position": "left_wheel_angle_deg, deg"}, 0),
        ("t_s,v_left_mps,v_right_mps,left_ticks,right_ticks", {"left_velocity": "v_left_mps, m/s"}, 0),
        ("t_s,left_mps,right_mps,east_m,north_m", {"x": "east_m, m", "y": "north_m, m"}, 1),
        ("t_s,left_mps,right_mps,lat_deg,lon_deg,x_m,y_m", {"latitude": "lat_deg, deg"}, 1),
    ],
)
def test_columns_are_found_by_their_names(
    names: str, found: dict[str, str], guesses: int, tmp_path: Path
) -> None:
    first = made(tmp_path, names)
    assert first.found.items() >= found.items()
    assert len(first.guessed) == guesses


@pytest.mark.parametrize(
    "names",
    [
        "t,v_left,v_right",
        "t,v_left,v_right,gz",
        "t,v_left,v_right,yaw_rate,lat,lon,height,left_pressure",
        "t,left_delta_ticks,right_delta_ticks,x,y,height",
    ],
)
def test_a_first_mapping_is_one_that_import_accepts(names: str, tmp_path: Path) -> None:
    first, path = made(tmp_path, names), tmp_path / "mapping.yaml"
    path.write_text(first.text, encoding="utf-8")
    topics = read_mapping(path).topics
    assert set(topics) == set(yaml.safe_load(first.text)["topics"])
    assert set(first.unused) <= {"height", "left_pressure"}


def test_a_log_without_speeds_is_refused_with_its_columns(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"left_velocity or left_position.* among t, left_pressure, lat"):
        made(tmp_path, "t,left_pressure,lat")


def test_counts_are_turns_of_a_guessed_number_and_differences_are_increments(tmp_path: Path) -> None:
    first = made(tmp_path, "t,left_delta_ticks,right_delta_ticks")
    mapping = yaml.safe_load(first.text)
    left = mapping["topics"]["sprockets"]["left_position"]
    assert left == {"column": "left_delta_ticks", "unit": "rev", "scale": 0.001, "increments": True}
    assert sum("a turn" in guess for guess in first.guessed) == 2


def test_half_a_pair_is_not_used(tmp_path: Path) -> None:
    first = made(tmp_path, "t,v_left,v_right,lat,x,left_ticks")
    assert set(first.unused) == {"lat", "x", "left_ticks"}


def test_positions_are_as_accurate_as_the_localizer_assumes_without_a_covariance(tmp_path: Path) -> None:
    topics = yaml.safe_load(made(tmp_path, "t,v_left,v_right,lat_deg,lon_deg").text)["topics"]
    assumed = node_defaults("gnss_localizer", "gnss_localizer.yaml")["assumed_stddev.single"]
    assert topics["gnss_pose"]["stddev"] == {"x": assumed, "y": assumed}
