# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the runs of a cell: medians, worst values, and how many intervals contain the truth.

A consistent interval from 5 to 95 % contains the truth in nine of ten runs.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np

from trackslip_sim.study.soil.parameters import SoilCell
from trackslip_sim.study.soil.score import Interval, Result


@dataclass(frozen=True)
class SoilRow:
    """Results on one soil: errors relative to the truth, and counts of runs."""

    scenario: str
    soil: str
    drawn: bool
    sigma_xy: float  # m
    terrain: str  # empty: the scenario's own
    seeds: int
    F_max_error: float
    F_max_worst: float
    F_max_inside: int
    K_error: float
    K_worst: float
    K_inside: int
    K_ratio: float  # 95 % point over 5 % point
    identifiable: int
    class_probability: float  # of the true class
    mu_r_error: float
    mu_r_worst: float
    mu_r_inside: int
    M_r_error: float  # in steady turns
    M_r_worst: float
    M_r_inside: int  # in the last steady turn
    driving_thrust_error: float
    driving_thrust_worst: float
    braking_thrust_error: float
    braking_thrust_worst: float
    offset_residue: float  # Pa
    offset_residue_worst: float  # Pa


@dataclass(frozen=True)
class ChangeRow:
    """Results at one border between two soils."""

    scenario: str
    soil: str  # before
    into: str
    drawn: bool
    sigma_xy: float  # m
    terrain: str  # empty: the scenario's own
    seeds: int
    recognised: int  # number of runs
    recognised_after: float  # s; inf if more than half of the runs did not recognise it
    recognised_after_worst: float  # s
    wrong_before: float  # probability of all wrong classes at the border
    wrong_before_worst: float


AnyRow: TypeAlias = SoilRow | ChangeRow


def summary(cell: SoilCell, results: Sequence[Result]) -> AnyRow:
    """The row of a cell: a ``ChangeRow`` if a border was crossed, else a ``SoilRow``."""
    return _change_row(cell, results) if any(r.into for r in results) else _soil_row(cell, results)


def _soil_row(cell: SoilCell, results: Sequence[Result]) -> SoilRow:
    values: dict[str, Any] = {**asdict(cell), "seeds": len(results)}
    for name, field in (("F_max", "limit"), ("K", "modulus"), ("mu_r", "mu_r")):
        ratios = [abs(getattr(r, field) - 1.0) for r in results]  # relative to the truth
        values[f"{name}_error"], values[f"{name}_worst"] = _median_and_worst(ratios)
        values[f"{name}_inside"] = _count_inside(getattr(r, f"{field}_interval") for r in results)
    for name, field in (("M_r", "moment"), ("driving_thrust", "driving"), ("braking_thrust", "braking")):
        errors = [getattr(r, f"{field}_error") for r in results]
        values[f"{name}_error"], values[f"{name}_worst"] = _median_and_worst(errors)
    residue, worst = _median_and_worst(r.offset_residue for r in results)
    return SoilRow(
        **values,
        M_r_inside=_count_inside(r.moment_interval for r in results),
        K_ratio=float(np.median([r.modulus_interval[1] / r.modulus_interval[0] for r in results])),
        identifiable=sum(r.identifiable for r in results),
        class_probability=float(np.median([r.probability for r in results])),
        offset_residue=residue,
        offset_residue_worst=worst,
    )


def _change_row(cell: SoilCell, results: Sequence[Result]) -> ChangeRow:
    after, after_worst = _median_and_worst(r.recognised_after for r in results)
    wrong, wrong_worst = _median_and_worst(r.wrong_before for r in results)
    return ChangeRow(
        **asdict(cell),
        into=next(r.into for r in results if r.into),
        seeds=len(results),
        recognised=int(np.isfinite([r.recognised_after for r in results]).sum()),
        recognised_after=after,
        recognised_after_worst=after_worst,
        wrong_before=wrong,
        wrong_before_worst=wrong_worst,
    )


def _median_and_worst(values: Iterable[float]) -> tuple[float, float]:
    """Median and maximum without nan; nan if all values are nan."""
    defined = np.array([value for value in values if not np.isnan(value)])
    return (float(np.median(defined)), float(defined.max())) if defined.size else (float("nan"), float("nan"))


def _count_inside(intervals: Iterable[Interval]) -> int:
    """How many intervals contain the truth, 1."""
    return sum(low <= 1.0 <= high for low, high in intervals)
