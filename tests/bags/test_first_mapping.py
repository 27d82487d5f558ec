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
    ["t,v_left,v_right", "t,v_left,v_right,gz", "t,v_left,v_right,yaw_rate,lat,lon,height,left_pressure"],
)
def test_a_first_mapping_is_one_that_import_accepts(names: str, tmp_path: Path) -> None:
    first, path = made(tmp_path, names), tmp_path / "mapping.yaml"
    path.write_text(first.text, encoding="utf-8")
    topics = read_mapping(path).topics
    assert set(topics) == set(yaml.safe_load(first.text)["topics"])
    assert set(first.unused) <= {"height", "left_pressure"}


def test_a_log_without_speeds_is_refused_with_its_columns(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"left_velocity, right_velocity among t, left_pressure, lat"):
        made(tmp_path, "t,left_pressure,lat")


def test_positions_are_as_accurate_as_the_localizer_assumes_without_a_covariance(tmp_path: Path) -> None:
    topics = yaml.safe_load(made(tmp_path, "t,v_left,v_right,lat_deg,lon_deg").text)["topics"]
    assumed = node_defaults("gnss_localizer", "gnss_localizer.yaml")["assumed_stddev.single"]
    assert topics["gnss_pose"]["stddev"] == {"x": assumed, "y": assumed}
