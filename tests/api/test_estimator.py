# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates from a data frame: as an import and a replay give them, with faults named by their columns."""

from typing import Any

import numpy as np
import polars as pl
import pytest
from fixtures.setup_drives import make_drive

import trackslip as ts

TREAD, RADIUS = 2.0, 0.5  # m
RATE, SPEED = 20.0, 1.0  # Hz, m/s
MACHINE = {"name": "made", "kinematics": {"rolling_radius": RADIUS, "tread": TREAD, "contact_length": 3.0}}
SOURCES: dict[str, dict[str, Any]] = {
    "sprockets": {"left_velocity": ("left", "rad/s"), "right_velocity": ("right", "rad/s")},
    "imu/data_raw": {"angular_velocity_z": ("gz", "deg/s")},
    "fixes": {"role": "pose", "x": ("x", "m"), "y": ("y", "m"), "stddev": {"x": 0.02, "y": 0.02}},
}


def drive(duration: float = 30.0) -> dict[str, np.ndarray]:
    """Straight for half of it, then an arc, with fixes once a second; no slip."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    rate = np.where(t < duration / 2.0, 0.0, 0.1)  # rad/s
    yaw = np.concatenate(([0.0], np.cumsum(rate[:-1]) / RATE))
    x = np.concatenate(([0.0], np.cumsum(SPEED * np.cos(yaw[:-1])) / RATE))
    y = np.concatenate(([0.0], np.cumsum(SPEED * np.sin(yaw[:-1])) / RATE))
    fixed = np.arange(len(t)) % round(RATE) == 0
    return {
        "t": t,
        "left": (SPEED - rate * TREAD / 2.0) / RADIUS,
        "right": (SPEED + rate * TREAD / 2.0) / RADIUS,
        "gz": np.degrees(rate),
        "x": np.where(fixed, x, np.nan),
        "y": np.where(fixed, y, np.nan),
    }


def estimator(**changes: Any) -> ts.Estimator:
    return ts.Estimator(vehicle=MACHINE, sources={**SOURCES, **changes})


@pytest.fixture(scope="module")
def result() -> ts.Result:
    return estimator().run(drive())


def test_path_of_a_frame_is_found(result: ts.Result) -> None:
    columns, pose = drive(), result.estimates.pose[-1]
    at = np.flatnonzero(np.isfinite(columns["x"]))[-1]
    since = round((columns["t"][-1] - columns["t"][at]) * 1e9)
    k = np.searchsorted(result.estimates.stamp_ns, result.estimates.stamp_ns[-1] - since)
    place = result.estimates.pose[k, :2]
    assert np.hypot(*(place - (columns["x"][at], columns["y"][at]))) < 0.1
    assert pose[2] == pytest.approx(1.5, abs=0.05)
    assert np.abs(result.estimates.slips[-1, :2]).max() < 0.1
    assert result.summary["vehicle"] == "made"


def test_frames_of_every_kind_give_the_same(result: ts.Result) -> None:
    again = estimator().run(pl.DataFrame(drive()))
    assert np.array_equal(again.estimates.pose, result.estimates.pose)
    assert np.array_equal(again.estimates.pose_covariance, result.estimates.pose_covariance)


def test_degrees_become_metres_of_a_datum() -> None:
    columns = drive()
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
        ({"fixes": {"role": "pose", "x": ("x", "m"), "y": ("y", "m")}}, "fixes"),
    ],
)
def test_bad_sources_are_named(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ts.InputError, match=sentence) as caught:
        estimator(**change).run(drive(3.0))
    assert "/tmp" not in str(caught.value)


def test_setup_of_a_frame_is_checked() -> None:
    log = make_drive()
    tracks, gyro, fixes = log.tracks, log.gyros[0], log.fixes[0]
    parts = (
        {"t": tracks.t, "left": tracks.speeds[:, 0], "right": tracks.speeds[:, 1]},
        {"t": gyro.t, "gz": -np.degrees(gyro.rates[:, 2])},  # of the wrong sign
        {"t": fixes.t, "x": fixes.places[:, 0], "y": fixes.places[:, 1]},
    )
    frame = pl.concat([pl.DataFrame(part) for part in parts], how="diagonal").sort("t", maintain_order=True)
    machine = {**MACHINE, "kinematics": {"rolling_radius": 0.35, "tread": 2.0, "contact_length": 2.5}}
    lever = {"sources.fixes.lever_arm_x": 0.5, "sources.fixes.lever_arm_y": 0.2}
    found = ts.Estimator(vehicle=machine, sources=SOURCES, parameters=lever).run(frame).setup
    assert {cause.source for cause in found.causes} == {"imu/data_raw"}
    assert found.causes[0].cause in str(found)


def test_times_that_go_back_are_refused() -> None:
    columns = drive(3.0)
    columns["t"] = columns["t"][::-1].copy()
    with pytest.raises(ts.InputError, match="back"):
        estimator().run(columns)


def test_columns_of_dates_are_refused_with_the_remedy() -> None:
    columns = {**drive(3.0), "t": np.arange(60).astype("datetime64[ms]")}
    with pytest.raises(ts.InputError, match="int64"):
        estimator().run(columns)
