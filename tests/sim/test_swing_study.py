# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Cells of the study with all sensors on a swinging cab: measurements, bound, and scores."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fixtures.commands import json_of
from fixtures.study_bench import Sensor, assert_same_bound, expected_bound, make_bench

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.config import ConfigRecord, make_config
from trackslip_estimation.slip.models.dispatch import twist
from trackslip_estimation.slip.models.model import (
    GYRO_BIAS,
    GYRO_SCALE,
    SENSOR_ERRORS,
    SWING,
    SWING_RATE,
    YAW,
)
from trackslip_estimation.slip.models.model import POSE as OF_POSE
from trackslip_estimation.slip.motion import Motion, Speeds
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import MEASUREMENT, ON_SWING, POSE, STATE, YAW_RATE
from trackslip_sim.machine.placement import upper_poses
from trackslip_sim.study.slip.kernels import Rows, cramer_rao_bound
from trackslip_sim.study.slip.parameters import SHEAR, Cell, StudyParameters, load_study_parameters
from trackslip_sim.study.slip.study import SlipStudy
from trackslip_sim.study.slip.trial import make_trial

CAB = {"vehicle": "pc05_cab"}
PERIOD = 0.02  # s
STDDEV = 0.002  # rad, of the encoder
CELL = Cell(SHEAR, "sand", "ekf", 0.02, 0.01)
COMMAND = ["study", "--scenario", "dig_cycles", "--vehicle", "pc05_cab", "--soil", "sand", "--workers", "1"]


@pytest.fixture(scope="module")
def p() -> StudyParameters:
    """A drive of 24 s, then two slews, and 14 s of driving back."""
    return load_study_parameters({"scenario": "dig_cycles", "duration": 62.0, "settling": 24.0, "seeds": 4})


@pytest.fixture(scope="module")
def with_encoder() -> SlipEstimatorParameters:
    return load_slip_parameters(CAB)


@pytest.fixture(scope="module")
def without_encoder() -> SlipEstimatorParameters:
    return load_slip_parameters(CAB, {"swing_sources": [""]})


# Inputs of the filters


def test_fixes_and_gyro_are_those_of_the_cab(
    p: StudyParameters, with_encoder: SlipEstimatorParameters
) -> None:
    bench = make_bench(p, with_encoder)
    drive, trial = bench.drive, bench.trial(CELL)
    values, at = trial.rows.measurements["value"], drive.truth
    assert np.ptp(at.swing) > 3.0
    axis = np.array(with_encoder.vehicle.swing_axis)
    by_machine, by_cab = (_site(poses, axis) for poses in (trial.states[:, OF_POSE], drive.sensor_poses))
    np.testing.assert_allclose(by_machine, by_cab, atol=1e-9)  # both give the same position of the axis
    fixes = values[drive.is_fix] - drive.sensor_poses[drive.is_fix]
    assert np.std(fixes, axis=0) == pytest.approx((0.02, 0.02, p.sigma_heading), rel=0.15)
    heading_errors = values[drive.is_fix, 2] - at.yaw[drive.is_fix] - at.swing[drive.is_fix]
    assert np.abs(heading_errors).max() < 5.0 * p.sigma_heading
    rates = values[drive.is_rate, 0] - at.yaw_rate[drive.is_rate] - at.swing_rate[drive.is_rate]
    assert np.std(rates) == pytest.approx(0.01, rel=0.1)
    errors = values[drive.is_angle, 0] - at.swing[drive.is_angle]
    assert np.std(errors) == pytest.approx(STDDEV, rel=0.1)
    np.testing.assert_array_equal(trial.states[:, SWING], at.swing)
    np.testing.assert_array_equal(trial.states[:, SWING_RATE], at.swing_rate)


def _site(poses: FloatArray, point: FloatArray) -> FloatArray:
    """(k, 2) positions in the site frame of a point of the frames (k, 3)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses[:, :2] + np.stack((cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]), axis=1)


def test_start_angle_without_an_encoder_has_the_error_of_its_prior(
    p: StudyParameters, with_encoder: SlipEstimatorParameters, without_encoder: SlipEstimatorParameters
) -> None:
    short = load_study_parameters({"scenario": "dig_cycles", "duration": 8.0, "settling": 4.0})
    bare, equipped = (make_bench(short, estimator) for estimator in (without_encoder, with_encoder))
    assert not bare.drive.is_angle.any()
    assert equipped.drive.is_angle.sum() == round(8.0 * p.swing_rate)
    setting = bare.setting(CELL)
    trials = [make_trial(setting, seed) for seed in range(100)]
    errors = np.array([t.start[0][[YAW, SWING]] - t.start_state[[YAW, SWING]] for t in trials])
    assert np.std(errors[:, 1]) == pytest.approx(without_encoder.swing.initial_angle_stddev, rel=0.2)
    assert np.std(errors.sum(axis=1)) == pytest.approx(p.sigma_heading, rel=0.2)  # a fix measures the sum


# The bound


@pytest.mark.slow
def test_bound_of_n_encoder_readings_is_the_variance_of_their_mean(
    with_encoder: SlipEstimatorParameters,
) -> None:
    """The brake holds the cab without play: r/n for n readings of variance r."""
    n, config = 40, make_config(with_encoder)
    config["swing"]["held_density"] = 0.0
    rows = _rows(n, config, ON_SWING, np.diag((STDDEV**2, 0.0, 0.0)))
    start, P = config["prior_mean"][0].copy(), config["prior_covariance"][0].copy()
    P[SWING, SWING], P[SWING_RATE, SWING_RATE] = 1e6, 0.0
    bound = cramer_rao_bound(rows, np.tile(start, (n, 1)), start, P, config)[:, SWING, SWING]
    np.testing.assert_allclose(bound, STDDEV**2 / np.arange(1, n + 1), rtol=1e-6)


@pytest.mark.slow
def test_a_fix_above_bounds_the_sum_of_heading_and_swing(with_encoder: SlipEstimatorParameters) -> None:
    config, r = make_config(with_encoder), 1e-4
    config["stamp_errors"], config["heading_floor"], config["swing"]["held_density"] = 0.0, 0.0, 0.0
    rows = _rows(1, config, POSE, np.diag((1e6, 1e6, r)))
    rows.measurements["stamp_ns"] = 1  # before any motion
    start, P = config["prior_mean"][0].copy(), np.zeros_like(config["prior_covariance"][0])
    of_yaw, of_swing = P[YAW, YAW], P[SWING, SWING] = 9e-4, 4e-4
    bound = cramer_rao_bound(rows, start[None], start, P, config)[0]
    total = of_yaw + of_swing + r
    assert bound[YAW, YAW] == pytest.approx(of_yaw - of_yaw**2 / total, rel=1e-4)
    assert bound[SWING, SWING] == pytest.approx(of_swing - of_swing**2 / total, rel=1e-4)
    assert bound[YAW, SWING] == pytest.approx(-of_yaw * of_swing / total, rel=1e-4)


def _rows(count: int, config: ConfigRecord, kind: int, noise: FloatArray) -> Rows:
    """Measurements of one kind from a sensor on the cab; the tracks count as driving at zero speed."""
    rows = Rows(np.zeros(count, MEASUREMENT), np.zeros(count, STATE))
    rows.measurements["stamp_ns"] = round(PERIOD * 1e9) * np.arange(1, count + 1)
    rows.measurements["kind"], rows.measurements["noise"] = kind, noise
    rows.measurements["source"] = np.flatnonzero(config["above"][0])[0]
    rows.drives["motion"]["motion"] = Motion.STRAIGHT
    return rows


def test_the_bound_of_a_slewing_cab_is_the_textbook_recursion(with_encoder: SlipEstimatorParameters) -> None:
    """The expected bound uses measurement functions defined in this file."""
    config = make_config(with_encoder)
    noises = {POSE: (4e-4, 4e-4, 1e-4), YAW_RATE: (1e-4,), ON_SWING: (4e-6,)}
    config["stamp_errors"], count = 0.0, 30
    rows = Rows(np.zeros(count, MEASUREMENT), np.zeros(count, STATE))
    rows.measurements["stamp_ns"] = round(PERIOD * 1e9) * np.arange(1, count + 1)
    rows.measurements["kind"] = kinds = np.resize([ON_SWING, YAW_RATE, POSE], count)
    box, imu = (list(with_encoder.timeouts_ns()).index(topic) for topic in ("box_pose", "imu/data_raw"))
    rows.measurements["source"] = np.where(kinds == YAW_RATE, imu, box)
    for kind, noise in noises.items():
        rows.measurements["noise"][kinds == kind] = np.diag(np.resize((*noise, 0.0, 0.0), 3))
    rows.drives["speeds"] = Speeds(1.6, 1.2)
    rows.drives["motion"]["motion"] = Motion.TURNING
    x, P = config["prior_mean"][0].copy(), config["prior_covariance"][0].copy()
    x[OF_POSE], x[SWING], x[SWING_RATE] = (1.0, 2.0, 0.5), 0.8, 0.3
    P[OF_POSE, OF_POSE] = np.diag(noises[POSE])
    P[SWING, SWING], P[SWING_RATE, SWING_RATE] = 0.01, 0.01
    spare = np.flatnonzero(np.diag(P) == 0.0)
    P[spare, spare] = 1e-4
    sensors = {kind: _sensor(kind, with_encoder, config) for kind in noises}
    states, expected = expected_bound(rows, x, P, config, sensors)
    assert_same_bound(cramer_rao_bound(rows, states, x, P, config)[-1], expected, 1e-4)
    assert expected[SENSOR_ERRORS, SENSOR_ERRORS] == pytest.approx(1e-4)  # unobserved: unchanged


def _sensor(kind: int, p: SlipEstimatorParameters, config: ConfigRecord) -> Sensor:
    """Measurement function h of a sensor on the cab; the angles of the box have an offset."""
    offset = int(config["yaw_offsets"][0, list(p.timeouts_ns()).index("box_pose")])

    def measure(x: FloatArray) -> FloatArray:
        if kind == ON_SWING:
            return x[SWING : SWING + 1] + x[offset]
        if kind == YAW_RATE:
            rate = twist(x, 1.6, 1.2, config[0])[2] + x[SWING_RATE]
            return np.array(((1.0 + x[GYRO_SCALE]) * rate + x[GYRO_BIAS],))
        pose = upper_poses(x[None, OF_POSE], x[SWING : SWING + 1], p.vehicle.swing_axis)[0]
        return pose + np.array((0.0, 0.0, x[offset]))

    return measure


# Scores of filters


@pytest.mark.slow
@pytest.mark.parametrize("encoder", [True, False])
def test_a_filter_on_the_cab_is_near_its_bound(
    encoder: bool,
    p: StudyParameters,
    with_encoder: SlipEstimatorParameters,
    without_encoder: SlipEstimatorParameters,
) -> None:
    estimator = with_encoder if encoder else without_encoder
    row = make_bench(p, estimator).row(CELL)
    assert row.swing_rmse is not None
    assert row.swing_bound is not None
    assert 1.5 < row.nees_pose < 4.5
    for rmse, bound in (
        (row.position_rmse, row.position_bound),
        (row.heading_rmse, row.heading_bound),
        (row.swing_rmse, row.swing_bound),
    ):
        assert 0.7 < rmse / bound < 1.4
    assert (row.swing_bound < 3.0 * STDDEV) == encoder


@pytest.mark.slow
def test_cells_without_a_cab_have_no_swing() -> None:
    short = load_study_parameters({"scenario": "slalom", "duration": 9.0, "settling": 6.0, "seeds": 1})
    row = make_bench(short, load_slip_parameters()).row(CELL)
    assert (row.swing_rmse, row.swing_bound) == (None, None)
    assert "swing" not in SlipStudy({}, []).markdown([row])


# The command


def test_study_swings_the_upper_structure_of_its_vehicle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--duration", "27", "--settling", "20", "--seeds", "1", "--filter", "ekf"]
    options += ["--sigma-xy", "0.02"]
    command = [*COMMAND, *options, "--cache", str(tmp_path / "cells.jsonl")]
    (row,) = json_of(tmp_path, *command)
    assert (row["truth"], row["scenario"]) == (SHEAR, "dig_cycles")
    assert 0.0 < row["swing_bound"] < 0.02  # rad, prior error of the encoder's offset
    output = capsys.readouterr().out
    assert output.startswith("vehicle: pc05_cab\n")
    assert "swing mrad" in output
    assert json_of(tmp_path, *command) == [row]  # the cache keeps the swing


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--truth", "matched"],
            "study: truths: 'matched' is refused with box_pose, imu/data_raw on the upper structure",
        ),
        (["--truth", "shear", "drawn"], "study: truths: 'drawn' is refused with box_pose"),
        (["--terrain", "hill"], "study: terrains: a terrain is refused with box_pose, imu/data_raw on"),
        (["--vehicle", "pc05"], "accepted: a vehicle with upper_structure.drive"),
    ],
)
def test_settings_impossible_for_a_cab_are_refused(
    options: list[str], message: str, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    assert message in refuse(*COMMAND, "--cache", tmp_path / "cells.jsonl", *options)
