# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What every study varies and holds (``config/study.yaml``)."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class GridParameters(Parameters):
    """The part of the grid and of the sensors that all studies have."""

    soils: tuple[str, ...] = parameter("names in config/soils.yaml")
    terrains: tuple[str, ...] = parameter("names in config/terrains, or files; empty: the scenario's own")
    sigma_xy: tuple[float, ...] = parameter("noise of the fixes, x and y", unit="m", gt=0.0, le=100.0)
    sigma_heading: float = parameter("noise of the fixes' heading", unit="rad", gt=0.0, le=3.0)
    seeds: int = parameter("runs of each cell", ge=1, le=100_000)
    sprocket_rate: float = parameter("sprocket samples", unit="Hz", ge=1.0, le=1000.0)
    gyro_rate: float = parameter("yaw rates", unit="Hz", ge=1.0, le=1000.0)
    fix_rate: float = parameter("poses", unit="Hz", ge=1.0, le=1000.0)
