# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One run of a report: a bag, the parameters of its replay, and the results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_common.arrays import BoolArray, Rows
from trackslip_common.topics import FORCES, SOIL
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.scoring import path_of
from trackslip_tools.replay.series import Path, sort_by_stamp
from trackslip_tools.replay.soil import force_rows, soil_rows
from trackslip_tools.report.details import Details
from trackslip_tools.report.recording import Numbers, Recording, make_numbers


@dataclass(frozen=True, eq=False)
class States:
    """Estimates by stamp, and their path."""

    rows: Rows  # (n,) ESTIMATE
    path: Path  # (n,) stamps and poses, with continuous heading

    @property
    def is_moving(self) -> BoolArray:
        """(n,) whether slips are defined: not at standstill."""
        return np.asarray(self.rows["motion"] != Motion.STANDING)


@dataclass(frozen=True, eq=False)
class Run:
    """Data of one replay for a report."""

    label: str
    recording: Recording
    parameters: SlipEstimatorParameters
    filters: InputFilters
    replay: Replay
    details: Details
    smoothed: Rows | None = None  # (n,) ESTIMATE of the smoother, if requested

    @cached_property
    def states(self) -> States | None:
        """States of the filter; None if nothing could start it."""
        estimates = sort_by_stamp(self.details.estimates)
        return States(estimates, path_of(estimates)) if len(estimates) else None

    @cached_property
    def smoothed_states(self) -> States | None:
        """States of the smoother; None if not requested, or if nothing could start it."""
        if self.smoothed is None or not len(self.smoothed):
            return None
        return States(self.smoothed, path_of(self.smoothed))

    @cached_property
    def numbers(self) -> dict[str, Numbers]:
        """Forces and soil by topic: of the replay if it computed them, else of the bag."""
        soil, start_ns = self.replay.soil, self.recording.zero_ns
        if soil is None:
            return self.recording.numbers
        replayed = {}
        forces = soil.forces[np.argsort(soil.forces["stamp_ns"], kind="stable")]
        states = sorted(soil.states, key=attrgetter("stamp_ns"))
        if len(forces):
            replayed[FORCES] = make_numbers(force_rows(forces), start_ns)
        if states:
            classes, reason = [state.classes for state in states], states[-1].strength.reason
            replayed[SOIL] = make_numbers(soil_rows(states), start_ns, classes, reason)
        return self.recording.numbers | replayed


def first_runs_of_bags(runs: Sequence[Run]) -> list[Run]:
    """The first run of each bag: contents of a bag are shown once."""
    first: dict[str, Run] = {}
    for run in runs:
        first.setdefault(run.recording.path, run)
    return list(first.values())


def align_runs(runs: Sequence[Run]) -> list[Run]:
    """Runs with times from the start of driving if they have several bags; unchanged for one bag."""
    if len(first_runs_of_bags(runs)) == 1:
        return list(runs)
    zeros = {run.recording.path: _start_of_driving_ns(run) for run in reversed(runs)}
    return [replace(run, recording=run.recording.with_origin(zeros[run.recording.path])) for run in runs]


def _start_of_driving_ns(run: Run) -> int:
    """Stamp of the first estimate that drives; without one, the origin of the recording."""
    if run.states is None:
        return run.recording.zero_ns
    is_driving = np.isin(run.states.rows["motion"], (Motion.STRAIGHT, Motion.TURNING))
    first = run.states.path.stamps_ns[is_driving][:1]
    return int(first[0]) if len(first) else run.recording.zero_ns
