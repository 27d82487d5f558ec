# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Soil estimator: forces, resistance coefficients and soil strength from machine states and pressures.

Live node and replay run this same class. Time is that of the stamps; no clock is read. The slip estimator
uses nothing of it, unless a user lists the slip seed, one after each turn, as a source.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from trackslip_common.record_types import Table, make_table
from trackslip_common.soils import load_soils
from trackslip_common.tally import Tally
from trackslip_estimation.soil import step
from trackslip_estimation.soil.classes import SoilClasses
from trackslip_estimation.soil.pressure_watch import PressureFault, UnusedReason, reported_faults
from trackslip_estimation.soil.records import (
    HYDRAULICS,
    SOIL_INPUT,
    ForcesRecord,
    SlipSeed,
    SoilInput,
    SoilInputRecord,
    TrackForces,
)
from trackslip_estimation.soil.slip_seed import make_seed, set_strength
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters, make_config
from trackslip_estimation.soil.strength_average import BROKEN, COMPLETE, LOST, clear_average
from trackslip_estimation.soil.strength_posterior import StrengthPosterior
from trackslip_estimation.soil.strength_summary import StrengthSummary


@dataclass(frozen=True, eq=False)
class SoilState:
    """Estimate of the soil."""

    stamp_ns: int
    mu_r: float
    mu_r_variance: float
    mu_l: float
    mu_l_variance: float
    strength: StrengthSummary
    classes: dict[str, float]  # probability of each class of soil, and of none of them


SoilOutput: TypeAlias = TrackForces | SoilState | SlipSeed


class SoilOutputs(NamedTuple):
    """Outputs to publish after some inputs."""

    forces: NDArray[np.void]  # (n,) of ``FORCES``
    states: Sequence[SoilState] = ()
    seeds: Sequence[SlipSeed] = ()

    def in_order(self) -> list[SoilOutput]:
        """Return all outputs, sorted by stamp."""
        outputs: list[SoilOutput] = [*self.states, *map(_to_track_forces, self.forces), *self.seeds]
        return sorted(outputs, key=attrgetter("stamp_ns"))


class SoilEstimator:
    """Estimates thrusts, resistance coefficients (sub-model 2) and the strength posterior, sample by sample.

    Raises:
        InputError: the vehicle has no mass or no hydraulics.
    """

    def __init__(self, p: SoilEstimatorParameters) -> None:
        self.restarts, vehicle = 0, p.vehicle.whole()
        self._posterior = StrengthPosterior(p.strength, vehicle)
        grid = self._posterior.grid
        self._classes = SoilClasses(p.classes, load_soils().values(), vehicle, grid)
        self._state = step.new_loop_state(p, grid.limits)
        self._one = make_table(SoilInputRecord, SOIL_INPUT, 1)
        self.set_parameters(p)

    def set_parameters(self, p: SoilEstimatorParameters) -> None:
        """Set new values of the parameters that may change while the estimator runs."""
        self.parameters = p
        self._config = make_config(p)

    @property
    def tally(self) -> Tally:
        """Numbers of unused inputs and pressures, by source and reason."""
        tally = Tally()
        faults = zip((*PressureFault, *UnusedReason), self._state.faults.tolist(), strict=True)
        fault_counts = [(HYDRAULICS, fault, count) for fault, count in faults]
        for source, reason, count in (*self._state.interpolator.counts(), *fault_counts):
            if count:
                tally.add(source, reason, count)
        return tally

    @property
    def faults(self) -> tuple[PressureFault, ...]:
        """Faults of the pressures that are reported at present."""
        return reported_faults(self._estimator["watch"])

    @property
    def strength(self) -> StrengthSummary:
        """Present K and F_max, and whether they are identifiable."""
        return self._posterior.summary()

    @property
    def volumetric_efficiency(self) -> float | None:
        """η_V from spools and speeds, for diagnostics; None while unknown."""
        efficiency = float(self._estimator["volumetric_efficiency"])
        return None if math.isnan(efficiency) else efficiency

    @property
    def stuck(self) -> tuple[bool, bool]:
        """Whether the left and the right track are getting stuck: spinning at the limit of the soil."""
        left, right = self._estimator["spinning"] >= self.parameters.stuck_time
        return bool(left), bool(right)

    @property
    def stalled(self) -> tuple[bool, bool]:
        """Whether the left and the right track are commanded and under pressure, but do not turn."""
        left, right = self._estimator["stalled"] >= self.parameters.stall.time
        return bool(left), bool(right)

    @property
    def _estimator(self) -> step.EstimatorState:
        return self._state.estimator[0]

    def advance(self, soil_input: SoilInput) -> list[SoilOutput]:
        """Process one input; return its outputs in the order of the stamps."""
        soil_input.write_to(self._one[0])
        return [output for outputs in self.advance_all(self._one) for output in outputs.in_order()]

    def advance_all(self, inputs: NDArray[np.void]) -> Iterator[SoilOutputs]:
        """Process (n,) of ``SOIL_INPUT`` in their order; yield the outputs in parts of bounded size."""
        table, reason, processed = cast("Table[SoilInputRecord]", inputs), step.OPEN, 0
        while reason != step.PROCESSED:
            reason, processed, count = step.advance(self._state, table, processed, self._config)
            if count:
                yield SoilOutputs(self._state.forces[:count].copy())
            if reason == step.OPEN:
                yield from self._finish_sample(self._estimator)
            elif reason in (step.RESTART, step.DIVERGED):
                self._restart()

    def _restart(self) -> None:
        """Reset all estimates, also the transducers' offsets: the elapsed time is unknown."""
        self._state.estimator[:] = step.initial_state(self.parameters)
        self._posterior.reset()
        self.restarts += 1

    def _finish_sample(self, estimator: step.EstimatorState) -> Iterator[SoilOutputs]:
        """Do what is not compiled: update the posterior; yield a seed and the soil state if due."""
        posterior, gathered = self._posterior, estimator["gathered"]
        if gathered == COMPLETE:
            posterior.update(estimator["average"])
            clear_average(estimator["average"])
            estimator["effective_samples"] = posterior.effective_samples
        elif gathered == BROKEN:
            posterior.break_segment()
        elif gathered == LOST:
            posterior.reset_displacement()
        nothing, p = self._state.forces[:0], self.parameters
        if estimator["seed_due"]:
            seed = make_seed(
                estimator["seeder"],
                estimator["sample"],
                estimator["thrust"],
                p.seed,
                p.vehicle.kinematics.contact_length,
            )
            yield SoilOutputs(nothing, seeds=[seed])
        if estimator["soil_due"]:
            state = self._soil_state(estimator)
            set_strength(estimator["seeder"], state.strength)
            self._state.limit_probabilities[:] = posterior.grid.limit_probabilities(posterior.cells)
            yield SoilOutputs(nothing, [state])

    def _soil_state(self, estimator: step.EstimatorState) -> SoilState:
        mu_r, mu_l = estimator["mu"].tolist()
        mu_r_variance, mu_l_variance = estimator["mu_variance"].tolist()
        classes = self._classes.probabilities(self._posterior.cells)
        stamp_ns = int(estimator["sample"]["stamp_ns"])
        return SoilState(stamp_ns, mu_r, mu_r_variance, mu_l, mu_l_variance, self.strength, classes)


def _to_track_forces(record: ForcesRecord) -> TrackForces:
    names = ("thrust", "thrust_variance", "resistance", "resistance_variance", "reserve")
    return TrackForces(int(record["stamp_ns"]), *(tuple(record[name].tolist()) for name in names))
