# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of the attitude filter: classes of gyros and accelerometers, not those of one unit."""

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

_TILT = 1.0  # rad, before the first sample
_HEIGHT = 1e3  # m, on a map whose fixes have altitudes, before the first of them


@dataclass(frozen=True, kw_only=True)
class AttitudeParameters(Parameters):
    """What is known of the IMU beforehand."""

    initial_gyro_bias_stddev: float = parameter("of roll and pitch rate at the start", unit="rad/s", gt=0.0)
    gyro_bias: float = parameter("random walk of both", unit="rad/s/√s", ge=0.0)
    gyro_scale_stddev: float = parameter("of what the gyro shows of 1 rad/s, about all axes", ge=0.0)
    accelerometer_bias_stddev: float = parameter(
        "bias of the accelerometers, with what the mounting angles err by: 0.05 m/s² are 0.3° of tilt",
        unit="m/s²",
        gt=0.0,
    )
    accelerometer_bias: float = parameter("random walk of it", unit="m/s²/√s", ge=0.0)
    noise_time: float = parameter("over which the accelerometers' noise finds its size", unit="s", gt=0.0)
    correlation_time: float = parameter(
        "for which a shake lasts: samples that follow each other faster count for less", unit="s", ge=0.0
    )
    ground_rate: float = parameter(
        "how fast the ground tilts the machine while no gyro shows it", unit="rad/s", gt=0.0
    )
    mean_time: float = parameter("of the mean of the specific force", unit="s", gt=0.0)
    lost: float = parameter("deviation of a roll or pitch that is not known any more", unit="rad", gt=0.0)
    outlier_nis: float = parameter("NIS beyond which a sample counts for less", gt=0.0)
    unknown_acceleration: float = parameter("of a machine whose tracks send nothing", unit="m/s²", gt=0.0)
    scale_time: float = parameter("for which a gyro shows too much to one side", unit="s", gt=0.0)


class AttitudeConstants(AttitudeParameters, Record):
    """The parameters, and what follows of them, in compiled code."""

    initial: Annotated[FloatArray, SIZE]  # standard deviations
    walk: Annotated[FloatArray, SIZE]  # variance per s
    orientation_time: float  # s, for which an error of an orientation lasts
    gate: float  # χ² of two, of orientations


CONSTANTS = dtype_of(AttitudeConstants)


def constants(p: AttitudeParameters, *, measures_height: bool) -> Any:
    """A record of ``CONSTANTS``; the height is 0 at the start unless fixes measure it."""
    found = np.zeros(1, CONSTANTS)[0]
    fill_record(found, p)
    found["initial"][[ROLL, PITCH]], found["initial"][HEIGHT] = _TILT, _HEIGHT if measures_height else 0.0
    found["initial"][[BIAS_P, BIAS_Q]] = p.initial_gyro_bias_stddev
    found["initial"][[BIAS_X, BIAS_Y]] = p.accelerometer_bias_stddev
    found["walk"][[BIAS_P, BIAS_Q]] = p.gyro_bias**2
    found["walk"][[BIAS_X, BIAS_Y]] = p.accelerometer_bias**2
    return found
