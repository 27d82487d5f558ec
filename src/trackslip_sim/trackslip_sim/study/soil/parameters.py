# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Varied and fixed parameters of the soil study (``config/study.yaml``)."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from trackslip_common.config_files import load_parameters
from trackslip_common.parameters import parameter
from trackslip_common.soils import load_soils, soil
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.scenarios.terrains import load_terrain
from trackslip_sim.study.engine import GridParameters
from trackslip_sim.truth.ground import build_ground

NODE = "soil_study"


@dataclass(frozen=True, kw_only=True)
class SoilStudyParameters(GridParameters):
    """Parameters of the drives, their sensors, and the grid."""

    scenarios: tuple[str, ...] = parameter("names in config/scenarios, or files")
    duration: float = parameter("of each drive, repeated or cut; 0: unchanged", unit="s", ge=0.0, le=3600.0)
    standstill: float = parameter("standstill before each drive", unit="s", ge=1.0, le=600.0)
    drawn: bool = parameter("also machines drawn from the estimator's priors")
    fix_delay: float = parameter("delay until a pose arrives", unit="s", ge=0.0, le=10.0)
    offset_stddev: float = parameter("spread of a pressure transducer's offset", unit="Pa", ge=0.0)
    load_stddev: float = parameter("spread of a drawn machine's centre of gravity", unit="m", ge=0.0)


@dataclass(frozen=True)
class SoilCell:
    """One combination of the grid; it has one run per seed."""

    scenario: str
    soil: str  # at the start of the drive
    drawn: bool
    sigma_xy: float  # m
    terrain: str = ""  # empty: the scenario's own


def load_soil_study_parameters(values: dict[str, object]) -> SoilStudyParameters:
    """The defaults of ``config/``, replaced by ``values``.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    return load_parameters(SoilStudyParameters, NODE, ("study.yaml",), values)


def soil_cells(p: SoilStudyParameters) -> Iterator[SoilCell]:
    """The cells; the last factor varies fastest. A scenario with patches uses the soils it names.

    Raises:
        InputError: a scenario, terrain or soil is unknown, or the soil lacks a value that the truth needs.
    """
    machines = (False, True) if p.drawn else (False,)
    for name in p.scenarios:
        scenario = load_scenario(name)
        soils = (scenario.soil,) if scenario.patches else p.soils
        for base in soils:
            build_ground(soil(base), scenario.patches, load_soils())  # refused here, not in the first run
        for terrain in p.terrains:
            if terrain:
                load_terrain(terrain)
            for combination in product(soils, machines, p.sigma_xy):
                yield SoilCell(name, *combination, terrain)
