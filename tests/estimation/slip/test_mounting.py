# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Mounting of IMUs: rotated, with missing data, and several of them."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trackslip_common.errors import InputError
from trackslip_common.make import header
from trackslip_common.nodes.messages import make
from trackslip_estimation.slip.conversions import yaw_rate
from trackslip_estimation.slip.measurements import YawRate
from trackslip_estimation.slip.mounting import rotate, rotate_variances, rotation
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.sources import Rejection, YawRateSource

S = 1_000_000_000
IMU = "sources.imu_data_raw."
ANGLES = st.floats(-math.pi, math.pi)


def vector(values: Any) -> Any:
    return make("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, values), strict=True)))


def imu_message(rates: Any, forces: Any, of_rates: Any = (0.0,) * 3, of_forces: Any = (0.0,) * 3) -> Any:
    return make(
        "sensor_msgs/msg/Imu",
        header=header(make, 5 * S, "imu_link"),
        angular_velocity=vector(rates),
        linear_acceleration=vector(forces),
        angular_velocity_covariance=np.diag(of_rates).ravel(),
        linear_acceleration_covariance=np.diag(of_forces).ravel(),
    )


def source(**changed: float) -> YawRateSource:
    p = load_slip_parameters({IMU + name: value for name, value in changed.items()})
    return p.gyros()["imu/data_raw"]


@given(ANGLES, ANGLES, ANGLES)
def test_the_rotation_is_that_of_its_three_angles(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    v, variances = (1.0, -2.0, 3.0), (0.1, 0.2, 0.3)
    found = rotate(rotation(roll, pitch, yaw), v)
    np.testing.assert_allclose(found, expected @ v, atol=1e-9)
    spread = rotate_variances(rotation(roll, pitch, yaw), variances)
    np.testing.assert_allclose(spread, np.diag(expected @ np.diag(variances) @ expected.T), atol=1e-9)


@given(ANGLES, ANGLES, ANGLES, st.integers(0, 2**32 - 1))
def test_columns_of_a_bag_turn_as_numbers_do(roll: float, pitch: float, yaw: float, seed: int) -> None:
    columns = np.random.default_rng(seed).normal(size=(3, 5))
    R = rotation(roll, pitch, yaw)
    one_by_one = [rotate(R, column.tolist()) for column in columns.T]
    np.testing.assert_array_equal(np.column_stack(rotate(R, list(columns))), one_by_one)


def test_an_axis_that_a_unit_lacks_does_not_spoil_the_others() -> None:
    """Half a turn about x must not mix x into z, although sin π is not exactly 0."""
    upside_down = rotation(math.pi, 0.0, 0.0)
    assert rotate(upside_down, (math.nan, math.nan, 0.3))[2] == -0.3
    assert rotation(0.0, 0.0, 0.0) is None


def test_a_message_is_turned_as_its_unit_is_mounted() -> None:
    """The x axis of the unit points up and measures the turn to the left."""
    stated = (1e-4, 2e-4, 3e-4)
    found = yaw_rate(
        imu_message((0.3, 0.1, -0.2), (9.8, 0.5, 0.0), stated, (0.03,) * 3),
        "imu/data_raw",
        source(mounting_pitch=-math.pi / 2.0),
    )
    assert isinstance(found, YawRate)
    assert (found.rate, found.variance) == (pytest.approx(0.3), pytest.approx(1e-4))
    assert found.tilt_rates == pytest.approx((0.2, 0.1))
    assert found.tilt_variances == pytest.approx((3e-4, 2e-4))
    assert found.acceleration == pytest.approx((0.0, 0.5, 9.8))
    assert found.acceleration_variance == pytest.approx(0.03)


def test_missing_variances_are_those_of_the_parameters() -> None:
    imu = source(stddev=0.01, acceleration_stddev=0.2)
    found = yaw_rate(imu_message((0.0, 0.0, 0.3), (0.0, 0.0, 9.8)), "imu/data_raw", imu)
    assert isinstance(found, YawRate)
    assert (found.variance, found.tilt_variances) == (1e-4, (1e-4, 1e-4))
    assert found.acceleration_variance == pytest.approx(0.04)


def test_imu_marked_without_gyro_is_refused() -> None:
    message = imu_message((0.0, 0.0, 0.0), (0.0, 0.0, 9.8), of_rates=(-1.0, 0.0, 0.0))
    assert yaw_rate(message, "imu/data_raw", source()) is Rejection.NO_RATE


def test_accelerations_marked_absent_are_unknown() -> None:
    message = imu_message((0.0, 0.0, 0.1), (0.0, 0.0, 0.0), of_forces=(-1.0, 0.0, 0.0))
    found = yaw_rate(message, "imu/data_raw", source())
    assert isinstance(found, YawRate)
    assert found.rate == 0.1
    assert np.isnan((*found.acceleration, found.acceleration_variance)).all()


@pytest.mark.parametrize("angle", ["mounting_roll", "mounting_pitch", "mounting_yaw"])
def test_degrees_are_refused(angle: str) -> None:
    with pytest.raises(InputError, match=f"{angle}: 180.0 is out of range; accepted: >= -6.2832 and <= 6.28"):
        source(**{angle: 180.0})
