# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of the offline tools on a sensor bag of three minutes, one core: ``make bench`` prints the rows."""

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from fixtures.whole_inputs import read_inputs

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag, open_bag
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.simulate import simulate
from trackslip_tools.replay.inputs import InputStream
from trackslip_tools.replay.run import replay
from trackslip_tools.tuning.task import read_task, score_of
from trackslip_tools.workers import core_count, open_workers

RUNS = 5
SETS = 100  # parameter sets


def rows(directory: Path) -> Iterator[tuple[str, str, str, str]]:
    """Rows (quantity, here, beside, bar)."""
    path = directory / "field_trial"
    record_drive(load_emulator_parameters({"seed": 1}), simulate(load_scenario("field_trial")), path)
    p = load_slip_parameters()
    with open_bag(path) as bag:
        seconds = bag.duration_s
        reading = _median(lambda: seconds_of(lambda: _read(bag)))
        whole = _median(lambda: replay(bag, p, InputFilters(), None).elapsed_s)
        inputs = read_inputs(bag, p, InputFilters(), ())
        task = read_task(bag, p, InputFilters(), None, needs_reference=True)
    yield f"reading of {seconds:.0f} s, all that a replay needs", f"{seconds / reading:.0f} ×", "", "≥ 250 ×"
    yield f"replay of {seconds:.0f} s", f"{seconds / whole:.0f} ×", "", "≥ 300 ×"
    measurements = inputs.measurements(SlipEstimator(p).sources)
    alone = _median(lambda: seconds_of(lambda: SlipEstimator(p).process_records(measurements)))
    yield "replay, filter alone", f"{seconds / alone:.0f} ×", "", ""
    jobs = [(0, {"gate_relaxation": 2.0 + k / SETS}) for k in range(SETS)]
    with open_workers(core_count(), shared=[task]) as mapped:
        list(mapped(score_of, jobs[:1]))  # starts the processes
        each = seconds_of(lambda: list(mapped(score_of, jobs))) / SETS
    yield (
        "tune, 1000 sets on that bag, all cores",
        f"{1000 * each:.0f} s",
        f"{os.cpu_count()} cores",
        "≤ 60 s",
    )


def _read(bag: Bag) -> None:
    """Read the bag in bounded memory; see ``InputStream``."""
    tables = ("odometry", "track_slip", "truth/odometry", "truth/track_slip", "hydraulics")
    for _ in InputStream(bag, load_slip_parameters(), InputFilters(), tables):
        pass


def _median(measure: Callable[[], float]) -> float:
    values = [measure() for _ in range(1 + RUNS)]
    return statistics.median(values[1:])  # the first run compiles


def seconds_of(function: Callable[[], object]) -> float:
    """Duration of a call, s."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(Path(folder)):
            print(*row, sep="  ")
