# SPDX-License-Identifier: Apache-2.0
"""The ``trackslip`` command on small bags: one line for each mistake, the same answer each time."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from trackslip_common.errors import ExitCode
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, TOPICS
from trackslip_estimation.bags.messages import header, make, serialize
from trackslip_estimation.bags.reader import open_bag
from trackslip_estimation.bags.types import typestore
from trackslip_estimation.bags.writer import BagWriter
from trackslip_estimation.cli.main import main
from trackslip_estimation.conversions import in_six, planar_pose_message
from trackslip_estimation.measurements import Measurement, PoseFix, Sprockets, YawRate

MS = 1_000_000
EPOCH_NS = 1_700_000_000_000_000_000
POSE = TOPICS["box_pose"].type_name
KEYS = {"duration_s", "messages", "rejected", "final", "rmse", "nees", "real_time_factor"}


class Line(NamedTuple):
    """One message for a bag."""

    log_ns: int
    topic: str
    type_name: str
    message: Any


def message_of(m: Measurement) -> tuple[str, Any]:
    """(type, message) of a measurement, as the drivers send it."""
    stamp = header(EPOCH_NS + m.stamp_ns, "")
    if isinstance(m, Sprockets):
        kind, fields = (
            "sensor_msgs/msg/JointState",
            {
                "name": [LEFT_SPROCKET, RIGHT_SPROCKET],
                "position": list(m.positions or ()),
                "velocity": [m.left_speed, m.right_speed],
            },
        )
        return kind, make(kind, header=stamp, **fields)
    if isinstance(m, YawRate):
        kind = "sensor_msgs/msg/Imu"
        rate = make("geometry_msgs/msg/Vector3", z=m.rate)
        variances = [0.0] * 8 + [m.variance]
        return kind, make(kind, header=stamp, angular_velocity=rate, angular_velocity_covariance=variances)
    return POSE, pose_message(m, stamp)


def pose_message(m: PoseFix, stamp: Any) -> Any:
    pose = planar_pose_message(make, m.pose)
    inner = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=in_six(m.covariance))
    return make(POSE, header=stamp, pose=inner)


def write(path: Path, lines: Iterable[Line]) -> Path:
    with BagWriter(path) as bag:
        for line in sorted(lines, key=lambda line: line.log_ns):
            bag.write(f"/{line.topic}", line.type_name, serialize(line.message), line.log_ns)
    return path


@pytest.fixture(scope="module")
def lines(drive: Callable[..., Any]) -> list[Line]:
    """10 s with a turn; fixes arrive 0.3 s late, and the whole truth as ``reference_pose``."""
    segments = [
        (4.0, 2.0, 2.0, 0.02, 0.02, 0.0),
        (3.0, 1.0, 2.0, -0.1, 0.2, 0.0),
        (3.0, 2.0, 2.0, 0.02, 0.02, 0.0),
    ]
    driven = drive(segments, seed=1)
    found = []
    for m in driven.measurements:
        late_ns = 300 * MS if isinstance(m, PoseFix) else 2 * MS
        found.append(Line(EPOCH_NS + m.stamp_ns + late_ns, m.source, *message_of(m)))
    for stamp_ns, truth in driven.truth.items():
        exact = PoseFix("reference_pose", stamp_ns, truth[:3], driven.measurements[1].covariance)
        found.append(Line(EPOCH_NS + stamp_ns + MS, "reference_pose", *message_of(exact)))
    return found


@pytest.fixture(scope="module")
def bag(lines: list[Line], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("cli") / "bag", lines)


def call(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def summary(tmp_path: Path, *arguments: object, code: int = ExitCode.DONE) -> dict[str, Any]:
    """The JSON of a replay."""
    out = tmp_path / "out.json"
    assert call("replay", *arguments, "--json", out) == code
    found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


def without_time(found: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in found.items() if name != "real_time_factor"}


# What is refused


def refuse(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on stderr."""
    assert call(*arguments) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert error.endswith("\n")
    assert error.count("\n") == 1
    assert "Traceback" not in error
    return error


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--set slip_estimator.histery_window=3", "unknown parameter 'histery_window'"),
        ("--set slip_estimator.vehicle.tred=3", "unknown parameter 'vehicle.tred'"),
        ("--set slip_estimator.vehicle=3", "unknown parameter 'vehicle'"),
        ("--set slip_estimator.vehicle.tread=0", "vehicle.tread: 0.0 is out of range; accepted: > 0 m"),
        ("--set slip_estimator.gate_probability=1.5", "1.5 is out of range; accepted: > 0 and < 1"),
        ("--set slip_estimator.history_window=.nan", "nan is out of range"),
        ("--set slip_estimator.history_window=long", "'long' is not a number; accepted: > 0"),
        ("--set slip_estimator.history_window=", "None is not a number"),
        ("--set slip_estimator.jump_confirmations=2.5", "2.5 is not a whole number; accepted: >= 2"),
        ("--set slip_estimator.use_heading=1", "1 is not true or false"),
        ("--set slip_estimator.start=now", "accepted: one of first_fix, initial_pose"),
        ("--set slip_estimator.pose_sources=box_pose", "'box_pose' is not a list of text"),
        ("--set slip_estimator.odom_frame=2001-99-99", "not YAML"),
        ("--set slip_estimator.odom_frame=[", "not YAML"),
        ("--set history_window=3", "--set history_window=3: accepted: slip_estimator.<parameter>=<value>"),
        ("--set emulator.seed=3", "accepted: slip_estimator.<parameter>=<value>"),
        ("--set slip_estimator.history_window", "accepted: slip_estimator.<parameter>=<value>"),
        ("--set slip_estimator.=3", "accepted: slip_estimator.<parameter>=<value>"),
        ("--thin box_pose", "--thin box_pose: accepted: TOPIC:HZ"),
        ("--thin box_pose:fast", "--thin box_pose:fast: accepted"),
        ("--thin box_pose:1e12", "--thin box_pose:1e12: accepted"),
        ("--thin bocks:1", "--thin bocks: there is no such topic; accepted: box_pose"),
        ("--withhold box_pose:1", "--withhold box_pose:1: accepted"),
        ("--withhold box_pose:4:1", "T0 < T1"),
        ("--withhold bocks", "--withhold bocks: there is no such topic; accepted: box_pose"),
        ("--remap box_pose", "--remap box_pose: accepted: from:=to"),
        ("--remap bocks:=box_pose", "no messages on /bocks; it holds: /box_pose"),
        ("--remap imu/data_raw:=box_pose", "/imu/data_raw is a sensor_msgs/msg/Imu; accepted: geometry_msgs"),
        ("--reference truth", "no messages on /truth; it holds: /box_pose"),
        ("--reference imu/data_raw", "imu/data_raw: it is a sensor_msgs/msg/Imu; accepted: geometry_msgs"),
        ("--start 5 --stop 5", "accepted: start before stop"),
        ("--start nan", "accepted: start before stop"),
        ("--stop 1e300", "at most 1e+09 s"),
        ("--start=-1e300", "at most 1e+09 s"),
        ("--start soon", "invalid float value: 'soon'"),
        ("--seed -1", "accepted: a whole number >= 0"),
        ("--seed x", "accepted: a whole number >= 0"),
        ("--params no_such.yaml", "file 'no_such.yaml' not found"),
        ("--frequency 3", "unrecognized arguments: --frequency 3"),
    ],
)
def test_a_bad_option_is_refused_in_one_line(
    bag: Path, capsys: pytest.CaptureFixture[str], options: str, expected: str
) -> None:
    assert expected in refuse(capsys, "replay", bag, *options.split(" "))


@pytest.mark.parametrize(
    "content", ["{", "slip_estimator: 3", "slip_estimator: {ros__parameters: {a: 1}}", "- 1", "\xff\n\t:"]
)
def test_a_bad_parameter_file_is_refused_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(content, encoding="utf-8")
    refuse(capsys, "replay", bag, "--params", path)


@pytest.mark.parametrize("command", ["replay", "info"])
def test_a_missing_bag_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert "nowhere' not found" in refuse(capsys, command, tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["log.txt", "log.mcap", "log.db3"])
def test_a_text_file_is_no_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (tmp_path / name).write_text("hello\n", encoding="utf-8")
    assert "accepted: a rosbag2 directory" in refuse(capsys, "replay", tmp_path / name)


def test_a_bag_without_sprockets_is_refused(
    tmp_path: Path, lines: list[Line], capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "bag", [line for line in lines if line.topic != "sprockets"])
    error = refuse(capsys, "replay", path)
    assert "no messages on /sprockets; it holds: /box_pose, /imu/data_raw, /reference_pose" in error


@pytest.mark.parametrize(
    "topic", ["sprockets", "imu/data_raw", "box_pose", "measurement_reports", "odometry"]
)
def test_a_topic_of_another_type_is_refused(
    tmp_path: Path, lines: list[Line], capsys: pytest.CaptureFixture[str], topic: str
) -> None:
    text = "std_msgs/msg/String"
    others = [line for line in lines if line.topic != topic]
    path = write(tmp_path / "bag", [*others, Line(EPOCH_NS, topic, text, make(text, data="hello"))])
    assert f"/{topic} is a {text}; accepted: {TOPICS[topic].type_name}\n" in refuse(capsys, "replay", path)


def test_outputs_that_cannot_be_written_are_refused(
    tmp_path: Path, bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "exists already" in refuse(capsys, "replay", bag, "--output", tmp_path)
    assert "cannot be written" in refuse(capsys, "replay", bag, "--json", tmp_path / "no" / "out.json")
    assert "cannot be written" in refuse(capsys, "replay", bag, "--json", tmp_path)


@pytest.mark.parametrize("arguments", [[], ["drive"], ["replay"], ["import", "log.csv"]])
def test_a_bad_command_line_is_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    error = refuse(capsys, *arguments)
    assert error.startswith("trackslip")
    assert "--help" in error


@pytest.mark.parametrize(
    "arguments", [["replay", "nowhere"], ["replay", "--stop"], ["simulate", "--soil", "x"]]
)
def test_the_program_itself_leaves_with_2_and_one_line(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "trackslip_estimation.cli.main", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1


def test_the_installed_program_helps() -> None:
    done = subprocess.run(
        [Path(sys.executable).with_name("trackslip"), "replay", "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert "--withhold" in done.stdout


# What is done


def test_the_summary_has_the_keys_of_the_contract(bag: Path, tmp_path: Path) -> None:
    found = summary(tmp_path, bag)
    assert found.keys() >= KEYS
    assert found["final"].keys() == {"x", "y", "yaw", "left_slip", "right_slip"}
    assert found["rmse"].keys() >= {"dead_reckoning", "encoder_gyro", "filter", "heading"}
    assert found["messages"] == {"sprockets": 501, "imu/data_raw": 100, "box_pose": 51, "reference_pose": 501}
    assert found["duration_s"] == pytest.approx(10.0)
    assert found["real_time_factor"] > 0.0
    assert found["reference"] == "reference_pose"
    assert set(found["rejected"]) <= {"sprockets", "imu/data_raw", "box_pose"}
    assert {reason for reasons in found["rejected"].values() for reason in reasons} == {"waiting"}


def test_the_filter_beats_dead_reckoning(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rmse = summary(tmp_path, bag)["rmse"]
    assert rmse["filter"] < 0.05
    assert rmse["filter"] < rmse["encoder_gyro"] < rmse["dead_reckoning"]
    shown = capsys.readouterr().out
    for number in (rmse["filter"], rmse["encoder_gyro"], rmse["dead_reckoning"]):
        assert f"{number:.4f}" in shown


def test_the_same_replay_twice_is_the_same(bag: Path, tmp_path: Path) -> None:
    options = ("--thin", "box_pose:2:0.1", "--seed", "3")
    assert without_time(summary(tmp_path, bag, *options)) == without_time(summary(tmp_path, bag, *options))
    assert summary(tmp_path, bag, *options)["final"] != summary(tmp_path, bag, *options[:2])["final"]


def test_sqlite_replays_as_mcap(bag: Path, tmp_path: Path, lines: list[Line]) -> None:
    writer = Writer(tmp_path / "sqlite", version=8, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connections = {
            line.topic: writer.add_connection(f"/{line.topic}", line.type_name, typestore=typestore())
            for line in {line.topic: line for line in lines}.values()
        }
        for line in sorted(lines, key=lambda line: line.log_ns):
            writer.write(connections[line.topic], line.log_ns, serialize(line.message))
    assert next((tmp_path / "sqlite").glob("*.db3")).exists()
    assert without_time(summary(tmp_path, tmp_path / "sqlite")) == without_time(summary(tmp_path, bag))


def test_a_window_cuts_by_log_time(bag: Path, tmp_path: Path) -> None:
    found = summary(tmp_path, bag, "--start", "2", "--stop", "5")
    assert found["messages"]["sprockets"] == 150
    assert found["duration_s"] == pytest.approx(3.0, abs=0.35)


def test_a_window_beyond_the_bag_holds_nothing(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = summary(tmp_path, bag, "--start", "1000", code=ExitCode.FAILED)
    assert (found["final"], found["messages"], found["nees"]) == (None, {}, None)
    assert "no estimate" in capsys.readouterr().out


def test_withheld_fixes_are_not_used_but_score(bag: Path, tmp_path: Path) -> None:
    whole = summary(tmp_path, bag)
    without = summary(tmp_path, bag, "--withhold", "box_pose:4:9", "--withhold", "imu/data_raw:4:9")
    assert without["rmse"]["filter"] > whole["rmse"]["filter"]
    assert without["rmse"]["dead_reckoning"] == whole["rmse"]["dead_reckoning"]
    assert summary(tmp_path, bag, "--withhold", "/box_pose", code=ExitCode.FAILED)["final"] is None


def test_another_reference_is_scored_whole(bag: Path, tmp_path: Path) -> None:
    found = summary(tmp_path, bag, "--reference", "box_pose")
    assert found["reference"] == "box_pose"
    assert found["rmse"]["filter"] != summary(tmp_path, bag)["rmse"]["filter"]


def test_a_remapped_topic_is_the_source(bag: Path, tmp_path: Path, lines: list[Line]) -> None:
    names = {"box_pose": "gnss/pose", "sprockets": "wheels"}
    renamed = write(
        tmp_path / "renamed", [line._replace(topic=names.get(line.topic, line.topic)) for line in lines]
    )
    remaps = ("--remap", "gnss/pose:=box_pose", "--remap", "/wheels:=sprockets")
    assert without_time(summary(tmp_path, renamed, *remaps)) == without_time(summary(tmp_path, bag))
    scored = summary(tmp_path, renamed, *remaps, "--reference", "box_pose")
    assert scored["rmse"] == summary(tmp_path, bag, "--reference", "box_pose")["rmse"]


def test_parameters_come_in_layers(bag: Path, tmp_path: Path) -> None:
    wide = tmp_path / "wide.yaml"
    wide.write_text("/**: {ros__parameters: {vehicle: {tread: 1.46}}}\n", encoding="utf-8")
    tread = "slip_estimator.vehicle.tread"
    default, by_file = summary(tmp_path, bag), summary(tmp_path, bag, "--params", wide)
    assert by_file["rmse"]["dead_reckoning"] != default["rmse"]["dead_reckoning"]
    assert summary(tmp_path, bag, "--set", f"{tread}=1.46")["rmse"] == by_file["rmse"]
    back = summary(tmp_path, bag, "--params", wide, "--set", f"{tread}=1", "--set", f"{tread}=0.73")
    assert back["rmse"] == default["rmse"]


def test_a_replay_of_a_recorded_run_matches_it(bag: Path, tmp_path: Path, lines: list[Line]) -> None:
    """What a replay wrote, put beside its inputs, is a recording; it replays to the same numbers."""
    made = tmp_path / "made"
    summary(tmp_path, bag, "--output", made, "--set", "slip_estimator.pose_timeouts=[9.0]")
    with open_bag(made) as estimates:
        assert {t.removeprefix("/"): i.type_name for t, i in estimates.topics.items()} == {
            topic: TOPICS[topic].type_name
            for topic in ("odometry", "track_slip", "measurement_reports", "slip_estimator/parameters")
        }
        written = [(m, estimates.deserialize(m.raw, m.type_name)) for m in estimates.messages()]
    in_order = sorted(written, key=lambda pair: getattr(pair[1], "sequence", -1))
    both = tmp_path / "both"
    with BagWriter(both) as recording:
        for line in sorted(lines, key=lambda line: line.log_ns):
            recording.write(f"/{line.topic}", line.type_name, serialize(line.message), line.log_ns)
        for k, (message, _) in enumerate(in_order):
            recording.write(message.topic, message.type_name, message.raw, EPOCH_NS + 20_000 * MS + k)
    assert summary(tmp_path, both)["replay_matches"] is True
    assert "replay_matches" not in summary(tmp_path, both, "--withhold", "box_pose:4:5")
    assert summary(tmp_path, both, "--set", "slip_estimator.vehicle.tread=0.74")["replay_matches"] is False


def test_info_lists_the_topics(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("info", bag) == ExitCode.DONE
    shown = capsys.readouterr().out
    for topic in ("/sprockets", "/imu/data_raw", "/box_pose", "/reference_pose"):
        assert topic in shown


def test_a_parameter_file_without_anything_for_the_estimator_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.yaml"
    other.write_text("can_driver: {ros__parameters: {can_channel: can0}}\n", encoding="utf-8")
    error = refuse(capsys, "replay", bag, "--params", other)
    assert f"--params {other}: nothing for slip_estimator in it; accepted: " in error


def test_json_holds_null_for_what_is_no_number(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> dict[str, Any]:
        return {"final": {"x": float("nan")}, "K_interval": [0.1, float("inf")], "nees": None, "n": 3}

    monkeypatch.setattr("trackslip_estimation.cli.replay_command.summary", broken)
    found = summary(tmp_path, bag)
    assert found == {"final": {"x": None}, "K_interval": [0.1, None], "nees": None, "n": 3}
