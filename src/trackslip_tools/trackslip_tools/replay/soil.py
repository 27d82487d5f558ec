# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the soil estimator over a replay; its inputs are the replayed slips and the hydraulics of the bag."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trackslip_bags.messages import make
from trackslip_bags.tables import TopicTable
from trackslip_common.arrays import FloatArray, IntArray, Rows
from trackslip_common.message_fields import ForceFields, SoilFields
from trackslip_common.message_reading import dtype_of, read
from trackslip_common.tally import Tally
from trackslip_common.topics import FORCES, SOIL, TRUE_FORCES, TRUE_SOIL
from trackslip_estimation.soil import conversions
from trackslip_estimation.soil.records import FORCES as FORCES_RECORD
from trackslip_estimation.soil.records import (
    HYDRAULICS,
    IS_HYDRAULICS,
    SOIL_INPUT,
    SlipSeed,
    inputs_from_estimates,
)
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilOutput, SoilOutputs, SoilState
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.replay.comparable import Comparability
from trackslip_tools.replay.filtering import Withholding
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.inputs import LoggedMessages
from trackslip_tools.replay.series import Series, SeriesCollector

SOIL_TOPICS = (HYDRAULICS, FORCES, SOIL, TRUE_FORCES, TRUE_SOIL)  # read by a replay; truths only counted
_END_NS = int(np.iinfo(np.int64).max)
_TOLERANCE = 1e-9  # relative difference allowed between a live and a replayed number


class SoilComparison(NamedTuple):
    """Comparison of live and replayed forces and soils, over the stamps of both."""

    compared: int
    unmatched: int
    largest_difference: float  # relative

    @property
    def matches(self) -> bool:
        """Whether both have the same stamps and the same numbers."""
        return self.compared > 0 and self.unmatched == 0 and self.largest_difference <= _TOLERANCE

    def __str__(self) -> str:
        verdict = "yes" if self.matches else "NO"
        numbers = f"{self.compared} messages, {self.unmatched} unmatched"
        return f"soil: replay = live: {verdict} ({numbers}, largest difference {self.largest_difference:.1e})"


@dataclass
class SoilReplay:
    """Outputs of the soil estimator in a replay."""

    parameters: SoilEstimatorParameters
    forces: Rows = field(default_factory=lambda: np.empty(0, FORCES_RECORD))  # (n,)
    states: list[SoilState] = field(default_factory=list)
    seeds: list[SlipSeed] = field(default_factory=list)
    rejected: Tally = field(default_factory=Tally)
    live: SoilComparison | None = None

    @property
    def outputs(self) -> list[SoilOutput]:
        """All published outputs, by stamp."""
        return SoilOutputs(self.forces, self.states, self.seeds).in_order()


class SoilRun:
    """Soil estimator over a replay, in pieces; ``compares``: whether outputs are compared with live ones."""

    def __init__(self, p: SoilEstimatorParameters, withholding: Withholding, *, compares: bool) -> None:
        self._estimator, self._withholding, self._compares = SoilEstimator(p), withholding, compares
        self._waiting, self._logged_ns = np.empty(0, SOIL_INPUT), np.empty(0, np.int64)  # readings
        self._published_ns = 0  # largest log time of an estimate so far
        self._forces = GrowingRows(FORCES_RECORD)
        self._states: list[SoilState] = []
        self._seeds: list[SlipSeed] = []
        self._live, self._live_classes = SeriesCollector(), dict[int, FloatArray]()

    def add(self, estimates: Rows, logged_ns: IntArray, tables: dict[str, LoggedMessages]) -> None:
        """Add (n,) ESTIMATE, the log times of their sprocket samples, and tables of the bag.

        Readings in a later piece were logged after the estimates of this one.
        """
        for topic, logged in tables.items():
            if topic == HYDRAULICS:
                self._queue_readings(logged)
            elif topic in (FORCES, SOIL):
                self._live.add(topic, logged.rows)
            if topic == SOIL:
                self._live_classes |= _class_probabilities(logged.table)
        if len(estimates):
            self._advance(estimates, logged_ns)

    def result(self, comparability: Comparability) -> SoilReplay:
        """Outputs of the whole bag; compared with live ones only where the slips can be compared."""
        self._process_inputs(self._waiting)
        result = SoilReplay(
            self._estimator.parameters,
            self._forces.rows(),
            self._states,
            self._seeds,
            self._estimator.tally,
        )
        can_compare, until_ns = comparability.comparable_start()
        live = self._live.series()
        if self._compares and live and can_compare:
            last_ns = _END_NS if until_ns is None else until_ns
            result.live = _compare_with_live(result, live, self._live_classes, last_ns)
        return result

    def _queue_readings(self, logged: LoggedMessages) -> None:
        """Queue the readings of hydraulics that are not withheld."""
        is_hidden = self._withholding.hides(HYDRAULICS, logged.log_times_ns)
        self._waiting = np.concatenate((self._waiting, _reading_inputs(logged.rows[~is_hidden])))
        self._logged_ns = np.concatenate((self._logged_ns, logged.log_times_ns[~is_hidden]))

    def _advance(self, estimates: Rows, logged_ns: IntArray) -> None:
        """Feed both in live order: a reading precedes the first estimate published after it."""
        published_ns = np.maximum.accumulate(np.maximum(logged_ns, self._published_ns))
        self._published_ns = int(published_ns[-1])
        before = np.searchsorted(published_ns, np.maximum.accumulate(self._logged_ns))
        ready = int(np.searchsorted(before, len(estimates)))
        inputs = np.insert(inputs_from_estimates(estimates), before[:ready], self._waiting[:ready])
        self._waiting, self._logged_ns = self._waiting[ready:], self._logged_ns[ready:]
        self._process_inputs(inputs)

    def _process_inputs(self, inputs: Rows) -> None:
        for outputs in self._estimator.advance_all(inputs):
            self._forces.add(outputs.forces)
            self._states += outputs.states
            self._seeds += outputs.seeds


def _reading_inputs(rows: Rows) -> Rows:
    """(n,) SOIL_INPUT of (n,) records of ``HydraulicsFields``."""
    inputs = np.zeros(len(rows), SOIL_INPUT)
    inputs["source"], inputs["stamp_ns"] = IS_HYDRAULICS, rows["stamp_ns"]
    for k, side in enumerate(("left", "right")):
        inputs["pressures"][:, k], inputs["spools"][:, k] = rows[f"{side}_pressure"], rows[f"{side}_spool"]
    return inputs


def _class_probabilities(table: TopicTable) -> dict[int, FloatArray]:
    messages = map(table.message, range(len(table)))
    stamps_ns = table.rows(SoilFields)["stamp_ns"].tolist()
    return {t: np.asarray(m.class_probabilities) for t, m in zip(stamps_ns, messages, strict=True)}


def _compare_with_live(
    result: SoilReplay, live: dict[str, Series], live_classes: dict[int, FloatArray], until_ns: int
) -> SoilComparison:
    """Compare every live number with the replayed one; per topic, between first and last common stamps."""
    compared = unmatched = 0
    largest = 0.0
    for topic, replayed in ((FORCES, force_rows(result.forces)), (SOIL, soil_rows(result.states))):
        logged = live.get(topic)
        if logged is None or not len(logged) or not len(replayed):
            continue
        first = max(logged.stamps_ns[0], replayed["stamp_ns"][0])
        last = min(logged.stamps_ns[-1], replayed["stamp_ns"][-1], until_ns)
        live_rows = _rows_between_stamps(logged.rows, first, last)
        replayed_rows = _rows_between_stamps(replayed, first, last)
        _, in_live, in_replayed = np.intersect1d(
            live_rows["stamp_ns"], replayed_rows["stamp_ns"], return_indices=True
        )
        unmatched += len(live_rows) + len(replayed_rows) - 2 * len(in_replayed)
        compared += len(live_rows)
        for name in replayed.dtype.names or ():
            difference = _relative_difference(live_rows[name][in_live], replayed_rows[name][in_replayed])
            largest = max(largest, difference)
    replayed_classes = {
        s.stamp_ns: np.array(list(s.classes.values())) for s in result.states if s.stamp_ns <= until_ns
    }
    for stamp_ns in replayed_classes.keys() & live_classes.keys():
        difference = _relative_difference(live_classes[stamp_ns], replayed_classes[stamp_ns])
        largest = max(largest, difference)
    return SoilComparison(compared, unmatched, largest)


def force_rows(forces: Rows) -> Rows:
    """(n,) records of ``ForceFields``, with the values of messages."""
    rows = np.empty(len(forces), dtype_of(ForceFields))
    rows["stamp_ns"] = forces["stamp_ns"]
    for name, column in conversions.force_columns(forces).items():
        rows[name] = column
    return rows


def soil_rows(states: Iterable[SoilState]) -> Rows:
    """(n,) records of ``SoilFields``, with the values of messages."""
    messages = (conversions.soil_estimate(make, state, "") for state in states)
    return np.array([tuple(read(SoilFields, m)) for m in messages], dtype=dtype_of(SoilFields))


def _rows_between_stamps(rows: Rows, first_ns: int, last_ns: int) -> Rows:
    return rows[(first_ns <= rows["stamp_ns"]) & (rows["stamp_ns"] <= last_ns)]


def _relative_difference(a: FloatArray, b: FloatArray) -> float:
    """Largest relative difference; 0 of empty arrays, infinite where shapes or nans differ."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
        return float("inf")
    scale = np.maximum(np.abs(np.nan_to_num(a)), 1.0)
    return float(np.max(np.abs(np.nan_to_num(a - b)) / scale, initial=0.0))
