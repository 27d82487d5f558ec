# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A CSV log and a mapping become a bag; every mistake in either gives one clear line."""

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from trackslip_bags.importing.importer import import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.parameters import PARAMETERS_TOPIC, bag_parameters, bag_vehicle
from trackslip_bags.reader import Bag, open_bag
from trackslip_common.errors import ExitCode, InputError
from trackslip_common.make import stamp_ns_of
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.slip.measurements import UNOBSERVED
from trackslip_tools.cli.main import main

LOG = """\
t,wl,wr,gx,gy,gz,n,x,y,heading,pl,pr
1000,180,-90,0,0,90,7,0,0,0,10,20
1050,180,-90,0,0,90,7,0,0,0,10,20
1100,360,-90,0,0,90,8,150,-25,90,10,20
1150,360,-90,0,0,90,8,150,-25,90,10,20
1200,360,-90,0,0,90,9,300,-50,180,10,20
"""

MAPPING: dict[str, Any] = {
    "time": {"column": "t", "unit": "ms"},
    "start": 100.0,
    "topics": {
        "sprockets": {
            "left_velocity": {"column": "wl", "unit": "deg/s"},
            "right_velocity": {"column": "wr", "unit": "deg/s", "scale": -1.0},
            "time_offset": 0.02,
        },
        "imu/data_raw": {
            "angular_velocity_x": {"column": "gx", "unit": "deg/s"},
            "angular_velocity_y": {"column": "gy", "unit": "deg/s"},
            "angular_velocity_z": {"column": "gz", "unit": "deg/s"},
        },
        "reference_pose": {
            "x": {"column": "x", "unit": "cm"},
            "y": {"column": "y", "unit": "cm"},
            "yaw": {"column": "heading", "unit": "deg"},
            "new_when_changes": "n",
            "time_offset": -0.4,
            "stddev": {"x": 0.1, "y": 0.2, "yaw": 0.3},
        },
    },
    "parameters": {"pose_sources": ["reference_pose"]},
}


def import_text(folder: Path, log: str = LOG, mapping: dict[str, Any] = MAPPING) -> Path:
    """Import a log and a mapping given as text; return the path of the bag."""
    (folder / "log.csv").write_text(log, encoding="utf-8")
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping), encoding="utf-8")
    import_log([folder / "log.csv"], read_mapping(folder / "map.yaml"), folder / "bag")
    return folder / "bag"


def refusal(folder: Path, **parts: Any) -> str:
    """The error, one line, of a log or mapping that is refused without a trace of a bag."""
    with pytest.raises(InputError) as caught:
        import_text(folder, **parts)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)
    assert not (folder / "bag").exists()
    return str(caught.value)


def contents(bag: Bag, topic: str) -> list[Any]:
    return [bag.deserialize(message.raw, message.type_name) for message in bag.messages([topic])]


def changed(**filters: Any) -> dict[str, Any]:
    """The valid mapping with dotted keys changed (None removes); `__` stands for the dot."""
    mapping = copy.deepcopy(MAPPING)
    for dotted, value in filters.items():
        *parents, last = dotted.split("__")
        section = mapping
        for name in parents:
            section = section[{"imu": "imu/data_raw"}.get(name, name)]
        if value is None:
            del section[last]
        else:
            section[last] = value
    return mapping


def test_units_signs_and_offsets(tmp_path: Path) -> None:
    with open_bag(import_text(tmp_path)) as bag:
        first, *logged = ((m.topic, m.log_time_ns) for m in bag.messages())
        sprockets = contents(bag, "sprockets")
        imu = contents(bag, "imu/data_raw")
        poses = contents(bag, "reference_pose")
    assert [stamp_ns_of(m) for m in sprockets] == [(101_020 + 50 * i) * 1_000_000 for i in range(5)]
    assert sprockets[0].name == ["left_sprocket", "right_sprocket"]
    np.testing.assert_allclose(sprockets[2].velocity, [2.0 * math.pi, math.pi / 2.0])
    assert len(sprockets[0].position) == len(sprockets[0].effort) == 0
    assert imu[0].angular_velocity.z == pytest.approx(math.pi / 2.0)
    assert imu[0].orientation_covariance[0] == imu[0].linear_acceleration_covariance[0] == -1.0
    assert (imu[0].header.frame_id, poses[0].header.frame_id) == ("imu_link", "map")
    assert [stamp_ns_of(m) for m in poses] == [100_700_000_000, 100_800_000_000]
    position, turn = poses[0].pose.pose.position, poses[0].pose.pose.orientation
    assert (position.x, position.y, position.z) == (1.5, -0.25, 0.0)
    assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(math.pi / 2.0)
    covariance = poses[0].pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(np.diag(covariance), [0.01, 0.04, *[UNOBSERVED] * 3, 0.09])
    assert first[0] == f"/{PARAMETERS_TOPIC}"
    stamps = sorted(stamp_ns_of(m) for messages in (sprockets, imu, poses) for m in messages)
    assert [log_time_ns for _, log_time_ns in logged] == stamps


def test_parameters_travel_in_the_bag(tmp_path: Path) -> None:
    mapping = changed(vehicle="warthog", parameters={"encoder_resolution": 0.0})
    with open_bag(import_text(tmp_path, mapping=mapping)) as bag:
        assert bag_vehicle(bag) == load_vehicle("warthog")
        assert bag_parameters(bag) == {"encoder_resolution": 0.0}


def test_speeds_that_no_counts_show_in_have_no_count(tmp_path: Path) -> None:
    """The resolution is 0 then, not the default of the vehicle."""
    speeds = 180.0 + 90.0 * np.sin(np.arange(120.0))
    rows = [f"{1000 + 50 * k},{v:.4f},{-v:.4f},0,0,90,{k},0,0,0,10,20" for k, v in enumerate(speeds)]
    log = "\n".join((LOG.splitlines()[0], *rows))
    with open_bag(import_text(tmp_path, log, mapping=changed(parameters=None))) as bag:
        assert bag_parameters(bag) == {"encoder_resolution": 0.0}


def test_no_parameters_no_message(tmp_path: Path) -> None:
    with open_bag(import_text(tmp_path, mapping=changed(parameters=None))) as bag:
        assert bag_parameters(bag) == {}
        assert bag_vehicle(bag) is None
        assert f"/{PARAMETERS_TOPIC}" not in bag.topics


def test_positions_accelerations_and_hydraulics(tmp_path: Path) -> None:
    mapping = changed(
        topics__sprockets__left_position={"column": "wl", "unit": "rev"},
        topics__sprockets__right_position={"column": "wr", "unit": "rad"},
        topics__imu__linear_acceleration_x={"column": "gx", "unit": "g"},
        topics__imu__linear_acceleration_y={"column": "gy", "unit": "g"},
        topics__imu__linear_acceleration_z={"column": "n", "unit": "g"},
        topics__swing={"angle": {"column": "heading", "unit": "deg", "origin": 90.0}},
        topics__hydraulics={
            "left_pressure": {"column": "pl", "unit": "bar"},
            "right_pressure": {"column": "pr", "unit": "bar"},
        },
    )
    with open_bag(import_text(tmp_path, mapping=mapping)) as bag:
        sprockets = contents(bag, "sprockets")[0]
        imu = contents(bag, "imu/data_raw")[0]
        hydraulics = contents(bag, "hydraulics")[0]
        swing = contents(bag, "swing")[0]
    np.testing.assert_allclose(sprockets.position, [360.0 * math.pi, -90.0])
    assert imu.linear_acceleration.z == pytest.approx(7 * 9.80665)
    assert imu.linear_acceleration_covariance[0] == 0.0
    assert swing.position[0] == pytest.approx(-math.pi / 2.0)
    assert (hydraulics.left_pressure, hydraulics.right_pressure) == (1e6, 2e6)
    assert math.isnan(hydraulics.left_spool)
    assert math.isnan(hydraulics.supply_pressure)


BAD_MAPPINGS = {
    "unknown key 'colour'": changed(colour="red"),
    "key 'time' is missing": changed(time=None),
    "topics is empty": changed(topics={}),
    "topics: unknown key 'sprocket', did you mean 'sprockets'?; accepted: sprockets, imu/data_raw": changed(
        topics__sprocket={}
    ),
    "gnss.role: 'poses' is not accepted, did you mean 'pose'?": changed(topics__gnss={"role": "poses"}),
    "sprockets: right_velocity is not accepted; accepted: left_velocity + right_velocity, or ": changed(
        topics__sprockets__left_velocity=None
    ),
    "compass.convention: 'ned' is not accepted; accepted: enu, compass": changed(
        topics={"compass": {"role": "heading", "from": "/q", "convention": "ned"}}
    ),
    "swing: unknown key 'left'; accepted: from, joint, ": changed(
        topics={"swing": {"from": "/j", "left": "a"}}
    ),
    "sprockets: unknown key 'stddev'": changed(topics__sprockets__stddev={"x": 1.0}),
    "sprockets: left_velocity and right_velocity are both of 'wl'; accepted: a column of each": changed(
        topics__sprockets__right_velocity__column="wl"
    ),
    "sprockets.left_velocity.unit: 'deg/sec' is unknown, did you mean 'deg/s'?; accepted: rad/s": changed(
        topics__sprockets__left_velocity__unit="deg/sec"
    ),
    "imu/data_raw.angular_velocity_z.unit: 'm/s' is a unit of speed; accepted: rad/s, deg/s": changed(
        topics__imu__angular_velocity_z__unit="m/s"
    ),
    "sprockets.left_velocity: a speed over ground needs a vehicle in the mapping": changed(
        topics__sprockets__left_velocity__unit="km/h"
    ),
    "sprockets.left_velocity: key 'unit' is missing": changed(topics__sprockets__left_velocity__unit=None),
    "reference_pose: stddev of x is missing": changed(topics__reference_pose__stddev=None),
    "reference_pose: stddev of yaw is missing": changed(topics__reference_pose__stddev__yaw=None),
    "time.unit: 'sec' is unknown; accepted: s, ms, us, µs, ns": changed(time__unit="sec"),
    "parameters: slip_estimator: unknown parameter 'pose_source', did you mean 'pose_sources'?": changed(
        parameters={"pose_source": ["reference_pose"]}
    ),
    "parameters.vehicle; accepted: vehicle beside parameters": changed(
        vehicle="warthog", parameters={"vehicle": {"tread": 1.0}}
    ),
    "vehicle 'wartog': no such vehicle or file, did you mean 'warthog'?": changed(vehicle="wartog"),
    "no column 'speed'; the columns are: t, wl, wr": changed(
        topics__sprockets__left_velocity__column="speed"
    ),
    "column 'gx' never changes": changed(topics__reference_pose__new_when_changes="gx"),
    "line 2, column 't': -1.000 s is before 0; accepted: a 'start'": changed(start=-2.0),
    "time: 2 columns and 1 units; accepted": changed(time={"column": ["secs", "nsecs"], "unit": "s"}),
    "zone: '1h' is not accepted": changed(time={"column": "t", "unit": "iso8601", "zone": "1h"}),
    "csv.decimal: a comma, as the delimiter is": changed(csv={"decimal": "comma", "delimiter": "comma"}),
    "datum: 95, 11 is out of range": changed(datum={"latitude": 95, "longitude": 11}),
    "datum: unknown key 'lattitude', did you mean 'latitude'?": changed(datum={"lattitude": 48.0}),
}


@pytest.mark.parametrize("message", BAD_MAPPINGS)
def test_a_malformed_mapping_is_named_in_one_line(tmp_path: Path, message: str) -> None:
    assert message in refusal(tmp_path, mapping=BAD_MAPPINGS[message])


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("topics__sprockets", 3),
        ("topics__sprockets__left_velocity", "wl"),
        ("topics__sprockets__right_velocity__scale", math.nan),
        ("topics__sprockets__time_offset", True),
        ("topics__sprockets__frame", 5),
        ("topics__reference_pose__stddev__x", 0),
        ("start", 1e300),
        ("parameters", ["tread"]),
        ("parameters__encoder_resolution", -1.0),
        ("vehicle", {"kinematics": {"tread": 1.0, "contact_length": 1.0}}),
    ],
)
def test_a_wrong_value_is_named_with_its_place(tmp_path: Path, place: str, value: Any) -> None:
    assert place.rpartition("__")[2] in refusal(tmp_path, mapping=changed(**{place: value}))


BAD_LOGS = {
    "line 3, column 'wl': 'fast' is not accepted": LOG.replace("1050,180", "1050,fast"),
    "line 2, column 'gz': 'inf' is not accepted": LOG.replace("0,0,90,7,0", "0,0,inf,7,0", 1),
    "line 5 has 10 cells, the header 12": LOG.replace("-25,90,10,20\n1200", "-25,90\n1200"),
    "line 3 has 13 cells, the header 12 (decimal commas?)": LOG.replace("1050,180", "1050,180,5"),
    "line 3, column 'wl': '180,5' has a decimal comma": LOG.replace(",", ";").replace(
        "1050;180", "1050;180,5"
    ),
    "lines 2 to 6: not a table": LOG.replace("1150,360", '1150,"360'),
    "is not accepted; accepted: a number of ms, or blank": LOG.replace("1150", "1" * 200_000),
    "holds zero bytes": LOG.replace("1150", "11\x0050"),
    "line 5, column 't': 3000000000 s is too late for a stamp; accepted: less than 2^31 s": LOG.replace(
        "1150", "2999999900000"
    ),
    "line 5, column 't': '1763673783000000' is not accepted; accepted: a number of ms (is its unit us?)": (
        LOG.replace("1150", "1763673783000000")
    ),
    "no row of": LOG.replace(",180,", ",,").replace(",360,", ",,"),
    "no column 't', did you mean 'tt'?": LOG.replace("t,", "tt,", 1),
}


@pytest.mark.parametrize("message", BAD_LOGS)
def test_a_bad_log_is_named_in_one_line(tmp_path: Path, message: str) -> None:
    error = refusal(tmp_path, log=BAD_LOGS[message])
    assert message in error
    assert "log.csv" in error


def test_a_missing_log_is_named(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPPING), encoding="utf-8")
    with pytest.raises(InputError, match=r"log\.csv.*not found"):
        import_log([tmp_path / "log.csv"], read_mapping(tmp_path / "map.yaml"), tmp_path / "bag")


def test_the_commands_show_what_they_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], refuse: Callable[..., str]
) -> None:
    (tmp_path / "log.csv").write_text(LOG, encoding="utf-8")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPPING), encoding="utf-8")
    log, mapping, bag = (str(tmp_path / name) for name in ("log.csv", "map.yaml", "bag"))
    command = ["import", log, "--mapping", mapping, "--output", bag]
    assert main(command) == ExitCode.DONE
    printed = capsys.readouterr().out
    assert main(["info", bag]) == ExitCode.DONE
    assert capsys.readouterr().out in printed
    assert "/reference_pose" in printed
    assert "exists already" in refuse(*command)
