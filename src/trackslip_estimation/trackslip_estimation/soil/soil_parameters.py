# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the soil estimator (defaults: ``config/soil_estimator.yaml``)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trackslip_common.config_files import load_parameters
from trackslip_common.parameter_record import record_of
from trackslip_common.parameters import Parameters, from_flat, parameter, to_flat
from trackslip_common.record_types import Record, Table
from trackslip_common.vehicle import Vehicle
from trackslip_common.vehicle_files import WithVehicle
from trackslip_estimation.soil.classes import ClassesParameters
from trackslip_estimation.soil.dynamics import DynamicsParameters
from trackslip_estimation.soil.flow_check import FlowParameters
from trackslip_estimation.soil.ground_load import LoadParameters
from trackslip_estimation.soil.interpolation import InterpolationParameters
from trackslip_estimation.soil.pressure_watch import WatchParameters
from trackslip_estimation.soil.slip_seed import SeedParameters
from trackslip_estimation.soil.stall import StallParameters
from trackslip_estimation.soil.strength_parameters import StrengthParameters
from trackslip_estimation.soil.thrust import ThrustParameters

NODE = "soil_estimator"
PARAMETERS = "soil_estimator/parameters"  # topic that carries them into bags
DEFAULT_FILES = ("soil_estimator.yaml",)


@dataclass(frozen=True, kw_only=True)
class SoilNumbers(Parameters):
    """Those that are numbers."""

    moments: InterpolationParameters
    thrust: ThrustParameters
    watch: WatchParameters
    stall: StallParameters
    load: LoadParameters
    dynamics: DynamicsParameters
    strength: StrengthParameters
    classes: ClassesParameters
    seed: SeedParameters
    flow: FlowParameters
    forces_period: float = parameter("between two messages on track_forces", unit="s", gt=0.0, le=10.0)
    soil_period: float = parameter("between two messages on soil", unit="s", gt=0.0, le=60.0)
    low_reserve: float = parameter(
        "share of F_max that a track should keep in reserve", ge=0.0, lt=1.0, read_only=False
    )
    high_slip: float = parameter("slip of a track that digs in", gt=0.0, le=1.0, read_only=False)
    stuck_probability: float = parameter(
        "of having less reserve, from which on a track has none", gt=0.0, lt=1.0, read_only=False
    )
    stuck_time: float = parameter(
        "without reserve and at high slip for so long, a track is getting stuck",
        unit="s",
        gt=0.0,
        read_only=False,
    )


@dataclass(frozen=True, kw_only=True)
class SoilEstimatorParameters(SoilNumbers, WithVehicle):
    """All parameters of the soil estimator."""

    base_frame: str = parameter("frame of the machine, at the track-contact centre")
    frame_prefix: str = parameter("before base_frame, such as 'one/' where there are several")

    @property
    def frame(self) -> str:
        """Of the messages."""
        return self.frame_prefix + self.base_frame

    def changed(self, values: Mapping[str, Any]) -> "SoilEstimatorParameters":
        """These parameters with other values; dotted names.

        Raises:
            InputError: a name is unknown or a value refused.
        """
        return from_flat(type(self), self.overlaid(to_flat(self), values), NODE)


class OfVehicle(Record):
    """What belongs to a machine."""

    vehicle: Vehicle


class SoilConfig(SoilNumbers, OfVehicle):
    """The parameters as compiled code takes them."""


def make_config(p: SoilEstimatorParameters) -> Table[SoilConfig]:
    """(1,) of the parameters.

    Raises:
        InputError: the vehicle has no mass or no hydraulics.
    """
    return record_of(SoilConfig, p)


def load_soil_parameters(*layers: Mapping[str, Any]) -> SoilEstimatorParameters:
    """The defaults of ``config/`` with layers of dotted names over them, the last one on top.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    return load_parameters(SoilEstimatorParameters, NODE, DEFAULT_FILES, *layers)
