# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The Python interface returns what the commands give, to the last bit, and its parts are consistent."""

import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import trackslip as ts
from trackslip_bags.reader import open_bag
from trackslip_bags.tables import read_tables
from trackslip_common.message_fields import OdometryFields
from trackslip_common.orientations import headings_of
from trackslip_tools.cli.main import main

DATUM = (52.0, 13.0, 40.0)  # deg, deg, m


@pytest.fixture(scope="module")
def result() -> ts.Result:
    """The result of the example."""
    return ts.replay(ts.example())


def test_public_names_are_listed_and_there() -> None:
    assert [name for name in ts.__all__ if not hasattr(ts, name)] == []
    modules = {name for name in vars(ts) if not name.startswith("_")}
    assert modules - set(ts.__all__) == set()


def test_estimates_are_those_that_the_command_writes(result: ts.Result, tmp_path: Path) -> None:
    assert main(["replay", str(ts.example()), "--output", str(tmp_path / "bag")]) == 0
    with open_bag(tmp_path / "bag") as bag:
        tables = [s["/odometry"] for s in read_tables(bag, ["odometry"])]
        rows = np.concatenate([table.rows(OdometryFields) for table in tables])
    estimates = result.estimates
    assert np.array_equal(rows["stamp_ns"], estimates.stamp_ns)
    assert np.array_equal(np.column_stack((rows["x"], rows["y"])), estimates.pose[:, :2])
    assert np.allclose(headings_of(rows), estimates.pose[:, 2], rtol=0.0, atol=1e-12)  # of quaternions


def test_summary_is_that_of_the_command(result: ts.Result, tmp_path: Path) -> None:
    main(["replay", str(ts.example()), "--json", str(tmp_path / "summary.json")])
    expected = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    summary = json.loads(json.dumps(result.summary))
    for one in (summary, expected):
        del one["real_time_factor"]  # differs between runs
    assert summary == expected


def test_example_is_estimated_within_its_own_uncertainty(result: ts.Result) -> None:
    assert result.setup.is_plausible
    assert result.summary["rmse"]["filter"] < 0.05
    assert 0.5 < result.summary["nees"] < 8.0  # 3 if consistent; correlated over ten seconds


def test_covariances_are_of_their_columns_and_positive(result: ts.Result) -> None:
    estimates = result.estimates
    n = len(estimates)
    assert n > 500
    assert (np.diff(estimates.stamp_ns) > 0).all()
    for name, width in (("pose", 3), ("twist", 3), ("slips", 3), ("tilt", 3), ("swing", 2)):
        assert getattr(estimates, name).shape == (n, width)
        covariance = getattr(estimates, f"{name}_covariance")
        assert covariance.shape == (n, width, width)
        known = covariance[np.isfinite(covariance[:, 0, 0])]
        assert (np.linalg.eigvalsh(known) > -1e-12).all()


def test_settings_and_filters_act_as_the_options_do(result: ts.Result) -> None:
    withheld = ts.replay(ts.example(), withhold=["gnss_pose:8:14"], stop=14.0)
    assert withheld.summary["withheld"]
    assert withheld.estimates.pose_covariance[-1, 0, 0] > result.estimates.pose_covariance[-1, 0, 0]
    changed = ts.replay(ts.example(), settings={"slip_estimator.max_gap": 4.0}, stop=8.0)
    assert changed.estimates.time[-1] < 8.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"settings": {"slip_estimator.nothing": 1}}, "nothing"),
        ({"settings": {"slip_estimator.max_gap": object()}}, r"settings: slip_estimator\.max_gap"),
        ({"withhold": ["gps"]}, r"--withhold gps: there is no such topic"),
        ({"vehicle": "excavator"}, r"vehicle 'excavator': no such vehicle or file"),
        ({"start": 5.0, "stop": 4.0}, "start before stop"),
        ({"start": "a"}, "start: 'a' is refused; accepted: a number"),
        ({"start": 1j}, "start: 1j is refused; accepted: a number"),
        ({"seed": 1.5}, "seed: 1.5 is refused; accepted: a whole number >= 0"),
        ({"seed": -1}, "seed: -1 is refused"),
        ({"settings": []}, "settings: .* is not accepted"),
        ({"vehicle": {"mass": 20000}}, "vehicle: .* is refused; accepted: text"),
        ({"withhold": [3]}, "withhold: 3 is refused"),
        ({"namespace": 3}, "namespace: 3 is refused"),
    ],
)
def test_bad_arguments_raise_the_sentence_of_the_command(arguments: dict, sentence: str) -> None:
    with pytest.raises(ts.InputError, match=sentence):
        ts.replay(ts.example(), **arguments)


def test_single_topic_equals_a_list_of_one() -> None:
    one, listed = (ts.replay(ts.example(), withhold=w, stop=4.0) for w in ("gnss_pose", ["gnss_pose"]))
    assert one.summary["withheld"] == listed.summary["withheld"]
    assert [w["topic"] for w in one.summary["withheld"]] == ["gnss_pose"]


def test_check_lists_what_the_drive_cannot_decide(capsys: pytest.CaptureFixture[str]) -> None:
    found = ts.check(ts.example())
    assert found.is_plausible
    assert found.undetermined
    main(["check", str(ts.example())])
    assert str(found) in capsys.readouterr().out


def test_load_lists_topics_and_reads_columns() -> None:
    log = ts.load(ts.example())
    assert log.vehicle == "excavator_20t"
    speeds = log.columns("sprockets")
    assert len(speeds["log_time_ns"]) == log.topics["/sprockets"]
    assert {"stamp_ns", "left_speed", "right_speed"} <= speeds.keys()
    with pytest.raises(ts.InputError, match="has no messages on /gps"):
        log.columns("gps")
    with pytest.raises(ts.InputError, match="/vehicle is a std_msgs/msg/String, which has no columns"):
        log.columns("/vehicle")


def test_log_can_be_sent_to_another_process() -> None:
    assert pickle.loads(pickle.dumps(ts.load(ts.example()))).topics == ts.load(ts.example()).topics


@pytest.mark.parametrize("topic", [None, 3, ["sprockets"]])
def test_topic_that_is_no_text_is_named(topic: Any) -> None:
    with pytest.raises(ts.InputError, match=r"topic: .* is refused; accepted: text"):
        ts.load(ts.example()).columns(topic)


def test_long_argument_is_named_by_its_type(result: ts.Result) -> None:
    arguments: list[Any] = [result, {name: [0.0] * 30 for name in "xyz"}]
    for argument, kind in zip(arguments, ("Result", "dict"), strict=True):
        with pytest.raises(ts.InputError, match=f"bag: a {kind} is refused; accepted: text"):
            ts.replay(argument)


def test_a_missing_bag_is_named() -> None:
    with pytest.raises(ts.InputError, match="bag 'nowhere' not found"):
        ts.load("nowhere")


def test_csv_has_every_column(result: ts.Result, tmp_path: Path) -> None:
    path = result.estimates.save(tmp_path / "estimates.csv")
    table, columns = pl.read_csv(path), result.estimates.columns()
    assert table.columns == list(columns)
    assert np.array_equal(table["x"].to_numpy(), columns["x"])
    assert np.array_equal(table["stamp_ns"].to_numpy(), columns["stamp_ns"])


def test_tum_has_the_poses_as_unit_quaternions(result: ts.Result, tmp_path: Path) -> None:
    rows = np.loadtxt(result.estimates.save(tmp_path / "estimates.tum"))
    assert rows.shape == (len(result.estimates), 8)
    assert np.array_equal(rows[:, 1:3], result.estimates.pose[:, :2])
    assert np.allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0)
    x, y, z, w = rows[:, 4:].T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    assert np.allclose(np.angle(np.exp(1j * (yaw - result.estimates.pose[:, 2]))), 0.0, atol=1e-9)


def test_geojson_has_the_path_in_degrees(result: ts.Result, tmp_path: Path) -> None:
    with pytest.raises(ts.InputError, match="datum"):
        result.estimates.save(tmp_path / "path.geojson")
    path = result.estimates.save(tmp_path / "path.geojson", datum=DATUM)
    (feature,) = json.loads(path.read_text(encoding="utf-8"))["features"]
    longitude, latitude = np.array(feature["geometry"]["coordinates"]).T
    metres = 111_300.0  # length of a degree of latitude, to a thousandth
    east, north = result.estimates.pose[:, :2].T
    assert np.allclose((latitude - DATUM[0]) * metres, north, atol=0.1)
    scale = math.cos(math.radians(DATUM[0]))
    assert np.allclose((longitude - DATUM[1]) * metres * scale, east, atol=0.1)
    assert len(feature["properties"]["coordTimes"]) == len(east)


@pytest.mark.parametrize("path", [None, 3, b"path.csv"])
def test_path_that_is_no_text_is_named(result: ts.Result, path: Any) -> None:
    with pytest.raises(ts.InputError, match=r"save: .* is refused; accepted: text"):
        result.estimates.save(path)


def test_datum_may_be_an_array(result: ts.Result, tmp_path: Path) -> None:
    of_tuple, of_array = (
        result.estimates.save(tmp_path / f"{kind.__name__}.geojson", datum=kind(DATUM))
        for kind in (tuple, np.array)
    )
    assert of_tuple.read_text(encoding="utf-8") == of_array.read_text(encoding="utf-8")


@pytest.mark.parametrize("datum", [(52.0, 13.0), (200.0, 13.0, 40.0), (math.nan, 13.0, 40.0), "52, 13, 40"])
def test_a_datum_that_is_no_place_is_refused(result: ts.Result, datum: Any, tmp_path: Path) -> None:
    with pytest.raises(
        ts.InputError, match=r"is no datum; accepted: datum=\(latitude, longitude, altitude\)"
    ):
        result.estimates.save(tmp_path / "path.geojson", datum=datum)


def test_another_ending_is_refused(result: ts.Result, tmp_path: Path) -> None:
    with pytest.raises(ts.InputError, match=r"accepted: \.csv, \.tum, \.geojson"):
        result.estimates.save(tmp_path / "estimates.xls")


def test_pandas_that_is_missing_is_named(result: ts.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ts.InputError, match="pip install pandas"):
        result.estimates.to_pandas()
