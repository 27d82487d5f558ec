# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates from a data frame equal those of an import and a replay; errors name the columns."""

import multiprocessing
from datetime import datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml
from fixtures.setup_drives import PROGRAMME, make_drive

import trackslip as ts

TREAD, RADIUS = 2.0, 0.5  # m
RATE, SPEED = 20.0, 1.0  # Hz, m/s
SHORT = 10.0  # s
MACHINE: dict[str, Any] = {
    "name": "made",
    "kinematics": {"rolling_radius": RADIUS, "tread": TREAD, "contact_length": 3.0},
}
SOURCES: dict[str, dict[str, Any]] = {
    "sprockets": {"left_velocity": ("left", "rad/s"), "right_velocity": ("right", "rad/s")},
    "imu/data_raw": {"angular_velocity_z": ("gz", "deg/s")},
    "fixes": {"role": "pose", "x": ("x", "m"), "y": ("y", "m"), "stddev": {"x": 0.02, "y": 0.02}},
}


def drive(duration: float = 30.0) -> dict[str, np.ndarray]:
    """Columns of a drive: straight for the first half, then an arc; fixes once a second; no slip."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    rate = np.where(t < duration / 2.0, 0.0, 0.1)  # rad/s
    yaw = np.concatenate(([0.0], np.cumsum(rate[:-1]) / RATE))
    x = np.concatenate(([0.0], np.cumsum(SPEED * np.cos(yaw[:-1])) / RATE))
    y = np.concatenate(([0.0], np.cumsum(SPEED * np.sin(yaw[:-1])) / RATE))
    has_fix = np.arange(len(t)) % round(RATE) == 0
    return {
        "t": t,
        "left": (SPEED - rate * TREAD / 2.0) / RADIUS,
        "right": (SPEED + rate * TREAD / 2.0) / RADIUS,
        "gz": np.degrees(rate),
        "x": np.where(has_fix, x, np.nan),
        "y": np.where(has_fix, y, np.nan),
    }


def estimator(**changes: Any) -> ts.Estimator:
    return ts.Estimator(vehicle=MACHINE, sources={**SOURCES, **changes})


@pytest.fixture(scope="module")
def result() -> ts.Result:
    return estimator().run(drive())


@pytest.fixture(scope="module")
def short_result() -> ts.Result:
    """Result of a drive that suffices for comparisons."""
    return estimator().run(drive(SHORT))


def test_path_of_a_frame_is_found(result: ts.Result) -> None:
    columns, pose = drive(), result.estimates.pose[-1]
    last_fix = np.flatnonzero(np.isfinite(columns["x"]))[-1]
    since_fix = round((columns["t"][-1] - columns["t"][last_fix]) * 1e9)
    k = np.searchsorted(result.estimates.stamp_ns, result.estimates.stamp_ns[-1] - since_fix)
    position = result.estimates.pose[k, :2]
    assert np.hypot(*(position - (columns["x"][last_fix], columns["y"][last_fix]))) < 0.1
    assert pose[2] == pytest.approx(1.5, abs=0.05)
    assert np.abs(result.estimates.slips[-1, :2]).max() < 0.1
    assert result.summary["vehicle"] == "made"


def test_degrees_become_metres_of_a_datum() -> None:
    columns = drive(SHORT)
    columns["lat"], columns["lon"] = 52.0 + columns.pop("y") / 111_250.0, 13.0 + columns.pop("x") / 68_500.0
    place = {"latitude": ("lat", "deg"), "longitude": ("lon", "deg"), "stddev": {"x": 0.02, "y": 0.02}}
    sources = {name: SOURCES[name] for name in ("sprockets", "imu/data_raw")}
    found = ts.Estimator(vehicle=MACHINE, sources={**sources, "gnss_pose": place}).run(columns)
    assert found.estimates.datum is not None
    assert found.estimates.datum[:2] == (52.0, 13.0)


def test_tracks_alone_are_dead_reckoned() -> None:
    sources = {"sprockets": SOURCES["sprockets"]}
    found = ts.Estimator(vehicle=MACHINE, sources=sources).run(drive(10.0))
    assert found.estimates.pose[-1, 0] > 4.0
    assert found.estimates.pose_covariance[-1, 0, 0] > found.estimates.pose_covariance[0, 0, 0]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"imu/data_raw": {"angular_velocity_z": ("gyro", "deg/s")}}, "frame: no column 'gyro'"),
        ({"imu/data_raw": {"angular_velocity_z": ("gz", "deg")}}, "unit"),
        ({"imu/data_raw": {"angular_z": ("gz", "deg/s")}}, "angular_z"),
        ({"imu/data_raw": {"angular_velocity_z": ([3, "gz"], "deg/s")}}, "3 is not accepted; accepted: text"),
        (
            {"imu/data_raw": {"angular_velocity_z": {"column": "gz", "unit": "deg/s", "scale": 0}}},
            "angular_velocity_z.scale: 0 is out of range",
        ),
        ({"fixes": {"role": "pose", "x": ("x", "m"), "y": ("y", "m")}}, "fixes"),
    ],
)
def test_bad_sources_are_named(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ts.InputError, match=sentence) as caught:
        estimator(**change).run(drive(3.0))
    assert "/tmp" not in str(caught.value)


def test_every_source_is_used() -> None:
    columns = {**drive(SHORT), "speed": np.full(round(SHORT * RATE), SPEED)}
    radar = {"role": "velocity", "forward": ("speed", "m/s")}
    assert estimator(radar=radar).run(columns).summary["messages"]["radar"] == len(columns["t"])


def test_pose_source_may_be_left_out_by_a_parameter() -> None:
    found = ts.Estimator(MACHINE, SOURCES, parameters={"pose_sources": [""]}).run(drive(SHORT))
    assert "fixes" not in found.summary["messages"]


def test_rows_of_a_negative_standard_deviation_are_left_out() -> None:
    columns = drive(SHORT)
    columns["sd"] = np.where(columns["t"] < 5.0, 0.02, -1.0)
    stddev = {axis: {"column": "sd", "unit": "m"} for axis in "xy"}
    found = estimator(fixes={**SOURCES["fixes"], "stddev": stddev}).run(columns)
    assert any(note.startswith("left out: 5 of /fixes") for note in found.notes)


def _run(results: "multiprocessing.Queue[str]") -> None:
    try:
        results.put(str(estimator().run(drive(3.0))))
    except ts.InputError as error:
        results.put(str(error))


def test_fork_of_a_process_that_has_estimated_is_refused(short_result: ts.Result) -> None:
    """Threads of polars are not in a fork: it would wait for them for ever."""
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=_run, args=(results,))
    process.start()
    assert "run: this process was forked" in results.get(timeout=60.0)
    process.join()


def test_setup_of_a_frame_is_checked() -> None:
    log = make_drive(programme=PROGRAMME[:6])
    tracks, gyro, fixes = log.tracks, log.gyros[0], log.fixes[0]
    parts = (
        {"t": tracks.t, "left": tracks.speeds[:, 0], "right": tracks.speeds[:, 1]},
        {"t": gyro.t, "gz": -np.degrees(gyro.rates[:, 2])},  # wrong sign
        {"t": fixes.t, "x": fixes.places[:, 0], "y": fixes.places[:, 1]},
    )
    frame = pl.concat([pl.DataFrame(part) for part in parts], how="diagonal").sort("t", maintain_order=True)
    machine = {**MACHINE, "kinematics": {"rolling_radius": 0.35, "tread": 2.0, "contact_length": 2.5}}
    lever = {"sources.fixes.lever_arm_x": 0.5, "sources.fixes.lever_arm_y": 0.2}
    found = ts.Estimator(vehicle=machine, sources=SOURCES, parameters=lever).run(frame).setup
    assert {cause.source for cause in found.causes} == {"imu/data_raw"}
    assert found.causes[0].cause in str(found)


def test_resolution_of_a_coarse_encoder_is_found_from_its_counts() -> None:
    columns, sprockets = drive(), {}
    for side in ("left", "right"):
        columns[side] = np.floor(50.0 * np.cumsum(columns[side]) / RATE / (2.0 * np.pi))
        sprockets[f"{side}_position"] = {"column": side, "unit": "rev", "scale": 1.0 / 50.0}
    sources = {**SOURCES, "sprockets": sprockets}
    found = ts.Estimator(vehicle=MACHINE, sources=sources).run(columns)
    assert "jumped" not in found.text
    assert found.setup.is_plausible
    differences = {side: np.diff(columns[side], prepend=0.0) * RATE / 50.0 for side in ("left", "right")}
    speeds = {f"{side}_velocity": (side, "rev/s") for side in differences}
    for source_set, frame in (
        (sources, columns),
        ({**SOURCES, "sprockets": speeds}, {**columns, **differences}),
    ):
        with_resolution = ts.Estimator(
            vehicle=MACHINE, sources=source_set, parameters={"encoder_resolution": 1e-4}
        )
        assert {cause.cause for cause in with_resolution.run(frame).setup.causes} == {"encoder_resolution"}


def mixed(columns: dict[str, np.ndarray]) -> dict[Any, Any]:
    """Columns with decimals, nulls, a mask, and a number as a name."""
    named = {(3 if name == "3" else name): column for name, column in columns.items()}
    return {
        **named,
        "t": [Decimal(repr(v)) for v in columns["t"].tolist()],
        "x": [None if v != v else v for v in columns["x"].tolist()],
        "y": np.ma.masked_equal(np.nan_to_num(columns["y"], nan=-999), -999),
    }


FRAMES: dict[str, Any] = {
    "long numbers": lambda columns: {name: column.astype(np.longdouble) for name, column in columns.items()},
    "named 3 and '3'": lambda columns: {**columns, 3: 0.0 * columns["gz"]},
    "polars": pl.DataFrame,
    "lazy": lambda columns: pl.DataFrame(columns).lazy(),
    "mixed": mixed,
}


@pytest.mark.parametrize("kind", FRAMES)
def test_every_kind_of_frame_and_cell_gives_the_same_estimates(short_result: ts.Result, kind: str) -> None:
    columns = {**drive(SHORT), "3": drive(SHORT)["gz"]}
    gyro = {"angular_velocity_z": ("3", "deg/s")}
    again = estimator(**{"imu/data_raw": gyro}).run(FRAMES[kind](columns))
    assert np.array_equal(again.estimates.pose, short_result.estimates.pose)
    assert np.array_equal(again.estimates.pose_covariance, short_result.estimates.pose_covariance)


DATES: dict[str, Any] = {
    "numpy, ms": lambda ms: ms.astype("datetime64[ms]"),
    "numpy, big-endian": lambda ms: ms.astype("datetime64[ms]").astype(">M8[ms]"),
    "numpy, us": lambda ms: ms.astype("datetime64[ms]").astype("datetime64[us]"),
    "Python, with a zone": lambda ms: [
        datetime.fromtimestamp(one * 1e-3, timezone(timedelta(hours=2))) for one in ms.tolist()
    ],
    "polars, with a zone": lambda ms: pl.Series(ms).cast(pl.Datetime("ms", "Europe/Berlin")),
}


@pytest.mark.parametrize("kind", DATES)
def test_columns_of_dates_are_times(kind: str) -> None:
    columns = drive(3.0)
    ms = 1_790_000_000_000 + (columns["t"] * 1e3).round().astype(np.int64)
    frame = {**columns, "t": DATES[kind](ms)}
    found = ts.Estimator(vehicle=MACHINE, sources=SOURCES, time=("t", "iso8601")).run(frame)
    assert np.isin(found.estimates.stamp_ns, ms * 1_000_000).all()
    with pytest.raises(ts.InputError, match="is its unit iso8601"):
        estimator().run(frame)


def test_missing_dates_are_noted_as_rows_without_time() -> None:
    times = (drive(3.0)["t"] * 1e3).astype("datetime64[ms]")
    times[7] = np.datetime64("NaT")
    found = ts.Estimator(vehicle=MACHINE, sources=SOURCES, time=("t", "iso8601")).run(
        {**drive(3.0), "t": times}
    )
    assert any("no time" in note for note in found.notes)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"gz": np.zeros((60, 2))}, r"column 'gz' has the shape \(60, 2\)"),
        ({"gz": 0.0}, r"column 'gz' has the shape \(\)"),
        ({"gz": np.zeros(59)}, "column 'gz' has 59 rows, 't' 60"),
        ({"gz": np.zeros(60, complex)}, "column 'gz' holds complex128"),
        ({"t": np.arange(60).astype("timedelta64[ms]")}, r"holds timedelta64.* as of .dt.total_seconds\(\)"),
        ({"t": np.arange(60)[::-1].copy()}, "^frame: row 1, column 't' goes back"),
        ({"gz": np.append(np.inf, np.zeros(59))}, "^frame: row 0, column 'gz': 'inf' is not accepted"),
    ],
)
def test_unusable_columns_are_named(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ts.InputError, match=sentence):
        estimator().run({**drive(3.0), **change})


class Series:
    """As a series of pandas: no table."""

    def reset_index(self) -> None: ...


@pytest.mark.parametrize(
    "frame", [None, "log.csv", Series(), np.zeros((3, 3)), {name: [] for name in drive(3.0)}]
)
def test_argument_that_is_no_frame_is_refused_by_name(frame: Any) -> None:
    with pytest.raises(ts.InputError, match=r"^frame: .*accepted"):
        estimator().run(frame)


class IndexedFrame(dict[str, np.ndarray]):
    """As a frame of pandas with times as its index."""

    class index:
        names = ("t",)

    columns = property(dict.keys)

    def reset_index(self) -> dict[str, np.ndarray]:
        return {"t": drive(SHORT)["t"], **self}


def test_times_may_be_the_index_of_a_frame(short_result: ts.Result) -> None:
    columns = drive(SHORT)
    del columns["t"]
    again = estimator().run(IndexedFrame(columns))
    assert np.array_equal(again.estimates.pose, short_result.estimates.pose)


def test_index_of_dates_without_a_name_is_named_with_its_remedy() -> None:
    columns = drive(3.0)
    del columns["t"]
    frame = IndexedFrame(columns)
    frame.index = type("DatetimeIndex", (), {"names": [None]})()
    with pytest.raises(ts.InputError, match=r"no column 't'.*frame.rename_axis\('t'\)"):
        estimator().run(frame)


def test_names_of_columns_are_free(short_result: ts.Result) -> None:
    names = ("# t", " left", 'the "right"', "gz, deg/s", "x\n1", "角速度")
    columns = dict(zip(names, drive(SHORT).values(), strict=True))
    time, left, right, gyro, x, y = names
    sources = {
        "sprockets": {"left_velocity": (left, "rad/s"), "right_velocity": (right, "rad/s")},
        "imu/data_raw": {"angular_velocity_z": (gyro, "deg/s")},
        "fixes": {**SOURCES["fixes"], "x": (x, "m"), "y": (y, "m")},
    }
    again = ts.Estimator(MACHINE, sources, time=(time, "s")).run(columns)
    assert np.array_equal(again.estimates.pose, short_result.estimates.pose)


def test_numbers_of_numpy_are_numbers(short_result: ts.Result, tmp_path: Path) -> None:
    """Sources, parameters and the machine accept NumPy numbers; a machine may also be a file path."""
    stddev = {"x": np.float64(0.02), "y": np.float32(0.02).astype(np.float64).round(2)}
    sources = {**SOURCES, "fixes": {**SOURCES["fixes"], "stddev": stddev}}
    numbers = {name: np.float64(value) for name, value in MACHINE["kinematics"].items()}
    machine = tmp_path / "made.yaml"
    machine.write_text(yaml.safe_dump(MACHINE), encoding="utf-8")
    for vehicle in ({**MACHINE, "kinematics": numbers}, machine):
        parameters = {"max_gap": np.int64(5), "pose_sources": np.array(["fixes"])}
        found = ts.Estimator(vehicle, sources, parameters=parameters).run(drive(SHORT))
        assert np.array_equal(found.estimates.pose, short_result.estimates.pose)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"time": "t"}, "time: 't' is not accepted"),
        ({"sources": ["sprockets"]}, "sources: "),
        ({"sources": {**SOURCES, "fixes": None}}, "sources: fixes: None"),
        ({"sources": {**SOURCES, "imu/data_raw": {"angular_velocity_z": ("gz",)}}}, r"_z: \('gz',\)"),
        ({"parameters": ["max_gap"]}, "parameters: "),
        ({"sources": {3: SOURCES["fixes"]}}, "sources: 3 is not accepted; accepted: text"),
        ({"sources": {**SOURCES, "fix": {"x": ("x", "m"), "y": ("y", "m")}}}, "sources: fix: .* role: pose"),
        ({"parameters": {"max_gap": object()}}, "sources: <object"),
    ],
)
def test_arguments_of_another_form_are_named(arguments: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ts.InputError, match=sentence):
        ts.Estimator(**{"vehicle": MACHINE, "sources": SOURCES, **arguments})
