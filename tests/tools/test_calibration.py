# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of synthetic drives with known parameters: coverage of intervals, and explained refusals."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.config_files import node_parameters, read_yaml
from trackslip_common.message_fields import PoseFields
from trackslip_common.message_reading import dtype_of
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import YawRate
from trackslip_estimation.slip.parameters import NODE, load_slip_parameters
from trackslip_estimation.slip.records import STATE, to_records
from trackslip_estimation.slip.update import observe
from trackslip_tools.calibration import recording
from trackslip_tools.calibration.calibrate import Calibration, calibrate
from trackslip_tools.calibration.finding import Finding, make_finding
from trackslip_tools.calibration.output import summary, text, write_parameters
from trackslip_tools.calibration.recording import Recording, Series, motion_states
from trackslip_tools.calibration.regression import Increments, fit_clustered, fit_increments

P = load_slip_parameters()
SOURCES = ("imu/data_raw", "box_pose")
RADIUS, TREAD = P.vehicle.kinematics.rolling_radius, P.vehicle.kinematics.tread
COUNT = 5.1133e-4  # rad, encoder resolution
STANDSTILL, STRAIGHT = (5.0, 0.0, 0.0), (8.0, 2.2, 2.2)
LEFT, RIGHT = (6.0, 1.2, 2.2), (6.0, 2.2, 1.2)
DRIVE = (STANDSTILL, STRAIGHT, LEFT, STRAIGHT, RIGHT, STRAIGHT, LEFT, STRAIGHT, RIGHT, STANDSTILL)
RUNS = 40
LEAST_HITS = 34  # of 40: fewer have a probability of 0.3 % at a coverage of 95 %


@dataclass(frozen=True)
class Drive:
    """Parameters of a synthetic drive."""

    per_radian: float = 0.1575  # r (1 − i₀), m
    efficiency: float = 0.45  # κ
    scale: float = 0.985  # about the unit's z axis
    bias: float = 0.01  # rad/s
    roll: float = 0.05  # rad
    pitch: float = -0.08
    gyro_late: float = 0.06  # s, including the lag of the ground
    pose_late: float = 0.15  # s, in addition to the gyro's
    gyro_noise: float = 0.003  # rad/s
    heading_noise: float = 0.02  # rad
    offsets: tuple[float, float] = (1.0e5, -0.5e5)  # Pa
    legs: Sequence[tuple[float, float, float]] = DRIVE


def recorded(drive: Drive, seed: int) -> Recording:
    """A synthetic drive: (3.17)–(3.20) with κ and i₀, sensors at their own rates, with noise."""
    rng, dt = np.random.default_rng(seed), 0.01
    commands = np.concatenate([np.tile((left, right), (round(s / dt), 1)) for s, left, right in drive.legs])
    speeds = np.empty_like(commands)
    now = np.zeros(2)
    for k, command in enumerate(commands):
        now = now + dt / 0.15 * (command - now)
        speeds[k] = now
    t = np.arange(len(speeds)) * dt
    rate = drive.efficiency * RADIUS * (speeds[:, 1] - speeds[:, 0]) / TREAD
    speed = drive.per_radian * speeds.mean(axis=1) - 0.2 * RADIUS * np.abs(speeds[:, 1] - speeds[:, 0])
    heading = np.cumsum(rate) * dt
    path = np.column_stack((np.cumsum(speed * np.cos(heading)), np.cumsum(speed * np.sin(heading)))) * dt
    angles = np.round(np.cumsum(speeds, axis=0) * dt / COUNT) * COUNT
    gyro_t = np.arange(0.02, t[-1], 0.0844)
    axis = np.array((-math.tan(drive.pitch) / math.cos(drive.roll), math.tan(drive.roll), 1.0)) * drive.scale
    rates = np.interp(gyro_t - drive.gyro_late, t, rate)[:, np.newaxis] * axis + (0.001, -0.002, drive.bias)
    fix_t = np.arange(0.1, t[-1], 0.24)
    true_t = fix_t - drive.pose_late - drive.gyro_late
    poses = np.column_stack([np.interp(true_t, t, column) for column in (*path.T, heading)])
    poses += rng.normal(0.0, (0.03, 0.03, drive.heading_noise), poses.shape)
    variances = np.tile(np.square((0.05, 0.05, 0.03)), (len(fix_t), 1))  # conservative, as real sensors
    pressures = 2.0e6 * speeds + drive.offsets + rng.normal(0.0, 3e4, speeds.shape)
    sprockets = Series(t, angles)
    return Recording(
        sprockets,
        Series(gyro_t, rates + rng.normal(0.0, drive.gyro_noise, rates.shape)),
        Series(fix_t, np.column_stack((poses, variances))),
        Series(t, np.column_stack((pressures, commands / 3.0))),
        motion_states(sprockets, P.motion),
    )


@cache
def calibrated(drive: Drive, seed: int, hard_ground: bool = False) -> Calibration:
    return calibrate([recorded(drive, seed)], P, SOURCES, hard_ground=hard_ground, everything=True)


TRUE: Mapping[str, Callable[[Drive], float]] = {
    "gyro_bias": lambda m: m.bias,
    "gyro_scale": lambda m: m.scale,
    "pose_delay": lambda m: m.pose_late,
    "imu_roll": lambda m: m.roll,
    "imu_pitch": lambda m: m.pitch,
    "left_pressure_offset": lambda m: m.offsets[0],
    "right_pressure_offset": lambda m: m.offsets[1],
    "effective_rolling_radius": lambda m: m.per_radian,
    "turning_efficiency": lambda m: m.efficiency,
    "effective_tread": lambda m: TREAD / m.efficiency,
    "common_slip": lambda m: 1.0 - m.per_radian / RADIUS,
}
WIDEST = {"gyro_bias": 2e-3, "gyro_scale": 0.02, "pose_delay": 0.06, "imu_roll": 0.02, "imu_pitch": 0.02}
WIDEST |= dict.fromkeys(("left_pressure_offset", "right_pressure_offset"), 1e4)
WIDEST |= {"effective_rolling_radius": 0.002, "common_slip": 0.012}
WIDEST |= {"turning_efficiency": 0.02, "effective_tread": 0.08}


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUE)
def test_intervals_have_their_stated_coverage(name: str) -> None:
    """The intervals are also narrow: half an interval is below its limit."""
    drive = Drive()
    findings = [calibrated(drive, seed).findings[name] for seed in range(RUNS)]
    true = TRUE[name](drive)
    assert sum(f.contains(true) for f in findings) >= LEAST_HITS
    median = np.median([half(f) for f in findings])
    assert median < WIDEST[name]
    assert median < 4.0 * np.std(np.array([f.value for f in findings], dtype=np.float64))


def test_gyro_noise_does_not_bias_the_gyro_scale() -> None:
    """The noise between two headings is part of the rotation that the gyro measures."""
    drive = Drive(gyro_noise=0.05, heading_noise=0.004)
    findings = [calibrated(drive, seed).findings["gyro_scale"] for seed in range(5)]
    mean = np.mean([f.value for f in findings if f.value is not None])
    assert mean == pytest.approx(drive.scale, abs=0.015)
    assert sum(f.contains(drive.scale) for f in findings) >= 4


def half(finding: Finding) -> float:
    assert finding.interval is not None
    return (finding.interval[1] - finding.interval[0]) / 2.0


def test_interval_of_the_gyro_delay_covers_the_lag_of_the_ground() -> None:
    for late, ground in ((0.06, 0.0), (-0.1, 0.03)):
        finding = calibrated(Drive(gyro_late=late + ground), 1).findings["gyro_delay"]
        assert finding.contains(late)
        assert half(finding) < 0.03


@pytest.mark.parametrize("scale", [-0.97, 1.03])
def test_gyro_upside_down_is_found_from_headings_and_from_tracks(scale: float) -> None:
    with_poses = recorded(Drive(scale=scale), 2)
    without_poses = replace(with_poses, poses=Series(np.empty(0), np.empty((0, 6))))
    found, by_tracks = (calibrate([one], P, SOURCES).findings for one in (with_poses, without_poses))
    assert found["gyro_sign"].value == by_tracks["gyro_sign"].value == math.copysign(1.0, scale)
    assert found["gyro_scale"].value == pytest.approx(scale, abs=0.02)


@pytest.mark.parametrize(
    ("legs", "names", "word"),
    [
        (
            (STANDSTILL, STRAIGHT, STRAIGHT),
            ("gyro_scale", "pose_delay", "imu_roll", "imu_pitch"),
            "rad in all; needed",
        ),
        ((STANDSTILL, STRAIGHT, STRAIGHT), ("turning_efficiency", "effective_tread", "gyro_delay"), "turns"),
        (
            (LEFT, RIGHT, LEFT, RIGHT),
            ("effective_rolling_radius", "rolling_radius", "common_slip"),
            "straights",
        ),
        ((STRAIGHT, LEFT, RIGHT), ("gyro_bias", "left_pressure_offset"), "does not stand"),
        ((STANDSTILL, STANDSTILL), ("gyro_sign", "gyro_scale", "effective_tread", "rolling_radius"), ""),
        (DRIVE, ("tread",), "tape"),
    ],
)
def test_unobservable_parameter_is_refused_with_a_reason(
    legs: Sequence[tuple[float, float, float]], names: Sequence[str], word: str
) -> None:
    findings = calibrated(Drive(legs=tuple(legs)), 3).findings
    for name in names:
        assert not findings[name].has_value, name
        assert findings[name].reason
        assert word in findings[name].reason


def test_missing_sensors_are_refused_too() -> None:
    whole = recorded(Drive(), 4)
    none = Series(np.empty(0), np.empty((0, 6)))
    without_gyro = replace(
        whole, gyro=Series(none.t, np.empty((0, 3))), hydraulics=Series(none.t, np.empty((0, 4)))
    )
    findings = calibrate([without_gyro], P, SOURCES).findings
    found = {name for name, finding in findings.items() if finding.has_value}
    assert found == {"effective_rolling_radius", "common_slip"}
    without_poses = calibrate([replace(whole, poses=none)], P, SOURCES).findings
    assert not without_poses["gyro_scale"].has_value
    assert not without_poses["effective_rolling_radius"].has_value
    assert "taken as 1" in without_poses["turning_efficiency"].basis


def test_reason_without_a_sensor_names_the_sensor() -> None:
    whole = recorded(Drive(), 4)
    parts = {
        "gyro": replace(whole, gyro=Series(np.empty(0), np.empty((0, 3)))),
        "fixes": replace(whole, poses=Series(np.empty(0), np.empty((0, 6)))),
        "hydraulics": replace(whole, hydraulics=Series(np.empty(0), np.empty((0, 4)))),
    }
    names = {
        "gyro": ("gyro_bias", "gyro_sign", "imu_roll", "gyro_delay", "asymmetry", "turning_efficiency"),
        "fixes": ("effective_rolling_radius", "rolling_radius", "common_slip"),
        "hydraulics": ("left_pressure_offset",),
    }
    for sensor, part in parts.items():
        findings = calibrate([part], P, SOURCES).findings
        assert all(f"no {sensor} in the bags" in findings[name].reason for name in names[sensor]), sensor


def test_gyro_of_one_axis_shows_no_mounting() -> None:
    """An import of a single rate leaves the others at 0: no angle of exactly 0 follows from them."""
    whole = recorded(Drive(), 4)
    one_axis = replace(whole, gyro=Series(whole.gyro.t, whole.gyro.values * (0.0, 0.0, 1.0)))
    findings = calibrate([one_axis], P, SOURCES).findings
    for name in ("imu_roll", "imu_pitch"):
        assert not findings[name].has_value
        assert "one axis" in findings[name].reason
    assert findings["gyro_scale"].has_value


def test_radius_and_slip_are_separated_only_by_an_option() -> None:
    soft, hard = (calibrated(Drive(), 5, hard_ground) for hard_ground in (False, True))
    assert not soft.findings["rolling_radius"].has_value
    assert "hard-ground" in soft.findings["rolling_radius"].reason
    assert hard.findings["rolling_radius"].value == soft.findings["effective_rolling_radius"].value
    assert "common_slip" not in hard.findings
    assert "vehicle.kinematics.rolling_radius" not in soft.parameters[NODE]
    name = "vehicle.kinematics.rolling_radius"
    nodes = {node for node, values in hard.parameters.items() if name in values}
    assert nodes == {NODE, "soil_estimator", "box_localizer"}


def test_confirmed_parameters_are_not_written() -> None:
    """Only values whose interval excludes the present value are written, unless all are requested."""
    drive = Drive()
    only_new, everything_new = (
        calibrate([recorded(drive, 7)], P, SOURCES, hard_ground=True, everything=everything)
        for everything in (False, True)
    )
    for name, present in (
        ("gyro_sign", P.gyros()["imu/data_raw"].sign),
        ("gyro_scale", P.gyros()["imu/data_raw"].scale),
        ("rolling_radius", P.vehicle.kinematics.rolling_radius),
    ):
        assert (name in only_new.confirmed) == only_new.findings[name].contains(present)
    assert "gyro_sign" in only_new.confirmed
    assert "sources.imu_data_raw.sign" in everything_new.parameters[NODE]
    assert "sources.imu_data_raw.sign" not in only_new.parameters.get(NODE, {})
    assert everything_new.confirmed == ()
    assert "gyro_sign" in text(only_new).splitlines()[-1]


def test_bad_headings_and_gaps_have_no_effect() -> None:
    """One heading in forty is off by a quarter turn, others have a large variance, and the gyro has gaps."""
    drive = Drive()
    whole = recorded(drive, 6)
    poses = whole.poses.values.copy()
    poses[::40, 2] += math.pi / 2.0
    poses[20::50, 2], poses[20::50, 5] = 3.0, 1.0
    is_kept = (whole.gyro.t < 20.0) | (whole.gyro.t > 23.0)
    gyro = Series(whole.gyro.t[is_kept], whole.gyro.values[is_kept])
    damaged = replace(whole, poses=Series(whole.poses.t, poses), gyro=gyro)
    findings = calibrate([damaged], P, SOURCES).findings
    for name in ("gyro_scale", "pose_delay", "turning_efficiency"):
        assert findings[name].contains(TRUE[name](drive)), name
        assert half(findings[name]) < 4.0 * WIDEST[name], name


def test_oil_trapped_at_a_stop_does_not_bias_the_offset() -> None:
    """A stall that ends with closed spools leaves pressure in the lines throughout the standstill."""
    drive = Drive(legs=(*DRIVE, STRAIGHT, (3.0, 0.0, 0.0)))
    whole = recorded(drive, 11)
    values = whole.hydraulics.values.copy()
    values[whole.hydraulics.t > whole.hydraulics.t[-1] - 3.0, :2] += (4.0e6, -4.0e6)
    findings = calibrate([replace(whole, hydraulics=Series(whole.hydraulics.t, values))], P, SOURCES).findings
    for name in ("left_pressure_offset", "right_pressure_offset"):
        assert findings[name].contains(TRUE[name](drive)), name
        assert half(findings[name]) < WIDEST[name], name


def test_more_bags_narrow_the_intervals() -> None:
    recordings = [recorded(Drive(), seed) for seed in range(4)]
    of_all, of_one = (calibrate(r, P, SOURCES).findings for r in (recordings, recordings[:1]))
    for name in ("gyro_scale", "effective_rolling_radius", "left_pressure_offset"):
        assert half(of_all[name]) < 0.8 * half(of_one[name])


@given(
    value=st.floats(-1e6, 1e6),
    half=st.floats(1e-9, 1e6),
)
def test_a_value_is_rounded_to_its_interval(value: float, half: float) -> None:
    finding = make_finding(value, half, "m", "")
    assert finding.rounded_value is not None
    assert abs(finding.rounded_value - value) <= 0.051 * half + 1e-9 * abs(value)
    digits = half * 10.0**finding.decimals
    assert 9.0 <= digits <= 101.0  # two significant digits


def test_the_parameter_file_is_one_that_the_nodes_load(tmp_path: Path) -> None:
    drive = Drive(scale=-0.985)
    calibration = calibrated(drive, 7, hard_ground=True)
    path = tmp_path / "calibration.yaml"
    write_parameters(path, calibration, ["one", "two"])
    tree = read_yaml(path)
    p = load_slip_parameters(node_parameters(tree, NODE, str(path)))
    assert p.vehicle.kinematics.rolling_radius == calibration.findings["rolling_radius"].rounded_value
    gyro = p.gyros()["imu/data_raw"]
    assert gyro.sign == -1
    assert gyro.scale == pytest.approx(0.985, abs=0.02)
    assert p.turning.initial_efficiency == pytest.approx(drive.efficiency, abs=0.02)
    assert tree["watson_imu"]["ros__parameters"]["time_offset"] == pytest.approx(-drive.gyro_late, abs=0.03)
    late = drive.gyro_late + drive.pose_late
    assert tree["sick_pls"]["ros__parameters"]["time_offset"] == pytest.approx(-late, abs=0.06)
    evidence = path.read_text(encoding="utf-8")
    assert all(f"# {line}" in evidence for line in text(calibration).splitlines())
    assert "# from one" in evidence
    assert summary(calibration, ["one"])["findings"]["tread"]["value"] is None


def test_name_of_a_bag_with_a_line_break_stays_in_the_comment_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    write_parameters(path, calibrated(Drive(), 7), ["one\nslip_estimator: 3"])
    assert node_parameters(read_yaml(path), NODE, str(path))


def test_a_scaled_gyro_is_read_in_true_units() -> None:
    estimator = SlipEstimator(
        load_slip_parameters({"sources.imu_data_raw.sign": -1, "sources.imu_data_raw.scale": 0.5})
    )
    records = to_records([YawRate("imu/data_raw", 1, 0.2, 4e-6)], estimator.sources)
    o = observe(np.zeros(1, STATE)[0], records[0], estimator.config[0])
    assert (o.innovation[0], o.noise[0, 0]) == (pytest.approx(-0.4), pytest.approx(16e-6))


def test_jackknife_accounts_for_correlated_errors() -> None:
    """Thirty clusters of twenty equal errors count as thirty errors, not as six hundred."""
    rng = np.random.default_rng(8)
    clusters = np.repeat(np.arange(30), 20)
    X, hits = np.ones((600, 1)), 0
    for _ in range(200):
        fit = fit_clustered(X, rng.normal(0.0, 1.0, 30)[clusters] + rng.normal(0.0, 0.1, 600), clusters)
        assert fit is not None
        hits += abs(fit.values[0]) <= fit.half_width()
    assert 180 <= hits <= 199


@pytest.mark.slow
def test_increments_separate_walk_and_reading_noise() -> None:
    """The interval of a slope is correct under a random walk and a reading noise stated twice as large."""
    rng = np.random.default_rng(9)
    hits, spreads, slopes = 0, [], []
    for _ in range(100):
        x = np.cumsum(rng.uniform(0.0, 1.0, 80))
        y = 2.0 * x + np.cumsum(rng.normal(0.0, 0.05, 80)) + rng.normal(0.0, 0.5, 80)
        ones = np.ones(79)
        joined = np.arange(79) > 0
        fit = fit_increments(np.diff(x)[:, np.newaxis], Increments(np.diff(y), ones, ones, ones, joined))
        assert fit is not None
        hits += abs(fit.values[0] - 2.0) <= fit.half_width()
        spreads.append(fit.half_width())
        slopes.append(fit.values[0])
    assert hits >= 88
    assert np.mean(spreads) < 3.0 * np.std(slopes)


def test_positions_without_an_orientation_are_used_with_an_unknown_heading():
    rows = np.zeros(2, dtype_of(PoseFields))
    rows["qw"], rows["x"], rows["covariance"] = (0.0, 1.0), 5.0, np.eye(3) * 1e-4
    poses = recording._poses(rows)
    assert poses[:, (0, 2)].tolist() == [[5.0, 0.0], [5.0, 0.0]]
    assert poses[0, 5] > 1e6
    assert poses[1, 5] == pytest.approx(1e-4)
