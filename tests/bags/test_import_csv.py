# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Typical CSV logs: several files, blank cells, dates, latitudes, ground speeds, one gyro axis."""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.imports import import_logs
from hypothesis import given
from hypothesis import strategies as st

from trackslip_bags.importing.columns import TimeColumn
from trackslip_bags.importing.importer import Imported
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.importing.times import time_ns
from trackslip_common.config_files import config_file, node_defaults
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_common.units import UNITS
from trackslip_estimation.slip.measurements import UNOBSERVED

GEOMETRY = {"rolling_radius": 0.5, "tread": 2.0}
T = {"column": "t", "unit": "s"}
WHEELS = {
    "left_velocity": {"column": "l", "unit": "rad/s"},
    "right_velocity": {"column": "r", "unit": "rad/s"},
}
XY = {"x": {"column": "x", "unit": "m"}, "y": {"column": "y", "unit": "m"}}
CERTAIN = {"x": 0.1, "y": 0.1}


def imported(
    folder: Path, logs: str | dict[str, str], topics: dict[str, Any], **more: Any
) -> tuple[Imported, dict[str, list[Any]]]:
    """The importer's result for logs given as text, and the messages by topic."""
    files = logs if isinstance(logs, dict) else {"log.csv": logs}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return import_logs(folder, [folder / name for name in files], **{"time": T, **more}, topics=topics)


def covariance(message: Any) -> np.ndarray[Any, Any]:
    """(3, 3) covariance of x, y, yaw."""
    of_plane: np.ndarray[Any, Any] = message.pose.covariance.reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))]
    return of_plane


def test_several_files_have_their_own_columns_times_and_rates(tmp_path: Path) -> None:
    files = {
        "imu.csv": "stamp,gz\n1000,0.1\n1010,0.2\n1020,0.3\n",
        "wheels.csv": "t;l;r\n1.0;4;5\n1.02;4;5\n",
        "gps_2.tsv": "t\tx\ty\n1.015\t7\t8\n",
    }
    gyro = {"angular_velocity_z": {"column": "gz", "unit": "rad/s"}}
    topics = {
        "sprockets": {"file": "wheels.csv", **WHEELS},
        "imu/data_raw": {"file": "imu*", "time": {"column": "stamp", "unit": "ms"}, **gyro},
        "gnss_pose": {"file": "gps*", **XY, "stddev": CERTAIN},
    }
    result, messages = imported(tmp_path, files, topics)
    assert result.counts == {"/sprockets": 2, "/imu/data_raw": 3, "/gnss_pose": 1}
    assert [stamp_ns_of(m) // 1_000_000 for m in messages["imu/data_raw"]] == [1000, 1010, 1020]


@pytest.mark.parametrize(
    ("of_file", "message"),
    [
        ({}, "key 'file' is missing; accepted: a name or pattern of a.csv, b.csv"),
        ({"file": "c.csv"}, "no file 'c.csv'"),
    ],
)
def test_which_file_must_be_clear(tmp_path: Path, of_file: dict[str, str], message: str) -> None:
    files = {"a.csv": "t,l,r\n1,2,3\n", "b.csv": "t,l,r,x\n1,2,3,4\n"}
    with pytest.raises(InputError) as caught:
        imported(tmp_path, files, {"sprockets": {**WHEELS, **of_file}})
    assert message in str(caught.value)


PARTS = {f"log_{k}.csv": f"t,l,r\n{k},{k},0\n{k}.5,{k},0\n" for k in (10, 9, 11)}


@pytest.mark.parametrize("of_file", [{}, {"file": "log_*.csv"}])
def test_parts_of_a_log_are_one(tmp_path: Path, of_file: dict[str, str]) -> None:
    _, messages = imported(tmp_path, PARTS, {"sprockets": {**WHEELS, **of_file}})
    assert [stamp_ns_of(m) * 1e-9 for m in messages["sprockets"]] == [9.0, 9.5, 10.0, 10.5, 11.0, 11.5]
    assert [m.velocity[0] for m in messages["sprockets"]] == [9.0, 9.0, 10.0, 10.0, 11.0, 11.0]


def test_parts_of_a_log_that_overlap_are_refused(tmp_path: Path) -> None:
    parts = {**PARTS, "log_11.csv": "t,l,r\n10.2,1,1\n"}
    with pytest.raises(InputError, match=r"log_11.csv: line 2, column 't' goes back"):
        imported(tmp_path, parts, {"sprockets": WHEELS})


def test_spreads_of_each_row_are_those_of_columns(tmp_path: Path) -> None:
    """Covariances of poses; one gyro axis leaves the others unknown; odometry has none."""
    axes = {axis: {"column": f"{axis}{axis}", "unit": "cm^2"} for axis in "xy"}
    topics = {
        "gnss_pose": {**XY, "covariance": {"xy": {"column": "xy", "unit": "cm^2"}, **axes}},
        "imu/data_raw": {
            "angular_velocity_z": {"column": "g", "unit": "deg/s"},
            "stddev": {"angular_velocity_z": 0.01},
        },
        "camera": {"role": "odometry", **XY, "yaw": {"column": "g", "unit": "deg"}},
    }
    _, messages = imported(tmp_path, "t,x,y,xx,yy,xy,g\n1,5,6,4,9,-1,90\n", topics)
    (pose,), (imu,), (odometry,) = (messages[topic] for topic in topics)
    np.testing.assert_allclose(covariance(pose)[:2, :2], [[4e-4, -1e-4], [-1e-4, 9e-4]])
    assert imu.angular_velocity.z == pytest.approx(math.pi / 2.0)
    np.testing.assert_allclose(np.diag(imu.angular_velocity_covariance.reshape(3, 3)), (1e6, 1e6, 1e-4))
    assert imu.linear_acceleration_covariance[0] == -1.0
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    assert (place.x, place.y, place.z, turn.z) == (5.0, 6.0, 0.0, pytest.approx(math.sqrt(0.5)))
    assert not odometry.pose.covariance.any()
    assert not odometry.twist.covariance.any()


def test_a_blank_cell_is_no_value_in_this_row(tmp_path: Path) -> None:
    """Rows of several rates share a file; a fix with a blank heading has no heading."""
    log = (
        "t,l,r,x,y,yaw,s\n1,2,3,,,,\n2,2,3,5,6,,0.2\n3,nan,NA,7,8,1.5,0.1\n4,2,,,,,\n,2,3,,,,\n5,2,3,5,6,1,\n"
    )
    pose = {**XY, "yaw": {"column": "yaw", "unit": "rad"}}
    stddev = {"x": {"column": "s", "unit": "m"}, "y": 0.3, "yaw": 0.05}
    result, messages = imported(tmp_path, log, {"sprockets": WHEELS, "gnss_pose": {**pose, "stddev": stddev}})
    assert [stamp_ns_of(m) // 10**9 for m in messages["sprockets"]] == [1, 2, 5]
    assert result.left_out["/sprockets"] == {"some cells are blank": 1, "no time": 1}
    assert result.left_out["/gnss_pose"] == {"no standard deviation of x above 0": 1}
    first, second = (np.diag(covariance(m)) for m in messages["gnss_pose"])
    np.testing.assert_allclose(first, (0.04, 0.09, 1e6))
    np.testing.assert_allclose(second, (0.01, 0.09, 0.0025))


@pytest.mark.parametrize(
    ("columns", "row"),
    [
        ({s: {"column": s[0], "unit": "km/h"} for s in ("left_velocity", "right_velocity")}, "3.6,7.2"),
        ({s: {"column": s[0], "unit": "rpm"} for s in WHEELS}, f"{60.0 / math.pi},{120.0 / math.pi}"),
        ({"speed": {"column": "l", "unit": "m/s"}, "yaw_rate": {"column": "r", "unit": "rad/s"}}, "1.5,0.5"),
        (
            {
                s: {"column": ["l", "r"], "unit": "rad/s", "scale": k}
                for s, k in zip(WHEELS, (1, 2), strict=True)
            },
            "1,3",
        ),
    ],
)
def test_speeds_of_any_kind_become_sprockets(tmp_path: Path, columns: dict[str, Any], row: str) -> None:
    """1 and 2 m/s of the tracks give 2 and 4 rad/s, as do a twist and means of two columns."""
    topic = {**columns, "geometry": GEOMETRY}
    _, messages = imported(tmp_path, f"t,l,r\n1,{row}\n", {"sprockets": topic})
    np.testing.assert_allclose(messages["sprockets"][0].velocity, (2.0, 4.0))


def test_positions_alone_give_velocities(tmp_path: Path) -> None:
    columns = {s: {"column": s[0], "unit": "deg"} for s in ("left_position", "right_position")}
    _, messages = imported(tmp_path, "t,l,r\n1,0,0\n1.5,90,-45\n2.5,90,45\n", {"sprockets": columns})
    expected = np.array(((1, -0.5), (1, -0.5), (0, 0.5))) * math.pi
    np.testing.assert_allclose([m.velocity for m in messages["sprockets"]], expected, atol=1e-12)
    assert messages["sprockets"][1].position[0] == pytest.approx(math.pi / 2.0)


def test_latitude_and_longitude_become_fixes_and_local_poses(tmp_path: Path) -> None:
    """A minute of latitude is about a nautical mile; a receiver without a fix writes zeros."""
    rows = ("1,48.0,11.0,4,0,0.01", "2,48.01666667,11.0,5,90,0.2", "3,0,0,0,0,9", "4,48,11.001,7,,0.01")
    log = "\n".join(("t,lat,lon,q,cog,s", *rows, ""))
    place = {k: {"column": k[:3], "unit": "deg"} for k in ("latitude", "longitude")}
    stddev = {"x": {"column": "s", "unit": "m"}, "y": {"column": "s", "unit": "m"}}
    topics = {
        "fix": {**place, "quality": {"column": "q"}, "stddev": stddev},
        "gnss_pose": {
            **place,
            "heading": {"column": "cog", "unit": "deg"},
            "stddev": {**stddev, "yaw": 0.01},
            "frame": "map",
        },
    }
    result, messages = imported(tmp_path, log, topics)
    fixes, poses = messages["fix"], messages["gnss_pose"]
    assert [m.status.status for m in fixes] == [2, 2, -1]  # no fix of a kind that GGA does not have
    assert (fixes[1].latitude, fixes[1].position_covariance_type) == (pytest.approx(48.01666667), 2)
    np.testing.assert_allclose(fixes[1].position_covariance[[0, 4]], 0.04)
    assert math.isnan(fixes[0].altitude)
    places = [(m.pose.pose.position.x, m.pose.pose.position.y) for m in poses]
    np.testing.assert_allclose(places[:2], ((0, 0), (0, 1853.3)), atol=0.5)
    assert places[2][0] == pytest.approx(74.6, abs=0.1)
    turns = [2.0 * math.atan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w) for m in poses]
    np.testing.assert_allclose(turns, (math.pi / 2.0, 0.0, 0.0), atol=1e-9)
    assert [covariance(m)[2, 2] for m in poses] == pytest.approx([1e-4, 1e-4, 1e6])
    assert result.left_out["/gnss_pose"] == {"latitude and longitude are 0": 1}
    assert result.datum is not None
    assert result.datum[:2] == (pytest.approx(48.0), pytest.approx(11.0))


def test_quality_limits_the_accuracy_of_positions(tmp_path: Path) -> None:
    """A standard deviation as a number is that of fixed ambiguities; a column is of each row."""
    log = "t,e,n,q,s\n1,0,0,4,0.5\n2,0,1,5,0.5\n3,0,2,1,0.5\n4,0,3,0,0.5\n"
    place = {"x": {"column": "e", "unit": "m"}, "y": {"column": "n", "unit": "m"}, "quality": {"column": "q"}}
    stddev = {"x": 0.02, "y": {"column": "s", "unit": "m"}}
    result, messages = imported(tmp_path, log, {"gnss_pose": {**place, "stddev": stddev}})
    assumed = node_defaults("gnss_localizer", "gnss_localizer.yaml")
    stddevs = np.sqrt([np.diag(covariance(m))[:2] for m in messages["gnss_pose"]])
    expected = (0.02, assumed["assumed_stddev.rtk"], assumed["assumed_stddev.single"])
    np.testing.assert_allclose(stddevs, np.column_stack((expected, (0.5, 0.5, 0.5))))
    assert result.left_out["/gnss_pose"] == {"no fix by its quality": 1}


@pytest.mark.parametrize(("origin", "expected"), [(500_000.0, (3.0, 4.0)), ("first", (0.0, 1.0))])
def test_an_origin_is_subtracted(tmp_path: Path, origin: Any, expected: tuple[float, float]) -> None:
    easting = {"x": {"column": "x", "unit": "m", "origin": origin}, "y": XY["y"], "stddev": CERTAIN}
    _, messages = imported(tmp_path, "t,x,y\n1,500003,0\n2,500004,0\n", {"reference_pose": easting})
    assert tuple(m.pose.pose.position.x for m in messages["reference_pose"]) == expected


def test_receive_time_of_a_row_is_kept(tmp_path: Path) -> None:
    """Stamps may then decrease; the bag has the order of arrival."""
    pose = {**XY, "stddev": CERTAIN, "received": {"column": "rx", "unit": "s"}}
    log = "t,rx,x,y\n1,1.5,1,0\n3,3.1,2,0\n2,3.2,3,0\n"
    result, messages = imported(tmp_path, log, {"gnss_pose": pose})
    assert [m.pose.pose.position.x for m in messages["gnss_pose"]] == [1, 2, 3]
    assert result.lateness["/gnss_pose"].longest == pytest.approx(1.2)


TIMES = {
    "2026-11-20T14:30:00Z": 1_795_185_000_000_000_000,
    "2026-11-20 14:30:00.25": 1_795_185_000_250_000_000,
    "2026-11-20T15:30:00.000000001+01:00": 1_795_185_000_000_000_001,
    "2026-11-20T14:30": 1_795_185_000_000_000_000,
    "20261120T143000,5Z": 1_795_185_000_500_000_000,
    "20.11.2026 14:30:00,5": 1_795_185_000_500_000_000,
    "2026/11/20 14:30:00.5": 1_795_185_000_500_000_000,
    "20-Nov-2026 14:30:00.5": 1_795_185_000_500_000_000,
    "20 November 2026 14:30:00.5": 1_795_185_000_500_000_000,
    "2026-11-20 14:30:00:500": 1_795_185_000_500_000_000,
    "2026-11-20 14:30:00.5 UTC": 1_795_185_000_500_000_000,
    "2026-11-20T14:30:00.5GMT": 1_795_185_000_500_000_000,
}


@pytest.mark.parametrize("cell", TIMES)
def test_dates_are_exact(cell: str) -> None:
    assert time_ns([cell], TimeColumn(("t",), ("iso8601",))) == TIMES[cell]


@pytest.mark.parametrize(
    ("cell", "unit"),
    [
        ("11/20/2026 2:30:00.25 PM", "mm/dd/yyyy"),
        ("11/20/2026 14:30:00.25", "mm/dd/yyyy"),
        ("20/11/2026 14:30:00.25", "dd/mm/yyyy"),
    ],
)
def test_dates_with_slashes_need_a_unit_that_states_their_order(cell: str, unit: str) -> None:
    assert time_ns([cell], TimeColumn(("t",), (unit,))) == TIMES["2026-11-20 14:30:00.25"]
    with pytest.raises(ValueError, match=cell):
        time_ns([cell], TimeColumn(("t",), ("iso8601",)))


@given(st.integers(0, 2**31 * 10**9 - 1), st.sampled_from(["s", "ms", "us", "ns"]))
def test_epochs_of_any_unit_are_exact(stamp_ns: int, unit: str) -> None:
    digits = {"s": 9, "ms": 6, "us": 3, "ns": 0}[unit]
    whole, rest = divmod(stamp_ns, 10**digits)
    cell = f"{whole}.{rest:0{digits}d}" if digits else str(whole)
    assert time_ns([cell], TimeColumn(("t",), (unit,))) == stamp_ns


@pytest.mark.parametrize(
    "cell", ["9" * 30, "1e999999", "1e9999999999999999999", "inf", "NaN5", "9999-01-01T00:00", ""]
)
def test_what_is_no_time_is_refused(cell: str) -> None:
    for unit in ("s", "ns", "iso8601"):
        with pytest.raises(ValueError, match=r".*"):
            time_ns([cell], TimeColumn(("t",), (unit,)))


@given(st.text("0123456789+-.,:/ TZAPMeEnaif", max_size=30), st.sampled_from([*UNITS["time"], "iso8601"]))
def test_no_cell_is_worse_than_a_wrong_time(cell: str, unit: str) -> None:
    try:
        time = time_ns([cell], TimeColumn(("t",), (unit,)))
    except ValueError:
        return
    assert abs(time) < 2**63


def test_trajectories_of_tum_are_read(tmp_path: Path) -> None:
    log = "# timestamp tx ty tz qx qy qz qw\n1.5 3.0 4.0 0.0 0.0 0.0 0.0 1.0\n"
    log += "2.5 3.1 4.0 0 0 0 0.7071068 0.7071068\n3.5 3.2 4.0 0 0 0 0 0\n"
    pose = {name: {"column": column, "unit": "m"} for name, column in (("x", "tx"), ("y", "ty"))}
    pose |= {q: {"column": q} for q in ("qx", "qy", "qz", "qw")}
    topics = {"box_pose": {**pose, "stddev": {"x": 0.1, "y": 0.1, "yaw": 0.1}}}
    time = {"column": "timestamp", "unit": "s"}
    _, messages = imported(tmp_path, log, topics, csv={"format": "tum"}, time=time)
    first, second, without_heading = messages["box_pose"]
    assert covariance(without_heading)[2, 2] == UNOBSERVED
    assert (first.pose.pose.position.x, first.pose.pose.position.y) == (3.0, 4.0)
    assert second.pose.pose.orientation.z == pytest.approx(math.sqrt(0.5))


def test_times_that_lost_their_digits_are_refused_with_their_count(tmp_path: Path) -> None:
    log = "t,l,r\n" + "1.73234e+09,2,3\n" * 60
    with pytest.raises(InputError, match=r"column 't': 60 rows at one time, 1732340000 s"):
        imported(tmp_path, log, {"sprockets": WHEELS})


def test_rows_that_share_a_time_are_counted(tmp_path: Path) -> None:
    log = "t,l,r\n" + "".join(f"{k // 5 / 2},2,3\n" for k in range(60))
    result, messages = imported(tmp_path, log, {"sprockets": WHEELS})
    assert len(messages["sprockets"]) == 60
    assert result.notes == ["sprockets: 48 of 60 rows share a time with the row before"]


def test_stated_values_are_read_as_missing(tmp_path: Path) -> None:
    log = "t,l,r\n" + "".join(
        f"{k},{2 if k % 5 == 0 else 0},{3 if k % 5 == 0 else -999}\n" for k in range(100)
    )
    result, messages = imported(tmp_path, log, {"sprockets": WHEELS})
    assert any("column 'l' is 0 in 80 % of its rows" in note for note in result.notes)
    (folder := tmp_path / "stated").mkdir()
    columns = {name: {**column, "missing": [0, -999]} for name, column in WHEELS.items()}
    result, messages = imported(folder, log, {"sprockets": columns})
    assert [list(m.velocity) for m in messages["sprockets"]] == [[2.0, 3.0]] * 20
    assert result.notes == []


def test_counts_of_each_interval_add_up(tmp_path: Path) -> None:
    log = "t,l,r\n0,1,2\n1,3,-4\n2,5,6\n"
    columns = {
        f"{side}_position": {"column": side[0], "unit": "deg", "increments": True}
        for side in ("left", "right")
    }
    _, messages = imported(tmp_path, log, {"sprockets": columns})
    degrees = np.degrees([m.position for m in messages["sprockets"]])
    np.testing.assert_allclose(degrees, [[1.0, 2.0], [4.0, -2.0], [9.0, 4.0]])


@pytest.mark.parametrize("name", ["warthog", "gnss_machine", "four_wheels"])
def test_the_mappings_of_the_project_are_read(name: str) -> None:
    mapping = read_mapping(config_file(f"mappings/{name}.yaml"))
    assert "sprockets" in mapping.topics
    assert mapping.vehicle is not None


def test_words_for_no_value_leave_a_row_out(tmp_path: Path) -> None:
    words = ("-", "--", "?", "#N/A", "#DIV/0!", "(null)", "1.#QNAN", "-1.#IND", "nil")
    rows = "".join(f"2,{word},3\n" for word in words)
    result, messages = imported(tmp_path, f"t,l,r\n1,2,3\n{rows}3,2,3\n", {"sprockets": WHEELS})
    assert len(messages["sprockets"]) == 2
    assert result.left_out == {"/sprockets": {"some cells are blank": len(words)}}


@pytest.mark.parametrize(
    ("times", "unit", "message"),
    [
        (("1791000000.05", "1791000000.025"), "s", "goes back from 1791000000.05 s to 1791000000.025 s;"),
        (("1791000000050", "1791000000025"), "ms", "goes back from 1791000000.05 s to 1791000000.025 s;"),
        (
            ("2026-10-25T02:59:59.95", "2026-10-25T02:00:00"),
            "iso8601",
            "goes back from 2026-10-25T02:59:59.95Z to 2026-10-25T02:00:00Z;",
        ),
        (("12:00:00", "11:59:59"), "hh:mm:ss", "goes back from 43200 s to 43199 s;"),
        (("30:00.1", "30:61.0"), "mm:ss", ": '30:61.0' is not accepted; accepted: as 30:00.25,"),
        (("12:00:00", "12:61:00"), "hh:mm:ss", ": '12:61:00' is not accepted; accepted: as 14:30:00.25,"),
    ],
)
def test_wrong_times_are_shown_to_the_digit_that_differs(
    times: tuple[str, str], unit: str, message: str, tmp_path: Path
) -> None:
    log = "".join(("t,l,r\n", *(f"{time},1,1\n" for time in times)))
    with pytest.raises(InputError, match=re.escape(f"line 3, column 't' {message}".replace("' :", "':"))):
        imported(tmp_path, log, {"sprockets": WHEELS}, time={"column": "t", "unit": unit})


def test_times_of_day_without_colons_are_no_seconds(tmp_path: Path) -> None:
    rows = [f"{k // 60}{k % 60:02d}{s:02d}.5,1,1" for k in (1439, 0, 598, 599, 600) for s in range(60)]
    log = "\n".join(("t,l,r", *rows))
    with pytest.raises(InputError, match=r"column .t. has no second 60 to 99.*; accepted: unit: hh:mm:ss"):
        imported(tmp_path, log, {"sprockets": WHEELS})
    time = {"column": "t", "unit": "hh:mm:ss"}
    _, messages = imported(tmp_path, log, {"sprockets": WHEELS}, time=time)
    stamps = [stamp_ns_of(m) * 1e-9 for m in messages["sprockets"]]
    assert stamps[60] - stamps[59] == 1.0
    assert stamps[-1] - stamps[0] == pytest.approx(10 * 3600 + 119.0)


@pytest.mark.parametrize(
    ("times", "unit"),
    [
        (("604798", "604799.5", "0.5"), "s"),  # of a GPS week
        (("604798000", "604799500", "500"), "ms"),
        (("4294000000", "4294967295", "967295"), "us"),  # 32 bit
        (("4294966296", "4294967295", "999"), "ms"),
        (("59:58.0", "59:59.5", "00:00.5"), "mm:ss"),
        (("23:59:58", "23:59:59:500", "00:00:00:500"), "hh:mm:ss"),
    ],
)
def test_times_that_begin_again_go_on(times: tuple[str, ...], unit: str, tmp_path: Path) -> None:
    log = "".join(("t,l,r\n", *(f"{time},1,1\n" for time in times)))
    time = {"column": "t", "unit": unit}
    result, messages = imported(tmp_path, log, {"sprockets": WHEELS}, time=time)
    stamps = [stamp_ns_of(message) * 1e-9 for message in messages["sprockets"]]
    assert 0.9 < stamps[2] - stamps[1] < 1.1
    assert [note for note in result.notes if "begins again" in note]


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [
        ("33°53'20.4\"S", "151°11'34.8\"W"),
        ("S 33° 53' 20.4''", "W151°11'34.8''"),
        ('"33°53\'20.4""S"', '"151 11 34.8 W"'),
        ("-33°53.34'", "-151°11.58'"),
        ("33.889 S", "151.193W"),
        ("-33.889°", "-151.193º"),
        ("33°53.34′S", "151° 11′ 34.8″ W"),
    ],
)
def test_positions_with_signs_of_degrees_or_letters_are_read(
    latitude: str, longitude: str, tmp_path: Path
) -> None:
    degrees = {name: {"column": name, "unit": "deg"} for name in ("latitude", "longitude")}
    log = f"t;latitude;longitude\n1;{latitude};{longitude}\n2;-;NaN\n3;{latitude};{longitude}\n"
    _, messages = imported(tmp_path, log, {"fix": degrees})
    for message in messages["fix"]:
        assert message.latitude == pytest.approx(-33.889, abs=1e-9)
        assert message.longitude == pytest.approx(-151.193, abs=1e-9)


@pytest.mark.parametrize("cell", ["33°53'70\"S", "33°S5", "33N S", "N", "33.889 nord"])
def test_positions_of_another_form_are_refused(cell: str, tmp_path: Path) -> None:
    degrees = {name: {"column": name, "unit": "deg"} for name in ("latitude", "longitude")}
    with pytest.raises(InputError, match="line 2, column 'latitude'"):
        imported(tmp_path, f"t;latitude;longitude\n1;{cell};9\n", {"fix": degrees})


class Written(NamedTuple):
    """A table with one row that is used: at 1 s, 2 and 3 rad/s."""

    content: str
    csv: dict[str, Any] | None = None
    note: str = ""
    encoding: str = "utf-8"


TABLES = {
    "a mark": Written("\ufefft,l,r\n1,2,3\n"),
    "comments": Written("# a log\n#\n\nt,l,r\n# began\n1,2,3\n"),
    "names in a comment": Written("# made by hand\n# t, l, r\n1, 2, 3\n"),
    "units": Written("t,l,r\n[s],[rad/s],[rad/s]\n1,2,3\n", note="line 2 is taken for units"),
    "semicolons": Written("t;l;r\n1;2;3\n"),
    "tabs": Written("t\tl\tr\n1\t2\t3\n"),
    "pipes": Written("t|l|r\n1|2|3\n"),
    "quotes": Written('"t","l","r"\n"1","2","3"\n'),
    "windows": Written("t,l,r\r\n1,2,3\r\n\r\n"),
    "no end": Written("t,l,r\n1,2,3"),
    "spaces": Written("t , l, r\n 1 , 2 , 3\n"),
    "blanks behind": Written("t,l,r,,\n1,2,3,,\n"),
    "a delimiter behind": Written("t,l,x,y,r\n1,2,,,3,\n"),
    "a quoted comma before a delimiter behind": Written('t,l,x,y,r\n1,2,,"a,b",3,\n'),
    "blanks between": Written("t l r\n1 2  3\n"),
    "blanks before": Written("  t   l r\n  1   2 3\n"),
    "a spreadsheet's separator": Written("sep=;\nt;l;r\n1;2;3\n"),
    "text before the names": Written("Logger X v2.3\nVehicle: digger 7\n\nt,l,r\n1,2,3\n"),
    "signs": Written("t,l,r\n+1,+2.0,+3E0\n"),
    "a quoted comma": Written('t,"a, b",l,r\n1,"x, y",2,3\n'),
    "cut off": Written("t,l,r\n1,2,3\n2,2", note="line 3, the last, is cut off and left out"),
    "zeros behind": Written("t,l,r\n1,2,3\n" + "\0" * 2, note="ends in zero bytes"),
    "zeros after a cut": Written("t,l,r\n1,2,3\n4,2" + "\0" * (1 << 21), note="ends in zero bytes"),
    "utf-16": Written("t,l,r,°\n1,2,3,4\n", encoding="utf-16"),
    "utf-16-le": Written("t,l,r,°\n1,2,3,4\n", encoding="utf-16-le"),
    "utf-16-be": Written("t,l,r,°\n1,2,3,4\n", encoding="utf-16-be"),
    "cp1252": Written("t,l,r,°\n1,2,3,4\n", encoding="cp1252", note="not UTF-8; read as cp1252"),
    "no names": Written("1,x,2,3\n", {"names": ["t", "a", "l", "r"]}),
    "decimal commas": Written("t;l;r\n1,0;2,0;3,0\n", {"decimal": "comma"}),
    "decimal commas, names": Written("1,0\t2,0\t3,0\n", {"decimal": "comma", "names": ["t", "l", "r"]}),
    "another delimiter": Written("t;a;l;r\n1;x,y,z,q,w;2;3\n", {"delimiter": ";"}),
}


@pytest.mark.parametrize("habit", TABLES)
def test_habits_of_those_who_write_logs(tmp_path: Path, habit: str) -> None:
    content, csv, note, encoding = TABLES[habit]
    (tmp_path / "log.csv").write_bytes(content.encode(encoding))
    sections = {"time": T, "topics": {"sprockets": WHEELS}, "csv": csv or {}}
    result, messages = import_logs(tmp_path, tmp_path / "log.csv", **sections)
    (only,) = messages["sprockets"]
    assert (stamp_ns_of(only), list(only.velocity)) == (10**9, [2.0, 3.0])
    assert any(note in noted for noted in result.notes) if note else not result.notes


STAMPED = {  # header and rows of times → mapping of the time, stamps
    ("secs,ns", "1795185000,250000000"): (
        {"time": {"column": ["secs", "ns"], "unit": ["s", "ns"]}},
        [TIMES["2026-11-20 14:30:00.25"]],
    ),
    ("date,time", "2026-11-20,14:30:00.25"): (
        {"time": {"column": ["date", "time"], "unit": "iso8601"}},
        [TIMES["2026-11-20 14:30:00.25"]],
    ),
    ("t", "2026-11-20T12:00:00"): (
        {"time": {"column": "t", "unit": "iso8601", "zone": "-02:30"}},
        [TIMES["2026-11-20T14:30:00Z"]],
    ),
    ("t", "45981.5", "45981.5000001"): (  # days of a spreadsheet: 2025-11-20, 12:00
        {"time": {"column": "t", "unit": "d"}, "start": -2209161600},
        [1_763_640_000_000_000_000, 1_763_640_000_008_640_000],
    ),
    ("t", "23:59:59.9", "00:00:00.15", "0:00:01"): (
        {"time": {"column": "t", "unit": "hh:mm:ss"}},
        [86_399_900_000_000, 86_400_150_000_000, 86_401_000_000_000],
    ),
}


@pytest.mark.parametrize("lines", STAMPED)
def test_times_of_other_columns_are_exact(tmp_path: Path, lines: tuple[str, ...]) -> None:
    mapping, stamps = STAMPED[lines]
    log = "".join((f"{lines[0]},l,r\n", *(f"{row},2,3\n" for row in lines[1:])))
    _, messages = imported(tmp_path, log, {"sprockets": WHEELS}, **mapping)
    assert [stamp_ns_of(message) for message in messages["sprockets"]] == stamps
