# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the slip estimator over the inputs of a bag in live order, part by part."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import Rows
from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.explanations import AcceptedEvent, CompetingExplanations
from trackslip_estimation.slip.learned import Learned, from_tree, learned_context
from trackslip_estimation.slip.learned_text import LearnedQuantity, learned_quantities
from trackslip_estimation.slip.measurements import Command
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import RESULT
from trackslip_tools.replay.arrivals import IS_COMMAND, IS_RELOAD, IS_START, to_measurements
from trackslip_tools.replay.inputs import InputStream, LoggedMessages

_PIECE_SIZE = 512  # arrivals between records of the learned quantities: seconds
_EXPLANATION_PERIOD_NS = 500_000_000  # between records of the explanations


class LearnedValues(NamedTuple):
    """Learned quantities of the machine and its ground at one time."""

    stamp_ns: int
    findings: list[LearnedQuantity]


class EstimatorStart(NamedTuple):
    """Parameters and learned quantities from which an estimator starts."""

    parameters: SlipEstimatorParameters
    learned: Learned | None


class Part(NamedTuple):
    """Inputs and results of some seconds of a bag."""

    sources: tuple[str, ...]
    arrivals: Rows  # (n,) ARRIVAL in live order
    results: Rows  # (n,) RESULT, one for each arrival
    tables: dict[str, LoggedMessages]  # tables of other topics, up to the same log time
    learned: list[LearnedValues]  # learned quantities within the part
    restart: EstimatorStart | None = None  # start of the estimator before this part, if it was started again
    accepted_events: Sequence[AcceptedEvent] = ()  # of the most probable branch, since the estimator's start
    explanations: Sequence[CompetingExplanations] = ()  # explanations within the part

    @property
    def estimates(self) -> Rows:
        """(m,) ESTIMATE that were published."""
        estimates: Rows = self.results["estimate"][self.results["published"]]
        return estimates


Watch = Callable[[Part], None]


def combine_watches(*watches: Watch) -> Watch:
    """A watch that passes each part to all of these, in their order."""

    def watch(part: Part) -> None:
        for one in watches:
            one(part)

    return watch


def run_estimator(stream: InputStream, estimator: SlipEstimator) -> Iterator[Part]:
    """The parts of a bag; commands, changes of parameters and restarts act at their place in the order."""
    p = estimator.parameters
    for batch in stream:
        tables, restart, begin = batch.tables, None, 0
        for end in (*np.flatnonzero(batch.rows["kind"] == IS_START).tolist(), len(batch.rows)):
            rows = batch.rows[begin:end]
            results, learned, explanations = _process(stream, estimator, rows)
            events = estimator.read_events()
            yield Part(stream.sources, rows, results, tables, learned, restart, events, explanations)
            if end < len(batch.rows):
                restart = _later_start(p, stream, int(batch.rows["start"][end]))
                estimator = SlipEstimator(restart.parameters, learned=restart.learned)
                tables, begin = {}, end + 1


def _later_start(p: SlipEstimatorParameters, stream: InputStream, number: int) -> EstimatorStart:
    """Start of a later run: its changed parameters over ``p``, and what was learned before it.

    ``p``: parameters of the first run, used alone where the bag lacks those of the later (``number`` < 0).
    """
    if number < 0:
        return EstimatorStart(p, None)
    changed, tree = stream.starts[number]
    p = p.changed(changed)
    return EstimatorStart(p, usable_learned(tree, p)[0])


def usable_learned(tree: Any, p: SlipEstimatorParameters) -> tuple[Learned | None, str]:
    """Quantities learned before, as a bag states them, and a line for the user; None: nothing for ``p``."""
    if tree is None:
        return None, ""
    try:
        return from_tree(tree, learned_context(p)), "starts from values learned before the bag begins"
    except InputError as error:
        return None, f"learned values from before the bag are not used: {error}"


def _process(
    stream: InputStream, estimator: SlipEstimator, rows: Rows
) -> tuple[Rows, list[LearnedValues], list[CompetingExplanations]]:
    """(n,) RESULT of (n,) ARRIVAL of one run, with the learned quantities and explanations in between."""
    results = np.zeros(len(rows), RESULT)
    commands = np.flatnonzero(rows["kind"] >= IS_COMMAND)
    learned: list[LearnedValues] = []
    explanations: list[CompetingExplanations] = []
    begin = 0
    periods = np.flatnonzero(np.diff(rows["log_time_ns"] // _EXPLANATION_PERIOD_NS)) + 1
    pieces = {*range(_PIECE_SIZE, len(rows), _PIECE_SIZE), len(rows)}
    for end in np.unique((*commands, *periods, *pieces)).tolist():
        measurements = to_measurements(rows[begin:end], stream.sources, estimator.sources)
        results[begin:end] = estimator.process_records(measurements)
        begin = end
        if estimator.started and end > 0:
            explanations.append(estimator.competing_explanations)
            if end in pieces or end in commands:
                findings = learned_quantities(estimator.learned, estimator.learned_context)
                learned.append(LearnedValues(estimator.newest_ns or 0, findings))
                estimator.read_events()  # before the branch discards them
        if end in commands:
            is_reload = rows["kind"][end] == IS_RELOAD
            command = Command(stream.sources[rows["source"][end]], int(rows["stamp_ns"][end]))
            estimator.apply_command(stream.reloads[rows["reload"][end]] if is_reload else command)
            results["stamp_ns"][end] = rows["stamp_ns"][end]
            results["nis"][end] = results["gate"][end] = np.nan
            begin = end + 1
    return results, learned, explanations
