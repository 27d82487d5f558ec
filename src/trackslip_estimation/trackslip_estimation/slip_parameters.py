# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip estimator (defaults: ``config/slip_estimator.yaml`` and ``config/pc05.yaml``)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trackslip_common.config_files import node_defaults
from trackslip_common.parameters import Parameters, from_flat, parameter
from trackslip_estimation.filters.filter import Filter
from trackslip_estimation.filters.icr_model import IcrModel, IcrNoise
from trackslip_estimation.filters.model import Model
from trackslip_estimation.filters.slip_model import SlipModel, SlipNoise
from trackslip_estimation.filters.turning_model import TurningModel, TurningNoise
from trackslip_estimation.motion import MotionParameters
from trackslip_estimation.vehicle import Vehicle

NODE = "slip_estimator"
DEFAULT_FILES = ("pc05.yaml", "slip_estimator.yaml")


@dataclass(frozen=True, kw_only=True)
class SlipEstimatorParameters(Parameters):
    """Everything the slip estimator can be told."""

    vehicle: Vehicle
    motion: MotionParameters
    model: str = parameter(
        "motion model: sub-model 1b, its ICR form, or the thesis' (3.23)",
        choices=("turning", "icr", "free_slips"),
    )
    filter: str = parameter("extended Kalman filter, or the thesis' Fig. 4.3", choices=("ekf", "daf"))
    kappa: float = parameter("of the daf: scales the higher moments of its points", gt=-7.0, le=100.0)
    turning: TurningNoise
    icr: IcrNoise
    noise: SlipNoise
    odom_frame: str = parameter("site frame of the estimate and of the pose sources")
    base_frame: str = parameter("frame of the machine, at the track-contact centre")
    pose_sources: tuple[str, ...] = parameter("topics of PoseWithCovarianceStamped; '' names none")
    use_heading: bool = parameter("whether the heading of the pose sources is a measurement too")
    yaw_rate_sources: tuple[str, ...] = parameter(
        "topics of Imu whose z rate is a measurement; '' names none"
    )
    yaw_rate_stddev: float = parameter("where an Imu message gives no variance", unit="rad/s", gt=0.0)
    encoder_resolution: float = parameter("sprocket angle of one count", unit="rad", ge=0.0)
    start: str = parameter("what the estimate starts from", choices=("first_fix", "initial_pose"))
    initial_x: float = parameter("x at the start, with start: initial_pose", unit="m")
    initial_y: float = parameter("y at the start", unit="m")
    initial_yaw: float = parameter("heading at the start", unit="rad")
    initial_position_stddev: float = parameter("its standard deviation, x and y", unit="m", gt=0.0)
    initial_yaw_stddev: float = parameter("its standard deviation, heading", unit="rad", gt=0.0)
    history_window: float = parameter("how late a measurement may come", unit="s", gt=0.0, le=60.0)
    gate_probability: float = parameter("χ² probability inside which a measurement is taken", gt=0.0, lt=1.0)
    gate_patience: int = parameter("rejections in a row from one source after which it is believed", ge=1)


def load_slip_parameters(*layers: Mapping[str, Any], where: str = NODE) -> SlipEstimatorParameters:
    """The defaults of ``config/`` with layers of dotted names over them, the last one on top.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    values = node_defaults(NODE, *DEFAULT_FILES)
    for layer in layers:
        values |= layer
    return from_flat(SlipEstimatorParameters, values, where)


def make_filter(p: SlipEstimatorParameters) -> Filter:
    """The filter and the motion model that the parameters choose."""
    return Filter(make_model(p), p.kappa if p.filter == "daf" else None)


def make_model(p: SlipEstimatorParameters) -> Model:
    """The motion model that the parameters choose."""
    size = (p.vehicle.rolling_radius, p.vehicle.tread, p.encoder_resolution)
    if p.model == "free_slips":
        return SlipModel(*size, p.noise)
    return IcrModel(*size, p.icr) if p.model == "icr" else TurningModel(*size, p.turning)
