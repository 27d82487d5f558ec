# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the truth simulator (``config/truth.yaml``) and their reader."""

from dataclasses import dataclass

from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, from_flat, parameter


@dataclass(frozen=True, kw_only=True)
class TruthSettings(Parameters):
    """Settings of the truth; SI units. ``load_x``, ``load_y`` move the centre of gravity, not the inertia."""

    step: float = parameter("integration step", unit="s", gt=0.0, le=0.01)
    sample_period: float = parameter("time between recorded samples", unit="s", gt=0.0)
    elements: int = parameter("elements of each track's contact", ge=2)
    valve_time_constant: float = parameter("time constant of the spool's lag", unit="s", gt=0.0)
    drive_sag: float = parameter("track speed lost at relief pressure", unit="m/s", gt=0.0)
    track_mass: float = parameter("inertia of belt and motor as a mass at the track", unit="kg", gt=0.0)
    standby_pressure: float = parameter("supply pressure above the higher load", unit="Pa", ge=0.0)
    sliding_floor: float = parameter("sliding speed below which shear force goes to zero", unit="m/s", gt=0.0)
    rolling_floor: float = parameter("speed below which rolling resistance goes to zero", unit="m/s", gt=0.0)
    slip_floor: float = parameter("track speed below which slip is undefined", unit="m/s", gt=0.0)
    load_x: float = parameter("centre of gravity ahead of the contact centre", unit="m")
    load_y: float = parameter("centre of gravity left of the contact centre", unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        ratio = self.sample_period / self.step
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            raise InputError(
                f"TruthSettings.sample_period: {self.sample_period!r} s is refused;"
                f" accepted: a multiple of the step, {self.step!r} s"
            )

    @property
    def steps_per_sample(self) -> int:
        """Integration steps between two samples."""
        return round(self.sample_period / self.step)


def load_settings() -> TruthSettings:
    """The settings in ``config/truth.yaml``.

    Raises:
        InputError: the file or a value in it is refused.
    """
    return from_flat(TruthSettings, node_defaults("", "truth.yaml"), "truth.yaml", "truth.")
