# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip check`` and the commands that run it: exit codes, JSON, and the set-up verdict in reports."""

import json
import re
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.commands import json_of
from fixtures.made_bags import write_changed, write_messages
from fixtures.setup_drives import PROGRAMME, make_drive

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.arrays import FloatArray
from trackslip_common.errors import ExitCode
from trackslip_estimation.setup_check.log import Log
from trackslip_tools.cli import shared_options
from trackslip_tools.cli.main import main
from trackslip_tools.cli.replay_options import parameters_of
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.run import replay

MAPPING = """\
time: {column: t, unit: s}
topics:
  sprockets:
    file: tracks.csv
    left_velocity: {column: left, unit: rad/s}
    right_velocity: {column: right, unit: rad/s}
  imu/data_raw:
    file: imu.csv
    angular_velocity_z: {column: gz, unit: rad/s}
  gnss_pose:
    file: gnss.csv
    x: {column: x, unit: m}
    y: {column: y, unit: m}
    stddev: {x: 0.02, y: 0.02}
vehicle: {name: digger, kinematics: {rolling_radius: 0.35, tread: 2.0, contact_length: 2.5}}
parameters:
  pose_sources: [gnss_pose]
  sources:
    gnss_pose: {use_heading: false, lever_arm_x: 0.5, lever_arm_y: 0.2}
  encoder_resolution: 0.0
"""


ONE_TURN = ((6.0, 0.0, 0.0), (15.0, 0.9, 0.0), (3.0, 0.6, 0.25), (15.0, 0.9, 0.0))


def short_drive(parts: int = 8) -> Log:
    return make_drive(programme=PROGRAMME[:parts])


def _table(path: Path, names: str, *columns: Any, form: str = "%.9g") -> None:
    np.savetxt(path, np.column_stack(columns), fmt=form, delimiter=",", header=names, comments="")


def write_csv(folder: Path, log: Log) -> Path:
    """Write the columns of a drive, and the mapping that reads them."""
    tracks, gyro, fixes = log.tracks, log.gyros[0], log.fixes[0]
    _table(folder / "tracks.csv", "t,left,right", tracks.t, tracks.speeds)
    _table(folder / "imu.csv", "t,gz", gyro.t, gyro.rates[:, 2])
    _table(folder / "gnss.csv", "t,x,y", fixes.t, fixes.places)
    (folder / "mapping.yaml").write_text(MAPPING)
    return folder


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_csv(tmp_path_factory.mktemp("healthy"), short_drive(10))
    return import_drive(folder)


@pytest.fixture(scope="module")
def swapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = make_drive().with_tracks(np.array(((0.0, 1.0), (1.0, 0.0))))
    return import_drive(write_csv(tmp_path_factory.mktemp("swapped"), log))


def import_drive(folder: Path) -> Path:
    bag = folder / "bag"
    options = ("--mapping", str(folder / "mapping.yaml"), "--output", str(bag))
    logs = [str(folder / name) for name in ("tracks.csv", "imu.csv", "gnss.csv")]
    assert main(["import", *logs, *options]) == ExitCode.DONE
    return bag


def test_a_source_that_counts_from_1970_beside_one_from_boot_is_named(tmp_path: Path) -> None:
    folder = write_csv(tmp_path, short_drive())
    file = folder / "gnss.csv"
    names, columns = file.read_text().partition("\n")[0], np.loadtxt(file, delimiter=",", skiprows=1)
    columns[:, 0] += 1.79e9
    _table(file, names, columns, form="%.6f")
    result = json_of(tmp_path, "check", import_drive(folder), code=ExitCode.FAILED)
    assert "source_delay" in {cause["cause"] for cause in result["causes"]}
    assert any("no time in common" in cause["evidence"] for cause in result["causes"])


def write_received(folder: Path, change: Callable[[str, FloatArray], tuple[FloatArray, FloatArray]]) -> Path:
    """The files of a drive with times of arrival; ``change``: rows (n, m) of a file → rows, arrivals (n,)."""
    folder = write_csv(folder, short_drive())
    for path in folder.glob("*.csv"):
        names, columns = path.read_text().partition("\n")[0], np.loadtxt(path, delimiter=",", skiprows=1)
        columns, received = change(path.stem, columns)
        _table(path, f"{names},received", columns, received)
    time = "time: {column: t, unit: s}"
    mapping = MAPPING.replace(time, f"{time}\nreceived: {{column: received, unit: s}}")
    (folder / "mapping.yaml").write_text(mapping)
    return folder


@pytest.mark.parametrize(
    ("file", "source", "ahead"), [("tracks", "sprockets", -18.0), ("gnss", "gnss_pose", 18.0)]
)
def test_a_source_on_another_clock_is_named_by_its_arrivals(
    file: str, source: str, ahead: float, tmp_path: Path
) -> None:
    def change(name: str, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        received = columns[:, 0] + 100.0
        columns[:, 0] = received + (ahead if name == file else 0.0)
        return columns, received

    folder = write_received(tmp_path, change)
    (cause,) = json_of(tmp_path, "check", import_drive(folder), code=ExitCode.FAILED)["causes"]
    assert (cause["cause"], cause["source"]) == ("source_delay", source)
    assert f"time_offset: {-ahead:.1f} (GPS time" in cause["remedy"]


def test_a_playback_at_another_rate_that_was_recorded_is_plausible(tmp_path: Path) -> None:
    def change(name: str, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        columns = columns[len(columns) // 2 :] if name == "gnss" else columns
        return columns, 100.0 + columns[:, 0] / 2.0

    bag = import_drive(write_received(tmp_path, change))
    assert json_of(tmp_path, "check", bag)["causes"] == []


UNUSABLE: dict[str, Callable[[Any], object]] = {
    "/gnss_pose": lambda m: setattr(m.pose, "covariance", np.zeros(36)),
    "/imu/data_raw": lambda m: setattr(m, "angular_velocity_covariance", np.full(9, -1.0)),
    "/sprockets": lambda m: setattr(m, "name", ["left_wheel", "right_wheel"]),
}


@pytest.mark.parametrize("topic", UNUSABLE)
def test_a_source_without_a_valid_reading_is_not_plausible(topic: str, healthy: Path, tmp_path: Path) -> None:
    def unusable(_: int, message: Any) -> Any:
        UNUSABLE[topic](message)
        return message

    bag = write_changed(tmp_path / "bag", healthy, topic, unusable)
    result = json_of(tmp_path, "check", bag, code=ExitCode.FAILED)
    found = [cause["source"] for cause in result["causes"] if cause["cause"] == "invalid_readings"]
    found += [one["what"] for one in result["undetermined"] if "no valid speed" in one["what"]]
    assert len(found) == 1
    assert topic.strip("/") in found[0]


def test_joints_of_other_names_are_named(healthy: Path, tmp_path: Path) -> None:
    def rename(_: int, message: Any) -> Any:
        message.name = ["left_wheel", "right_wheel"]
        return message

    bag = write_changed(tmp_path / "bag", healthy, "/sprockets", rename)
    (question,) = json_of(tmp_path, "check", bag, code=ExitCode.FAILED)["undetermined"]
    assert "left_wheel, right_wheel" in question["what"]


def test_headings_in_use_without_variance_are_not_plausible(healthy: Path, tmp_path: Path) -> None:
    def without_heading(_: int, message: Any) -> Any:
        message.pose.covariance = np.where(np.arange(36) == 35, 0.0, message.pose.covariance)
        return message

    bag = write_changed(tmp_path / "bag", healthy, "/gnss_pose", without_heading)
    setting = "slip_estimator.sources.gnss_pose.use_heading"
    for is_used, code in ((False, ExitCode.DONE), (True, ExitCode.FAILED)):
        causes = json_of(tmp_path, "check", bag, "--set", f"{setting}={is_used}".lower(), code=code)["causes"]
        found = [cause["source"] for cause in causes if cause["cause"] == "invalid_readings"]
        assert found == ["gnss_pose"] * is_used


@pytest.mark.parametrize("set_back_s", [3, 3600])
def test_a_clock_that_is_set_back_while_it_records_is_named(
    healthy: Path, tmp_path: Path, set_back_s: int
) -> None:
    with open_bag(healthy) as bag, BagWriter(tmp_path / "bag") as writer:
        middle_ns = (bag.start_ns + bag.end_ns) // 2
        for m in bag.messages():
            content, back_s = bag.deserialize(m.raw, m.type_name), set_back_s * (m.log_time_ns > middle_ns)
            if hasattr(content, "header"):
                content.header.stamp.sec += 10**6 - back_s
            log_time_ns = m.log_time_ns + (10**6 - back_s) * 10**9
            writer.write(m.topic, m.type_name, serialize(content), log_time_ns)
    result = json_of(tmp_path, "check", tmp_path / "bag", code=ExitCode.FAILED)
    (cause,) = (cause for cause in result["causes"] if cause["cause"] == "clock_set_back")
    half_s = (middle_ns - bag.start_ns) * 1e-9
    begin = f"--stop {half_s - 3.0:.0f}" if set_back_s == 3 else f"--start {set_back_s - half_s - 0.1:.1f}"
    assert begin in cause["remedy"]


@pytest.mark.parametrize("step_s", [3 * 3600, 3 * 365 * 86_400, 56 * 365 * 86_400])
def test_a_drive_on_both_sides_of_a_clock_that_is_set_forward_is_checked(
    healthy: Path, tmp_path: Path, step_s: int
) -> None:
    """A computer without a battery begins in 1970 and is set while it records, before the first fix."""
    with open_bag(healthy) as bag, BagWriter(tmp_path / "bag") as writer:
        set_ns = bag.start_ns + (bag.end_ns - bag.start_ns) * 2 // 3
        for m in bag.messages():
            is_late = m.log_time_ns > set_ns
            content = bag.deserialize(m.raw, m.type_name)
            if hasattr(content, "header"):
                content.header.stamp.sec += step_s * is_late
            if is_late or m.topic not in ("/gnss_pose", "/box_pose", "/heading"):
                log_time_ns = m.log_time_ns + step_s * 10**9 * is_late
                writer.write(m.topic, m.type_name, serialize(content), log_time_ns)
        seconds = (set_ns - bag.start_ns) * 1e-9
    result = json_of(tmp_path, "check", tmp_path / "bag")
    assert result["plausible"]
    (note,) = result["notes"]
    stop_s, start_s = (float(re.search(rf"--{n} ([\d.]+)", note).group(1)) for n in ("stop", "start"))
    assert (stop_s, start_s) == pytest.approx((seconds, seconds + step_s), abs=0.2)


@pytest.mark.parametrize(("topic", "numbers"), [("/sprockets", {50}), ("/gnss_pose", set(range(20)))])
@pytest.mark.parametrize("days", [30, 1024 * 7])
def test_stray_stamps_leave_the_check_as_it_is(
    healthy: Path, tmp_path: Path, topic: str, numbers: set[int], days: int
) -> None:
    """A corrupt stamp, or a receiver before it has its date: the check ended in a traceback."""

    def change(number: int, message: Any) -> Any:
        message.header.stamp.sec += days * 86_400 * (number in numbers)
        return message

    result = json_of(tmp_path, "check", write_changed(tmp_path / "bag", healthy, topic, change))
    assert (result["plausible"], result["causes"]) == (True, [])


def test_times_in_microseconds_declared_as_seconds_are_the_only_cause(tmp_path: Path) -> None:
    """Each step is hours then: none of them is a pause."""
    folder = write_csv(tmp_path, short_drive())
    for path in folder.glob("*.csv"):
        names, columns = path.read_text().partition("\n")[0], np.loadtxt(path, delimiter=",", skiprows=1)
        columns[:, 0] *= 1e6
        _table(path, names, columns, form="%.9f")
    result = json_of(tmp_path, "check", import_drive(folder), code=ExitCode.FAILED)
    assert [cause["cause"] for cause in result["causes"]] == ["time_unit"]
    assert result["notes"] == []


@pytest.mark.parametrize(("topic", "number"), [("/sprockets", 0), ("/sprockets", 50), ("/gnss_pose", 20)])
def test_a_stray_stamp_does_not_lengthen_a_replay(
    healthy: Path, tmp_path: Path, topic: str, number: int
) -> None:
    def change(count: int, message: Any) -> Any:
        message.header.stamp.sec += 1024 * 7 * 86_400 * (count == number)
        return message

    path = write_changed(tmp_path / "bag", healthy, topic, change)
    expected, result = (replayed(one) for one in (healthy, path))
    assert result.duration_s == expected.duration_s
    assert np.ptp(result.longest_gap) < 1.0
    assert abs(result.stamp_origin_ns - expected.stamp_origin_ns) < 10**9


def replayed(path: Path) -> Replay:
    with open_bag(path) as bag:
        return replay(bag, parameters_of(bag), InputFilters(), None)


def test_simulated_time_that_starts_again_within_a_bag_is_the_only_cause(
    healthy: Path, tmp_path: Path
) -> None:
    """The bag counts by the computer's clock, the stamps by a simulation that was started twice."""
    with open_bag(healthy) as bag, BagWriter(tmp_path / "bag") as writer:
        again_ns = (bag.start_ns + bag.end_ns) // 2
        for m in bag.messages():
            content = bag.deserialize(m.raw, m.type_name)
            if hasattr(content, "header"):
                content.header.stamp.sec -= (again_ns - bag.start_ns) // 10**9 * (m.log_time_ns > again_ns)
            writer.write(m.topic, m.type_name, serialize(content), m.log_time_ns + 10**18)
        seconds = (again_ns - bag.start_ns) * 1e-9
    (cause,) = json_of(tmp_path, "check", tmp_path / "bag", code=ExitCode.FAILED)["causes"]
    assert (cause["cause"], cause["source"]) == ("clock_set_back", "sprockets")
    stop_s, start_s = (
        float(re.search(rf"--{n} ([\d.]+)", cause["remedy"]).group(1)) for n in ("stop", "start")
    )
    assert (stop_s, start_s) == pytest.approx((seconds, seconds), abs=0.1)


def test_a_source_of_which_most_measurements_are_rejected_is_not_plausible(tmp_path: Path) -> None:
    """Headings in degrees, declared as rad, of a drive with one turn: no relation of the check shows them."""
    log = make_drive(programme=ONE_TURN)
    folder, fixes = write_csv(tmp_path, log), log.fixes[0]
    headings = np.degrees(log.compasses[0].headings)
    _table(folder / "gnss.csv", "t,x,y,yaw", fixes.t, fixes.places, headings)
    mapping = MAPPING.replace(
        "{column: y, unit: m}", "{column: y, unit: m}\n    yaw: {column: yaw, unit: rad}"
    )
    mapping = mapping.replace("y: 0.02}", "y: 0.02, yaw: 0.02}").replace("use_heading: false, ", "")
    (folder / "mapping.yaml").write_text(mapping)
    setup = json_of(tmp_path, "replay", import_drive(folder), code=ExitCode.FAILED)["setup"]
    (question,) = (one for one in setup["undetermined"] if "rejected" in one["what"])
    assert question["what"].startswith("gnss_pose: ")
    assert not setup["plausible"]


def test_messages_that_are_written_a_little_out_of_order_are_plausible(healthy: Path, tmp_path: Path) -> None:
    with open_bag(healthy) as bag:
        messages = list(bag.messages())
    for k in range(0, len(messages) - 50, 500):
        messages[k : k + 50] = reversed(messages[k : k + 50])
    result = json_of(tmp_path, "check", write_messages(tmp_path / "bag", messages))
    assert (result["plausible"], result["causes"]) == (True, [])


def test_a_mistake_is_named_with_its_remedy(swapped: Path, tmp_path: Path) -> None:
    result = json_of(tmp_path, "check", swapped, code=ExitCode.FAILED)
    assert result["plausible"] is False
    (cause,) = result["causes"]
    assert cause.keys() == {"cause", "source", "evidence", "odds", "remedy"}
    assert (cause["cause"], cause["source"]) == ("tracks_swapped", "sprockets")
    assert cause["odds"] >= 100.0


@pytest.mark.slow
def test_ambiguous_mistake_fails_the_check(tmp_path: Path) -> None:
    """A mistake whose cause is ambiguous, as fixes in feet or speeds in another unit, fails the check."""
    log = make_drive()
    (fixes,) = log.fixes
    in_feet = replace(log, fixes=(replace(fixes, places=fixes.places / 0.3048),))
    bag = import_drive(write_csv(tmp_path, in_feet))
    result = json_of(tmp_path, "check", bag, code=ExitCode.FAILED)
    assert (result["plausible"], result["causes"]) == (False, [])
    assert any("feet" in one["what"] for one in result["undetermined"])
    assert main(["replay", str(bag), "--stop", "60"]) == ExitCode.FAILED
    assert main(["replay", str(bag), "--stop", "60", "--force"]) == ExitCode.DONE


def test_replay_fails_on_a_mistake_unless_it_is_forced(
    swapped: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["replay", str(swapped), "--stop", "60"]) == ExitCode.FAILED
    output = capsys.readouterr().out
    assert "tracks_swapped" in output.split("messages")[0]
    assert main(["replay", str(swapped), "--stop", "60", "--force"]) == ExitCode.DONE


@pytest.mark.slow
def test_the_first_row_of_a_reports_verdict_is_the_setup(swapped: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert main(["report", str(swapped), "--stop", "90", "--output", str(page)]) == ExitCode.FAILED
    verdicts = page.read_text().split('id="verdicts"')[1]
    assert verdicts.index("Setup plausible") < verdicts.index("Bag")
    assert "tracks_swapped" in verdicts


def test_calibrate_finds_no_sign_that_the_fixes_contradict(swapped: Path, tmp_path: Path) -> None:
    summary = tmp_path / "calibration.json"
    main(["calibrate", str(swapped), "--json", str(summary)])
    findings = json.loads(summary.read_text())["findings"]
    assert findings["gyro_sign"]["value"] is None
    assert findings["turning_efficiency"]["value"] is None


def test_calibrate_measures_the_lever_arm_of_an_antenna_without_heading(
    healthy: Path, tmp_path: Path
) -> None:
    findings = json_of(tmp_path, "calibrate", healthy)["findings"]
    low, high = findings["lever_arm_x of gnss_pose"]["interval"]
    assert high - low < 0.2
    assert abs(findings["lever_arm_x of gnss_pose"]["value"] - 0.5) < 0.1
    assert abs(findings["delay of gnss_pose"]["value"]) <= 0.15


def test_an_import_ends_with_distances_turns_and_the_next_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import_drive(write_csv(tmp_path, short_drive(4)))
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].startswith("next: trackslip replay")
    assert any(line.startswith("distance: ") for line in lines)
    assert any(line.startswith("turned: ") for line in lines)


@pytest.mark.parametrize("files", [[], ["a.yaml"], ["a.yaml", "b.yaml"]])
def test_the_next_command_has_all_parameter_files(files: list[str]) -> None:
    options = Namespace(vehicle="pc05", namespace="", set=["slip_estimator.max_gap=3"], params=files)
    words = shared_options.next_command_options(options)
    assert words[:4] == ["--vehicle", "pc05", "--set", "slip_estimator.max_gap=3"]
    assert words[4:] == (["--params", *files] if files else [])
