# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip estimator (defaults: ``config/slip_estimator.yaml`` and ``config/pc05.yaml``)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError
from trackslip_common.parameters import flat_fields, from_flat, parameter, to_flat
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.adaptation import AdaptationParameters
from trackslip_estimation.slip.models.dispatch import ModelParameters
from trackslip_estimation.slip.motion import MotionParameters
from trackslip_estimation.slip.records import MOST_SOURCES
from trackslip_estimation.slip.sources import PoseSource, YawRateSource, each, named

FloatArray = NDArray[np.float64]

NODE = "slip_estimator"
DEFAULT_FILES = ("pc05.yaml", "slip_estimator.yaml")
_EACH = "one for each source, or one for all"


@dataclass(frozen=True, kw_only=True)
class SlipEstimatorParameters(ModelParameters):
    """Everything the slip estimator can be told."""

    vehicle: Vehicle
    motion: MotionParameters
    adaptation: AdaptationParameters
    filter: str = parameter("extended Kalman filter, or the thesis' Fig. 4.3", choices=("ekf", "daf"))
    kappa: float = parameter("of the daf: scales the higher moments of its points", gt=-7.0, le=100.0)
    odom_frame: str = parameter("site frame of the estimate and of the pose sources")
    base_frame: str = parameter("frame of the machine, at the track-contact centre")
    pose_sources: tuple[str, ...] = parameter("topics of PoseWithCovarianceStamped; '' names none")
    use_heading: bool = parameter("whether the heading of the pose sources is a measurement too")
    position_only: tuple[str, ...] = parameter("pose sources whose heading is none; '' names none")
    pose_lever_arms_x: tuple[float, ...] = parameter(f"place of its sensor in base_link; {_EACH}", unit="m")
    pose_lever_arms_y: tuple[float, ...] = parameter(f"place of its sensor in base_link; {_EACH}", unit="m")
    pose_position_floors: tuple[float, ...] = parameter(
        f"smallest standard deviation of x and y that is believed; {_EACH}", unit="m", gt=0.0
    )
    pose_heading_floors: tuple[float, ...] = parameter(
        f"smallest standard deviation of the heading that is believed; {_EACH}", unit="rad", gt=0.0
    )
    pose_heading_ceilings: tuple[float, ...] = parameter(
        f"standard deviation of a heading beyond which it is not used; {_EACH}", unit="rad", gt=0.0
    )
    pose_stamp_errors: tuple[float, ...] = parameter(
        f"standard deviation of a delay that all its stamps have, which is estimated; {_EACH}",
        unit="s",
        ge=0.0,
    )
    pose_timeouts: tuple[float, ...] = parameter(
        f"with nothing accepted for so long it counts as lost; {_EACH}",
        unit="s",
        ge=0.01,
        le=3600.0,
        read_only=False,
    )
    yaw_rate_sources: tuple[str, ...] = parameter(
        "topics of Imu whose z rate is a measurement; '' names none"
    )
    yaw_rate_signs: tuple[int, ...] = parameter(
        f"1, or -1 for a gyro that is upside down; {_EACH}", ge=-1, le=1
    )
    yaw_rate_scales: tuple[float, ...] = parameter(
        f"what it shows of 1 rad/s: its scale times the cosine of its tilt; {_EACH}", gt=0.0
    )
    yaw_rate_timeouts: tuple[float, ...] = parameter(
        f"as pose_timeouts, and its gate widens; {_EACH}", unit="s", ge=0.01, le=3600.0, read_only=False
    )
    yaw_rate_stddev: float = parameter("where an Imu message gives no variance", unit="rad/s", gt=0.0)
    slip_sources: tuple[str, ...] = parameter(
        "topics of TrackSlip that are measurements: [slip_seed], the soil estimator's, which rests on these "
        "very slips and so feeds back; '' names none"
    )
    slip_timeouts: tuple[float, ...] = parameter(
        f"as yaw_rate_timeouts; {_EACH}", unit="s", ge=0.01, le=86400.0, read_only=False
    )
    encoder_resolution: float = parameter("sprocket angle of one count", unit="rad", ge=0.0)
    start: str = parameter("what the estimate starts from", choices=("first_fix", "initial_pose"))
    initial_x: float = parameter("x at the start, with start: initial_pose", unit="m")
    initial_y: float = parameter("y at the start", unit="m")
    initial_yaw: float = parameter("heading at the start", unit="rad")
    initial_position_stddev: float = parameter("its standard deviation, x and y", unit="m", gt=0.0)
    initial_yaw_stddev: float = parameter(
        "its standard deviation, heading; beyond 1 rad it is unknown, and found from the first metres driven",
        unit="rad",
        gt=0.0,
    )
    history_window: float = parameter("how late a measurement may come", unit="s", gt=0.0, le=60.0)
    max_gap: float = parameter(
        "stamps further ahead of the sprockets must be confirmed; at least history_window", unit="s", le=600.0
    )
    jump_confirmations: int = parameter("sprocket samples in a row that make another time believed", ge=2)
    sprocket_timeout: float = parameter(
        "how long sprocket speeds are taken to go on; then the pose is held and its uncertainty grows",
        unit="s",
        gt=0.0,
    )
    max_sprocket_speed: float = parameter(
        "fastest a sprocket can turn; positions asking for more have jumped", unit="rad/s", gt=0.0
    )
    gate_probability: float = parameter(
        "χ² probability inside which a measurement is taken", gt=0.0, lt=1.0, read_only=False
    )
    gate_relaxation: float = parameter(
        "factor by which the gate of yaw rates or slips widens with each further timeout of its source",
        ge=1.0,
        le=1e3,
        read_only=False,
    )
    gate_confirmations: int = parameter(
        "measurements in a row that must agree with each other before what the gate refuses is believed", ge=1
    )
    state_file: str = parameter(
        "file that keeps what was learned until the next start; ~ is the home directory, '' for none"
    )
    publish_tf: bool = parameter("whether odom_frame → base_frame goes to /tf, where tf2_msgs is installed")

    def __post_init__(self) -> None:
        """Check also what belongs together.

        Raises:
            InputError: a value is refused, or two do not go together.
        """
        super().__post_init__()
        if self.max_gap < self.history_window:
            accepted = f"at least history_window, {self.history_window:g} s"
            raise InputError(f"{NODE}: max_gap: {self.max_gap:g} is out of range; accepted: {accepted}")
        if 0 in self.yaw_rate_signs:
            raise InputError(f"{NODE}: yaw_rate_signs: 0 is out of range; accepted: 1 or -1")
        for name in set(named(self.position_only)) - set(self.pose_sources):
            accepted = ", ".join(named(self.pose_sources)) or "none, there are no pose_sources"
            raise InputError(f"{NODE}: position_only: '{name}' is no pose source; accepted: {accepted}")
        if len(self.timeouts_ns()) >= MOST_SOURCES:
            raise InputError(
                f"{NODE}: {len(self.timeouts_ns())} sources; accepted: fewer than {MOST_SOURCES}"
            )

    def poses(self) -> dict[str, PoseSource]:
        """What each pose source is told.

        Raises:
            InputError: a list has neither one value nor as many as there are sources.
        """
        sources = named(self.pose_sources)
        columns = (
            [self.use_heading and name not in self.position_only for name in sources],
            zip(
                self._each("pose_lever_arms_x", self.pose_sources),
                self._each("pose_lever_arms_y", self.pose_sources),
                strict=True,
            ),
            self._each("pose_position_floors", self.pose_sources),
            self._each("pose_heading_floors", self.pose_sources),
            self._each("pose_heading_ceilings", self.pose_sources),
            (round(t * 1e9) for t in self._each("pose_timeouts", self.pose_sources)),
            self._each("pose_stamp_errors", self.pose_sources),
        )
        rows = zip(sources, *columns, strict=True)
        return {source: PoseSource(*row) for source, *row in rows}

    def gyros(self) -> dict[str, YawRateSource]:
        """What each yaw-rate source is told.

        Raises:
            InputError: a list has neither one value nor as many as there are sources.
        """
        signs = self._each("yaw_rate_signs", self.yaw_rate_sources)
        scales = self._each("yaw_rate_scales", self.yaw_rate_sources)
        timeouts = (round(t * 1e9) for t in self._each("yaw_rate_timeouts", self.yaw_rate_sources))
        rows = zip(named(self.yaw_rate_sources), signs, scales, timeouts, strict=True)
        return {source: YawRateSource(*row) for source, *row in rows}

    def timeouts_ns(self) -> dict[str, int]:
        """Of each source but the sprockets."""
        sources: dict[str, PoseSource | YawRateSource] = {**self.poses(), **self.gyros()}
        timeouts_ns = (round(t * 1e9) for t in self._each("slip_timeouts", self.slip_sources))
        slips = dict(zip(named(self.slip_sources), timeouts_ns, strict=True))
        return {name: source.timeout_ns for name, source in sources.items()} | slips

    def changed(self, values: Mapping[str, Any]) -> "SlipEstimatorParameters":
        """These parameters with other values; dotted names.

        Raises:
            InputError: a name is unknown or a value refused.
        """
        return from_flat(SlipEstimatorParameters, to_flat(self) | dict(values), NODE)

    def initial_pose(self) -> tuple[FloatArray, FloatArray]:
        """(3,) x, y, heading to start from, and (3, 3) covariance."""
        deviations = (self.initial_position_stddev, self.initial_position_stddev, self.initial_yaw_stddev)
        pose = np.array((self.initial_x, self.initial_y, self.initial_yaw))
        return pose, np.diag(np.square(deviations))

    def _each(self, name: str, sources: tuple[str, ...]) -> list[Any]:
        return each(f"{NODE}: {name}", getattr(self, name), sources)


def reloadable() -> frozenset[str]:
    """The parameters that may change while the estimator runs; dotted names."""
    return frozenset(name for name, _, spec in flat_fields(SlipEstimatorParameters) if not spec.read_only)


def load_slip_parameters(*layers: Mapping[str, Any], where: str = NODE) -> SlipEstimatorParameters:
    """The defaults of ``config/`` with layers of dotted names over them, the last one on top.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    values = node_defaults(NODE, *DEFAULT_FILES)
    for layer in layers:
        values |= layer
    return from_flat(SlipEstimatorParameters, values, where)
