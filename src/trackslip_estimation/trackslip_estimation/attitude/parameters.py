# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the attitude filter, for classes of gyros and accelerometers, not for one unit."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.parameter_record import fill_record
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, dtype_of
from trackslip_estimation.attitude.records import (
    BIAS_P,
    BIAS_Q,
    BIAS_X,
    BIAS_Y,
    HEIGHT,
    PITCH,
    ROLL,
    SIZE,
)

_INITIAL_TILT_STDDEV = 1.0  # rad, standard deviation before the first sample
_INITIAL_HEIGHT_STDDEV = 1e3  # m, standard deviation before the first altitude, where fixes have altitudes


@dataclass(frozen=True, kw_only=True)
class AttitudeParameters(Parameters):
    """Prior and noise of the IMU."""

    initial_gyro_bias_stddev: float = parameter(
        "standard deviation of the biases of roll and pitch rate at the start", unit="rad/s", gt=0.0
    )
    gyro_bias: float = parameter("random walk of both gyro biases", unit="rad/s/√s", ge=0.0)
    gyro_scale_stddev: float = parameter(
        "standard deviation of the scale of the gyro, about all axes", ge=0.0
    )
    accelerometer_bias_stddev: float = parameter(
        "standard deviation of the accelerometer biases, with the error of the mounting angles: 0.05 "
        "m/s² are 0.3° of tilt",
        unit="m/s²",
        gt=0.0,
    )
    accelerometer_bias: float = parameter("random walk of the accelerometer biases", unit="m/s²/√s", ge=0.0)
    noise_time: float = parameter("time over which the accelerometer noise is adapted", unit="s", gt=0.0)
    correlation_time: float = parameter(
        "correlation time of a shake; samples that follow each other faster are down-weighted",
        unit="s",
        ge=0.0,
    )
    ground_rate: float = parameter(
        "rate at which the ground tilts the machine while no gyro measures it", unit="rad/s", gt=0.0
    )
    mean_time: float = parameter("time constant of the mean specific force", unit="s", gt=0.0)
    lost: float = parameter("standard deviation at which roll or pitch counts as unknown", unit="rad", gt=0.0)
    outlier_nis: float = parameter("NIS beyond which a sample is down-weighted", gt=0.0)
    unknown_acceleration: float = parameter(
        "standard deviation of the acceleration of a machine whose tracks send nothing", unit="m/s²", gt=0.0
    )
    scale_time: float = parameter("correlation time of the scale error of the gyro", unit="s", gt=0.0)
    unknown_slope: float = parameter(
        "standard deviation of the ground's slope along each axis where no IMU measures the tilt", ge=0.0
    )
    unknown_slope_length: float = parameter(
        "correlation length of that slope along the path", unit="m", gt=0.0
    )


class AttitudeConstants(AttitudeParameters, Record):
    """The parameters, and constants computed from them, in compiled code."""

    initial: Annotated[FloatArray, SIZE]  # standard deviations
    walk: Annotated[FloatArray, SIZE]  # variance per s
    orientation_time: float  # s, correlation time of the error of an orientation
    gate: float  # χ² limit of orientations, two degrees of freedom


CONSTANTS = dtype_of(AttitudeConstants)


def constants(p: AttitudeParameters, *, measures_height: bool) -> Any:
    """A record of ``CONSTANTS``; the height is 0 at the start unless fixes measure it."""
    record = np.zeros(1, CONSTANTS)[0]
    fill_record(record, p)
    record["initial"][[ROLL, PITCH]] = _INITIAL_TILT_STDDEV
    record["initial"][HEIGHT] = _INITIAL_HEIGHT_STDDEV if measures_height else 0.0
    record["initial"][[BIAS_P, BIAS_Q]] = p.initial_gyro_bias_stddev
    record["initial"][[BIAS_X, BIAS_Y]] = p.accelerometer_bias_stddev
    record["walk"][[BIAS_P, BIAS_Q]] = p.gyro_bias**2
    record["walk"][[BIAS_X, BIAS_Y]] = p.accelerometer_bias**2
    return record
