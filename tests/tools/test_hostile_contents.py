# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with hostile messages, metadata or names: each command ends with its result, or with one line.

``tests/fuzz/hostile_recordings.py`` (``make fuzz``) generates thousands of such bags.
"""

import os
import subprocess
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.commands import TRACKSLIP
from mcap.writer import Writer

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make
from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_tools.cli.main import main
from trackslip_tools.report.recording import read_recording

BagOf = Callable[..., Path]
GYRO, TEXT = "imu/data_raw", "std_msgs/msg/String"
VEHICLE = "{{name: x, kinematics: {{rolling_radius: 0.159, tread: {tread}, contact_length: 1.0}}}}"


def changed(lines: list[Any], topic: str, change: Callable[[Any], None], every: int) -> list[Any]:
    """The lines, with every ``every``-th message of a topic changed."""
    result, count = [], 0
    for line in lines:
        if line.topic == topic:
            count += 1
            if count % every == 0:
                line = line._replace(message=deepcopy(line.message))
                change(line.message)
        result.append(line)
    return result


def set_rate(value: float) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.angular_velocity.z = value

    return change


def set_stamp(sec: int, nanosec: int = 0) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(set_rate(value) for value in (float("nan"), -1e30)),
        *(set_stamp(sec) for sec in (-(2**31), 2**31 - 1)),
    ],
    ids=["nan", "-1e30", "1901", "2038"],
)
def test_invalid_gyro_readings_are_left_out_of_a_calibration(
    tmp_path: Path, lines: list[Any], bag_of: BagOf, capsys: pytest.CaptureFixture[str], change: Any
) -> None:
    path = bag_of(changed(lines, GYRO, change, 40))
    output = tmp_path / "calibration.yaml"
    assert main(["calibrate", str(path), "--all", "--output", str(output)]) in (0, 1)
    shown = capsys.readouterr()
    assert f"2 messages of {GYRO} are left out" in shown.err
    assert "nan" not in shown.out
    assert not output.exists() or ".nan" not in output.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_absurd_truth_in_a_report_warns_of_nothing(tmp_path: Path, lines: list[Any], bag_of: BagOf) -> None:
    truth = list(lines)
    for line in (line for line in lines if line.topic == "reference_pose"):
        stamp = line.message.header
        slip = make("trackslip_msgs/msg/TrackSlip", header=stamp, left_slip=-1e308, right_slip=-1e308)
        place = make("nav_msgs/msg/Odometry", header=stamp)
        place.pose.pose.orientation.w = place.pose.pose.orientation.z = -1e308
        for topic, message in (("truth/track_slip", slip), ("truth/odometry", place)):
            truth.append(line.instead(topic, message))
    path = bag_of(truth)
    assert main(["report", str(path), "--output", str(tmp_path / "report.html")]) in (0, 1)


@pytest.mark.parametrize("command", ["smooth", pytest.param("replay", marks=pytest.mark.slow)])
def test_estimates_before_1970_are_written(
    tmp_path: Path, lines: list[Any], bag_of: BagOf, command: str
) -> None:
    def earlier(message: Any) -> None:
        message.header.stamp.sec -= 1_700_001_000

    early = lines
    for topic in {line.topic for line in lines}:
        early = changed(early, topic, earlier, 1)
    path = bag_of(early)
    assert main([command, str(path), "--output", str(tmp_path / "out")]) == ExitCode.DONE
    with open_bag(tmp_path / "out") as made:
        assert made.message_count > 0
        assert made.start_ns == 0


@pytest.mark.parametrize(
    ("ranges", "angle"), [(3, float("nan")), (0, float("inf")), (3, 1e30), (1_000_000, 0.01), (-1, 0.0)]
)
def test_scan_of_no_direction_or_of_another_type_has_few_points_or_none(
    lines: list[Any], bag_of: BagOf, ranges: int, angle: float
) -> None:
    angles = {"angle_min": angle, "angle_increment": angle}
    content = {"header": lines[0].message.header, "ranges": np.full(max(ranges, 0), 3.0), "range_max": 80.0}
    scan = make("sensor_msgs/msg/LaserScan", **content, **angles) if ranges >= 0 else make(TEXT, data="hello")
    with open_bag(bag_of([lines[0].instead("scan", scan)])) as bag:
        recording = read_recording(bag, InputFilters())
    assert (recording.laser is None) == (ranges < 0)
    assert len(recording.points) <= 5000 * (ranges == 1_000_000)


@pytest.mark.parametrize("command", ["info", "replay"])
def test_vehicle_of_no_size_in_a_bag_is_refused(
    lines: list[Any], bag_of: BagOf, refuse: Callable[..., str], command: str
) -> None:
    text = make(TEXT, data=VEHICLE.format(tread="1.0e-30"))
    path = bag_of([lines[0].instead("vehicle", text), *lines])
    assert "kinematics.tread: 1e-30 is out of range; accepted: >= 0.02" in refuse(command, path)


def test_name_that_is_no_unicode_in_a_vehicle_is_refused(
    lines: list[Any], bag_of: BagOf, refuse: Callable[..., str]
) -> None:
    text = VEHICLE.format(tread="0.73").replace("name: x", 'name: "\\ud800"')
    path = bag_of([lines[0].instead("vehicle", make(TEXT, data=text))])
    assert "invalid Unicode character escape code" in refuse("info", path)


def change_metadata(bag: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = bag / "metadata.yaml"
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    change(tree["rosbag2_bagfile_information"])
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")


@pytest.mark.parametrize("ns", [-(2**63), -1, 10**30])
@pytest.mark.parametrize("command", ["info", pytest.param("report", marks=pytest.mark.slow)])
def test_times_of_a_bag_are_those_of_its_files(
    tmp_path: Path, lines: list[Any], bag_of: BagOf, command: str, ns: int
) -> None:
    def absurd(information: dict[str, Any]) -> None:
        information["starting_time"]["nanoseconds_since_epoch"] = ns
        information["duration"]["nanoseconds"] = ns

    path = bag_of(lines)
    with open_bag(path) as bag:
        stated = bag.start_ns, bag.end_ns, bag.message_count
    change_metadata(path, absurd)
    with open_bag(path) as bag:
        assert (bag.start_ns, bag.end_ns, bag.message_count) == stated
        assert bool(bag.damage) == (not 0 <= ns < 2**63)
    options = ["--stop", "1", "--output", str(tmp_path / "report.html")] if command == "report" else []
    assert main([command, str(path), *options]) == ExitCode.DONE


@pytest.mark.parametrize("linked", [False, True])
def test_file_that_the_metadata_name_2000_times_is_read_once(
    lines: list[Any], bag_of: BagOf, linked: bool
) -> None:
    def again(information: dict[str, Any]) -> None:
        (own,) = information["relative_file_paths"]
        names = [f"link_{k}.mcap" for k in range(2000)] if linked else [own] * 2000
        for name in names if linked else ():
            (path / name).symlink_to(own)
        information["relative_file_paths"] = [own, *names]

    path = bag_of(lines[:20])
    change_metadata(path, again)
    with open_bag(path) as bag:
        assert bag.message_count == 20
        assert len(bag.sources) == 1
        assert "is there twice; accepted: each file once" in bag.damage
        assert len(list(bag.messages())) == 20


@pytest.mark.slow
@pytest.mark.parametrize("has_metadata", [False, True])
def test_number_of_topics_read_is_limited(tmp_path: Path, has_metadata: bool) -> None:
    """The number of topics is limited, because ``recover`` is slow on tens of thousands of schemas."""
    file = tmp_path / "bag.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for k in range(5_000):
            schema = writer.register_schema(f"a/msg/B{k}", "ros2msg", b"int32 x")
            channel = writer.register_channel(f"/t{k}", "cdr", schema)
            if k % 5000 == 0:
                writer.add_message(channel, 10**18 + k, b"\0\1\0\0\1\0\0\0", 10**18 + k)
        writer.finish()
    if has_metadata:
        topics = [{"topic_metadata": {"name": f"/t{k}"}, "message_count": 0} for k in range(5_000)]
        information = {"topics_with_message_count": topics, "relative_file_paths": [file.name]}
        information |= {"starting_time": {"nanoseconds_since_epoch": 1}, "duration": {"nanoseconds": 1}}
        (tmp_path / "metadata.yaml").write_text(yaml.dump({"rosbag2_bagfile_information": information}))
    with open_bag(tmp_path if has_metadata else file) as bag:
        assert (len(bag.topics), bag.message_count) == (4096, 1)
        assert "unusable records" in bag.damage
    assert main(["recover", str(file), "--output", str(tmp_path / "recovered")]) == ExitCode.DONE
    with open_bag(tmp_path / "recovered") as bag:
        assert (len(bag.topics), bag.message_count, bag.damage) == (4096, 1, "")


@pytest.mark.parametrize(
    "name",
    [b"a\nb", *(pytest.param(name, marks=pytest.mark.slow) for name in (b"b\xff\xfe", "\u2028".encode()))],
)
def test_bag_of_any_name_is_worked_with(
    tmp_path: Path, lines: list[Any], bag_of: BagOf, capsys: pytest.CaptureFixture[str], name: bytes
) -> None:
    path = bag_of(lines).rename(tmp_path / os.fsdecode(name))
    out = tmp_path / "out"
    out.mkdir()
    for words in (
        "info BAG",
        f"replay BAG --stop 1 --json {out}/replay.json",
        f"calibrate BAG --all --output {out}/calibration.yaml --json {out}/calibration.json",
        f"recover BAG --output {out}/recovered",
    ):
        assert main([str(path) if word == "BAG" else word for word in words.split()]) in (0, 1)
    shown = capsys.readouterr()
    assert all(line.isprintable() for line in (shown.out + shown.err).split("\n"))
    assert all(file.read_bytes().decode() for file in out.iterdir() if file.is_file())


@pytest.mark.parametrize(
    "encoding", ["ascii", *(pytest.param(name, marks=pytest.mark.slow) for name in ("latin-1", "cp1252"))]
)
def test_output_in_an_encoding_without_our_signs_is_escaped(bag: Path, encoding: str) -> None:
    command = [*TRACKSLIP, "calibrate", str(bag)]
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert done.returncode in (0, 1)
    assert not done.stderr
    assert "turning_efficiency" in done.stdout.decode(encoding)
    assert ("\\u2013" in done.stdout.decode(encoding)) == (encoding != "cp1252")
