# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A machine that turns better to one side: the gyro determines the heading."""

import math

import numpy as np
import pytest

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

S = 1_000_000_000
HZ = 20
LEARNS, SILENT = 15.0, 30.0  # s with fixes, s without
SWITCHES = 5.0  # s of turning to one side
RATE = 1.5  # rad/s, yaw rate of the tracks without slip
BETTER, WORSE = 0.85, 0.75  # κ to the left, and to the right


def uneven_drive(seed: int) -> tuple[list[Measurement], np.ndarray]:
    """Measurements of turns to both sides; true headings at the sprocket samples."""
    rng, p = np.random.default_rng(seed), load_slip_parameters()
    r, tread = p.vehicle.kinematics.rolling_radius, p.vehicle.kinematics.tread
    pose, headings, measurements = np.zeros(3), list[float](), list[Measurement]()
    for k in range(round((LEARNS + SILENT) * HZ)):
        t, stamp_ns = k / HZ, S + k * S // HZ
        side = 1.0 if math.floor(t / SWITCHES) % 2 == 0 else -1.0
        speed, apart = 0.3, side * RATE * tread
        rate = (BETTER if side > 0.0 else WORSE) * side * RATE
        jitter = rng.normal(0.0, 0.02, 2)
        left, right = (speed - apart / 2.0 + jitter[0]) / r, (speed + apart / 2.0 + jitter[1]) / r
        pose = pose + np.array((speed * math.cos(pose[2]), speed * math.sin(pose[2]), rate)) / HZ
        measurements += [
            Sprockets("sprockets", stamp_ns, left, right),
            YawRate("imu/data_raw", stamp_ns, rate + rng.normal(0.0, 0.005), 0.005**2),
        ]
        if k % HZ == 0 and t < LEARNS:
            fix = np.array((*(pose[:2] + rng.normal(0.0, 0.05, 2)), 0.0))
            measurements.append(PoseFix("box_pose", stamp_ns, fix, np.diag((0.05**2, 0.05**2, 100.0))))
        headings.append(pose[2])
    return measurements, np.array(headings)


@pytest.mark.parametrize(("seed", "filter_"), [(0, "ekf"), (1, "daf"), (2, "ekf")])
def test_asymmetric_turning_is_not_taken_for_a_gyro_bias(seed: int, filter_: str) -> None:
    """The heading stays within two standard deviations."""
    measurements, headings = uneven_drive(seed)
    changes = {"max_sprocket_speed": 10.0, "filter": filter_, "turning.initial_gyro_scale_stddev": 0.0}
    estimator = SlipEstimator(load_slip_parameters({"start": "initial_pose"}, changes))
    for m in measurements:
        estimator.process(m)
    last = estimator.estimate()
    error = math.remainder(last.pose[2] - headings[-1], 2.0 * math.pi)
    assert abs(error) < 2.0 * math.sqrt(last.pose_covariance[2, 2])
    assert abs(error) < 0.4
