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
from trackslip_common.vehicle_files import ParametersWithVehicle
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
    """The numeric parameters."""

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
    forces_period: float = parameter("period of the messages on track_forces", unit="s", gt=0.0, le=10.0)
    soil_period: float = parameter("period of the messages on soil", unit="s", gt=0.0, le=60.0)
    low_reserve: float = parameter(
        "share of F_max that a track should keep in reserve", ge=0.0, lt=1.0, read_only=False
    )
    high_slip: float = parameter("slip above which a track digs in", gt=0.0, le=1.0, read_only=False)
    stuck_probability: float = parameter(
        "probability of a reserve below low_reserve above which a track has none",
        gt=0.0,
        lt=1.0,
        read_only=False,
    )
    stuck_time: float = parameter(
        "time without reserve at high slip after which a track is getting stuck",
        unit="s",
        gt=0.0,
        read_only=False,
    )


@dataclass(frozen=True, kw_only=True)
class SoilEstimatorParameters(SoilNumbers, ParametersWithVehicle):
    """All parameters of the soil estimator."""

    base_frame: str = parameter("frame of the machine, at the track-contact centre")
    frame_prefix: str = parameter("prefix of base_frame, such as 'one/' if there are several machines")

    @property
    def frame(self) -> str:
        """Frame of the messages."""
        return self.frame_prefix + self.base_frame

    def changed(self, values: Mapping[str, Any]) -> "SoilEstimatorParameters":
        """Return these parameters with other values, by dotted names.

        Raises:
            InputError: a name is unknown or a value is rejected.
        """
        return from_flat(type(self), self.overlay(to_flat(self), values), NODE)


class VehicleField(Record):
    """Parameters of the vehicle."""

    vehicle: Vehicle


class SoilConfig(SoilNumbers, VehicleField):
    """Record of the parameters for compiled code."""


def make_config(p: SoilEstimatorParameters) -> Table[SoilConfig]:
    """Return the record (1,) of the parameters.

    Raises:
        InputError: the vehicle has no mass or no hydraulics.
    """
    return record_of(SoilConfig, p)


def load_soil_parameters(*layers: Mapping[str, Any]) -> SoilEstimatorParameters:
    """Return the defaults of ``config/``, overridden by layers of dotted names; the last layer has priority.

    Raises:
        InputError: a name is unknown or a value is rejected.
    """
    return load_parameters(SoilEstimatorParameters, NODE, DEFAULT_FILES, *layers)
