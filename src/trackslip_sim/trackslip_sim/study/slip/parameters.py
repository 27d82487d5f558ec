# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Varied and fixed parameters of the slip study (``config/study.yaml``), and one cell of its grid."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_common.parameters import parameter
from trackslip_sim.study.engine import GridParameters

NODE = "study"
SHEAR, MATCHED, DRAWN = "shear", "matched", "drawn"
TRUTHS = (SHEAR, MATCHED, DRAWN)
FILTERS = ("ekf", "daf")
_MIN_SCORED_TIME = 1.0  # s


@dataclass(frozen=True, kw_only=True)
class StudyParameters(GridParameters):
    """Parameters of the drive, its sensors, and the grid."""

    scenario: str = parameter("name in config/scenarios, or a file")
    duration: float = parameter("of the drive, the scenario repeated or cut", unit="s", gt=1.0, le=3600.0)
    settling: float = parameter("time at the start that is not scored", unit="s", ge=0.0)
    truths: tuple[str, ...] = parameter("models of the truth", choices=TRUTHS)
    filters: tuple[str, ...] = parameter("filters to evaluate", choices=FILTERS)
    swing_rate: float = parameter(
        "samples of a swing encoder, if sensors are on the upper structure", unit="Hz", ge=1.0, le=1000.0
    )
    sigma_omega: tuple[float, ...] = parameter("noise of the gyro", unit="rad/s", gt=0.0, le=100.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.settling > self.duration - _MIN_SCORED_TIME:
            accepted = f"up to {_MIN_SCORED_TIME:g} s less than the duration, {self.duration:g} s"
            raise InputError(f"{NODE}: settling: {self.settling:g} s is refused; accepted: {accepted}")
        if any(self.terrains) and DRAWN in self.truths:
            raise InputError(f"{NODE}: terrains: not with truth {DRAWN}, whose drives are on level ground")


@dataclass(frozen=True)
class Cell:
    """One combination of the grid; it has one run per seed."""

    truth: str
    soil: str
    filter: str
    sigma_xy: float  # m
    sigma_omega: float  # rad/s
    terrain: str = ""  # empty: the scenario's own


def load_study_parameters(values: dict[str, object]) -> StudyParameters:
    """The defaults of ``config/``, replaced by ``values``.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    return load_parameters(StudyParameters, NODE, ("study.yaml",), values)


def cells(p: StudyParameters) -> Iterator[Cell]:
    """The cells of the grid; the last factor varies fastest."""
    for combination in product(p.terrains, p.truths, p.soils, p.filters, p.sigma_omega, p.sigma_xy):
        terrain, truth, soil, filter_, sigma_omega, sigma_xy = combination
        yield Cell(truth, soil, filter_, sigma_xy, sigma_omega, terrain)
