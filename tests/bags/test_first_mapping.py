# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The first mapping of a CSV log: columns are found by their names, and guesses are marked."""

import math
from pathlib import Path

import pytest
import yaml

from trackslip_bags.importing.first_mapping import FirstMapping, first_mapping
from trackslip_bags.importing.importer import import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError

SIDES = ("left_velocity", "right_velocity")


def mapping_of(folder: Path, names: str, rows: str = "") -> FirstMapping:
    log = folder / "log.csv"
    rows = rows or ",".join("1" for _ in names.split(","))
    log.write_text(f"{names}\n{rows}\n", encoding="utf-8")
    return first_mapping(log, "excavator_20t", {})


@pytest.mark.parametrize(
    ("names", "columns", "guesses"),
    [
        ("t,v_left,v_right", ["t, s", "v_left, m/s", "v_right, m/s"], 3),
        ("time_ms,left_kmh,right_kmh", ["time_ms, ms", "left_kmh, km/h"], 0),
        ("t [s],wl [rad/s],wr [rad/s]", ["wl [rad/s], rad/s"], 0),
        ("Time (s),Left Speed (km/h),Right Speed (km/h)", ["Right Speed (km/h), km/h"], 0),
        ("t_s,left_mps,right_mps,yaw_rate_dps", ["yaw_rate_dps, deg/s"], 0),
        ("t_s,leftTicks,rightTicks,gyroZ", ["leftTicks, rev", "gyroZ, rad/s"], 3),
        ("t_s,meas_left_vel_mps,meas_right_vel_mps,cmd_left_vel", ["meas_left_vel_mps, m/s"], 0),
        ("t_s,left_wheel_angle_deg,right_wheel_angle_deg", ["left_wheel_angle_deg, deg"], 0),
        ("t_s,v_left_mps,v_right_mps,left_ticks,right_ticks", ["v_left_mps, m/s"], 0),
        ("t_s,left_mps,right_mps,UTM_E,UTM_N", ["UTM_E, m", "UTM_N, m"], 3),
        ("t_s,left_mps,right_mps,lat_deg,lon_deg,x_m,y_m", ["lat_deg, deg"], 1),
        ("t_s,speed_1_kmh,speed_0_kmh", ["speed_0_kmh, km/h", "speed_1_kmh, km/h"], 2),
        ("t_s,velocity[0],velocity[1]", ["velocity[0], m/s"], 4),
        (
            "t_s,Drehzahl Kettenmotor links,Drehzahl Kettenmotor rechts",
            ["Drehzahl Kettenmotor links, rpm"],
            0,
        ),
        ("t_s,Kette links [U/min],Kette rechts [U/min]", ["Kette links [U/min], rpm"], 0),
        ("t_s,Kette_links_km/h,Kette_rechts_km/h", ["Kette_links_km/h, km/h"], 0),
        ("t_s,Drive Motor Speed L [rpm],Drive Motor Speed R [rpm]", ["Drive Motor Speed L [rpm], rpm"], 0),
        ("t_s,left [ft/s],right [km/hr],heading [gon]", ["left [ft/s], ft/s", "right [km/hr], km/h"], 0),
        ("t_s,l_speed_mm_s,r_speed_mm_s", ["l_speed_mm_s, mm/s"], 0),
        ("t_s,vitesse_gauche,vitesse_droite", ["vitesse_gauche, m/s"], 2),
        ("t_s,Dist0,Dist1", ["Dist0, m", "Dist1, m"], 4),  # ArduPilot
        ("t_s,encoder_0,encoder_1", ["encoder_0, rev"], 4),
        (
            "t_s,/joints/left_wheel/velocity,/joints/right_wheel/velocity",
            ["/joints/left_wheel/velocity, m/s"],
            2,
        ),
    ],
)
def test_columns_are_found_by_their_names(
    names: str, columns: list[str], guesses: int, tmp_path: Path
) -> None:
    first = mapping_of(tmp_path, names)
    assert set(first.columns.values()) >= set(columns)
    assert len(first.guessed) == guesses


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("velocity[0]", "velocity[1]"),
        ("speed_l", "speed_r"),
        ("wheel_speed[1]", "wheel_speed[0]"),
    ],  # PX4: 0 is right
)
def test_sides_are_found_in_any_order(left: str, right: str, tmp_path: Path) -> None:
    columns = mapping_of(tmp_path, f"t_s,{right},{left}").columns
    assert columns["left_velocity"].startswith(left)
    assert columns["right_velocity"].startswith(right)


@pytest.mark.parametrize(
    ("time", "first", "second", "unit"),
    [
        ("datetime", "2026-11-20T14:30:00.00", "2026-11-20T14:30:00.02", "iso8601"),
        ("Zeitstempel", "20.11.2026 14:30:00", "20.11.2026 14:30:01", "iso8601"),
        ("__time", "1763645400.00", "1763645400.02", "s"),
        ("%time", "1763645400000000000", "1763645400020000000", "ns"),
        ("rosbagTimestamp", "1763645400000000000", "1763645400020000000", "ns"),
        ("timestamp", "1763645400000", "1763645400020", "ms"),
        ("TimeUS", "120000000", "120020000", "us"),
        ("t", "100", "120", "ms"),
        ("t", "12.00", "12.02", "s"),
        ("Elapsed Time (s)", "12.00", "12.02", "s"),
        ("gps_tow", "390600.00", "390600.02", "s"),
        ("time [hh:mm:ss]", "23:59:59.98", "00:00:00.00", "hh:mm:ss"),
        ("Uhrzeit", "23:59:59.98", "00:00:00.00", "hh:mm:ss"),
        ("Time", "59:59.9", "00:00.0", "mm:ss"),
        ("iTOW", "390600000", "390600020", "ms"),
        ("micros", "390600000", "390620000", "us"),
        ("Timestamp", "20-Nov-2026 14:30:00", "20-Nov-2026 14:30:01", "iso8601"),
        ("Timestamp", "11/20/2026 2:30:00 PM", "11/20/2026 2:30:00 PM", "mm/dd/yyyy"),
        ("Timestamp", "04/07/2026 14:30:00", "31/07/2026 14:30:00", "dd/mm/yyyy"),
        ("Timestamp", "04/07/2026 14:30:00", "04/07/2026 14:30:01", "iso8601"),
        ("utc", "\n".join(f"0959{s}.5,0,0" for s in range(50, 60)), "100000.5", "hh:mm:ss"),
        ("Time", "46346.604166667", "46346.604166898", "d"),
    ],
)
def test_the_unit_of_times_is_that_of_their_values(
    time: str, first: str, second: str, unit: str, tmp_path: Path
) -> None:
    mapping = mapping_of(tmp_path, f"{time},v_left_mps,v_right_mps", f"{first},0.5,0.5\n{second},0.5,0.5")
    assert mapping.columns["time"] == f"{time}, {unit}"
    assert ("start: -2209161600" in mapping.text) is (unit == "d")


@pytest.mark.parametrize(
    ("names", "row", "unit"),
    [
        ("header.stamp.sec,header.stamp.nanosec", "1763645400,20000000", ["s", "ns"]),
        ("secs,nsecs", "1763645400,20000000", ["s", "ns"]),
        ("Date,Time", "2026-11-20,14:30:00", "iso8601"),
        ("Date,Time", "11/20/2026,2:30:00 PM", "mm/dd/yyyy"),
        ("Date,Time", "07/04/2026,14:30:00", "iso8601"),
    ],
)
def test_times_in_two_columns_are_added(names: str, row: str, unit: object, tmp_path: Path) -> None:
    mapping = mapping_of(tmp_path, f"{names},v_left_mps,v_right_mps", f"{row},0.5,0.5")
    assert yaml.safe_load(mapping.text)["time"] == {"column": names.split(","), "unit": unit}


@pytest.mark.parametrize(
    ("name", "value", "field", "entry"),
    [
        ("Gierrate", "0.1", "angular_velocity_z", {"unit": "rad/s"}),
        ("Drehrate [°/s]", "0.1", "angular_velocity_z", {"unit": "°/s"}),
        ("imu_gz", "0.1", "angular_velocity_z", {"unit": "rad/s"}),
        ("GyrZ", "0.1", "angular_velocity_z", {"unit": "rad/s", "scale": -1.0}),
        ("gyro_rad[2]", "0.1", "angular_velocity_z", {"unit": "rad/s", "scale": -1.0}),
        ("/imu/angular_velocity/z", "0.1", "angular_velocity_z", {"unit": "rad/s"}),
        ("Breite", "48.1", "latitude", {"unit": "deg"}),
        ("Rot. Rate Z [deg/s]", "0.1", "angular_velocity_z", {"unit": "deg/s"}),
        ("omega", "0.1", "angular_velocity_z", {"unit": "rad/s"}),
        ("Azimut", "270", "heading", {"unit": "deg"}),
        ("lat", "4806.012", "latitude", {"unit": "ddmm.mmmm"}),
        ("Latitude [ddmm.mmmm]", "4806.012", "latitude", {"unit": "ddmm.mmmm"}),
        ("gps.lat", "481000000", "latitude", {"unit": "deg", "scale": 1e-7}),
    ],
)
def test_other_quantities_are_found_with_their_scales(
    name: str, value: str, field: str, entry: dict[str, object], tmp_path: Path
) -> None:
    names = f"t_s,v_left_mps,v_right_mps,{name},Länge"
    topics = yaml.safe_load(mapping_of(tmp_path, names, f"0,0.5,0.5,{value},11.5").text)["topics"]
    entries = {field: entry for topic in topics.values() for field, entry in topic.items()}
    assert entries[field] == {"column": name, **entry}


@pytest.mark.parametrize(
    "name", ["Kurs", "cmd_yaw_rate", "std_lat", "linear_acceleration.z", "yaw_rate_setpoint"]
)
def test_commands_courses_and_deviations_are_not_used(name: str, tmp_path: Path) -> None:
    assert mapping_of(tmp_path, f"t_s,v_left_mps,v_right_mps,{name},lon").unused == (name, "lon")


def test_degrees_and_minutes_are_those_of_both_coordinates(tmp_path: Path) -> None:
    """A longitude below 1° 80′ could be one in degrees."""
    columns = mapping_of(tmp_path, "t,v_left,v_right,lat,lon", "0,1,1,5128.5,12.25").columns
    assert columns["longitude"] == "lon, ddmm.mmmm"


@pytest.mark.parametrize(
    ("names", "row", "lat", "lon"),
    [
        ("lat,N/S,lon,E/W", "5128.5,N,3712.25,W", 1.0, -1.0),
        ("lat,lat_dir,lon,lon_dir", "33.8,S,151.2,E", -1.0, 1.0),
        ("lat,lon,lat_dir,lon_dir", "-33.8,151.2,S,E", 1.0, 1.0),
    ],
)
def test_coordinates_south_and_west_of_a_column_of_letters_are_negative(
    names: str, row: str, lat: float, lon: float, tmp_path: Path
) -> None:
    first = mapping_of(tmp_path, f"t,v_left,v_right,{names}", f"0,1,1,{row}")
    pose = yaml.safe_load(first.text)["topics"]["gnss_pose"]
    assert [pose[name].get("scale", 1.0) for name in ("latitude", "longitude")] == [lat, lon]


def test_units_of_a_line_below_the_names_are_those_of_the_columns(tmp_path: Path) -> None:
    units = "(ms),[km/h],km/h,deg/s"
    columns = mapping_of(tmp_path, "t,v_left,v_right,yaw_rate", f"{units}\n0,1,1,1\n20,1,1,1").columns
    assert [text.partition(", ")[2] for text in columns.values()] == ["ms", "km/h", "km/h", "deg/s"]


TABLES_BEHIND_TEXT = {
    "TOA5": """"TOA5","CR1000X","digger","12345","CR1000X.Std.04","CPU:d.CR1X","5432","Fast"
"TIMESTAMP","RECORD","left_speed","right_speed"
"TS","RN","km/h","km/h"
"","","Smp","Smp"
"2026-11-25 14:30:00.05",1,1.5,1.6
"2026-11-25 14:30:00.1",2,1.5,1.6
""",
    "InfluxDB": """#group,false,false
#datatype,dateTime:RFC3339,double
_time,left_speed_kmh,right_speed_kmh
2026-11-25T14:30:00.05Z,1.5,1.6
2026-11-25T14:30:00.1Z,1.5,1.6
""",
    "MoTeC": """"Format","MoTeC CSV File"
"Sample Rate","20","Hz"

"Time","Left Speed","Right Speed"
"s","km/h","km/h"


"0.05","1.5","1.6"
"0.1","1.5","1.6"
""",
}


@pytest.mark.parametrize("text", TABLES_BEHIND_TEXT.values(), ids=TABLES_BEHIND_TEXT)
def test_names_behind_text_are_those_over_the_rows(text: str, tmp_path: Path) -> None:
    log, mapping = tmp_path / "log.csv", tmp_path / "mapping.yaml"
    log.write_text(text, encoding="utf-8")
    first = first_mapping(log, "excavator_20t", {})
    assert first.columns["left_velocity"].endswith("km/h")
    mapping.write_text(first.text, encoding="utf-8")
    imported = import_log([log], read_mapping(mapping), tmp_path / "bag")
    assert imported.counts["/sprockets"] == 2


def test_decimal_commas_are_stated(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("Zeit;v_links;v_rechts\n0,00;0,5;0,5\n0,02;0,5;0,5\n", encoding="utf-8")
    assert yaml.safe_load(first_mapping(log, "excavator_20t", {}).text)["csv"] == {"decimal": "comma"}


@pytest.mark.parametrize(
    "names",
    [
        "t,v_left,v_right",
        "t,v_left,v_right,gz",
        "t,v_left,v_right,yaw_rate,lat,lon,height,left_pressure",
        "t,left_delta_ticks,right_delta_ticks,x,y,height",
        "secs,nsecs,velocity[0],velocity[1],heading,height",
    ],
)
def test_a_first_mapping_is_one_that_import_accepts(names: str, tmp_path: Path) -> None:
    first, path = mapping_of(tmp_path, names), tmp_path / "mapping.yaml"
    path.write_text(first.text, encoding="utf-8")
    topics = read_mapping(path).topics
    assert set(topics) == set(yaml.safe_load(first.text)["topics"])
    assert set(first.unused) <= {"height", "left_pressure"}


def test_a_log_without_speeds_is_refused_with_its_columns(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"left_velocity or left_position.* among t, left_pressure, lat"):
        mapping_of(tmp_path, "t,left_pressure,lat")


def test_an_unknown_unit_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unit of 'left \[fpm\]' is unknown; unit of 'right \[fpm\]'"):
        mapping_of(tmp_path, "t_s,left [fpm],right [fpm],yaw_rate [deg/s],temperature [K]")


@pytest.mark.parametrize(
    ("turn", "unit"), [(2.0 * math.pi, "rad"), (360.0, "deg"), (400.0, "gon"), (3.0, "deg")]
)
def test_unit_of_headings_is_that_of_their_full_turn(turn: float, unit: str, tmp_path: Path) -> None:
    headings = [(0.33 + 0.05 * k) % 1.0 * turn for k in range(20)]
    rows = "\n".join(f"{k},1,1,{heading:.4f}" for k, heading in enumerate(headings))
    first = mapping_of(tmp_path, "t_s,left_mps,right_mps,heading", rows)
    assert first.columns["heading"] == f"heading, {unit}"
    assert f"unit of heading: {unit}" in first.guessed


def test_counts_are_turns_of_a_guessed_number_and_differences_are_increments(tmp_path: Path) -> None:
    first = mapping_of(tmp_path, "t,left_delta_ticks,right_delta_ticks")
    mapping = yaml.safe_load(first.text)
    left = mapping["topics"]["sprockets"]["left_position"]
    assert left == {"column": "left_delta_ticks", "unit": "rev", "scale": 0.001, "increments": True}
    assert sum("a turn" in guess for guess in first.guessed) == 2


@pytest.mark.parametrize(
    ("name", "cell", "is_used"),
    [
        ("fix_quality", "4", True),
        ("Quality", "1", True),
        ("signal_quality", "4", False),
        ("quality", "87", False),
        ("quality", "RTK", False),
    ],
)
def test_quality_of_positions_is_used(tmp_path: Path, name: str, cell: str, is_used: bool) -> None:
    names = f"t,v_left,v_right,lat_deg,lon_deg,{name}"
    topics = yaml.safe_load(mapping_of(tmp_path, names, f"0,0,0,48,11,{cell}").text)["topics"]
    assert topics["gnss_pose"].get("quality") == ({"column": name} if is_used else None)


def test_half_a_pair_is_not_used(tmp_path: Path) -> None:
    first = mapping_of(tmp_path, "t,v_left,v_right,lat,x,left_ticks")
    assert set(first.unused) == {"lat", "x", "left_ticks"}


def test_positions_are_as_accurate_as_the_localizer_assumes_without_a_covariance(tmp_path: Path) -> None:
    topics = yaml.safe_load(mapping_of(tmp_path, "t,v_left,v_right,lat_deg,lon_deg").text)["topics"]
    assumed = node_defaults("gnss_localizer", "gnss_localizer.yaml")["assumed_stddev.single"]
    assert topics["gnss_pose"]["stddev"] == {"x": assumed, "y": assumed}
