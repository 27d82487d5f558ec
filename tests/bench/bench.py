# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speeds, loads and latencies on this machine, printed: ``make bench`` asserts nothing.

Loads are in percent of one core. Beside each is its floor: the load of a bare rclpy node that publishes the
same messages at the same rate. Measure on a quiet machine; every number is a median of three windows or runs.
"""

import argparse
import os
import platform
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from fixtures.whole_inputs import read_inputs

import bench_bags
import bench_filters
import bench_nodes
from bench_bags import seconds_of
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import Bag, open_bag
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.simulate import simulate
from trackslip_tools.replay.run import replay

RUNS = 3
DRIVE = 20.0  # s of the live graph
_NODES = (
    "can_driver",
    "watson_imu",
    "sick_pls",
    "box_localizer",
    "slip_estimator",
    "soil_estimator",
    "record",
)


def main() -> int:
    """Measure and print; returns the exit code."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}")
    show("", "here", "beside", "bar")
    seconds = _median(_truth_seconds)
    show("truth, 60 s at 1 ms, 30 elements a track", f"{seconds:.2f} s", "", "≤ 2 s")
    for row in bench_filters.rows():
        show(*row)
    with tempfile.TemporaryDirectory(prefix="trackslip_bench_") as directory:
        for row in bench_bags.rows(Path(directory)):
            show(*row)
        for measure in (_drivers, _graph):  # each starts its own devices
            folder = Path(directory) / measure.__name__
            folder.mkdir()
            measure(folder)
    return 0


def _truth_seconds() -> float:
    """Seconds for a minute of the field trial in mode ``shear``, compiled and warm, on one core."""
    scenario = load_scenario("field_trial")
    simulate(scenario.with_duration(0.1), soil="sand")
    return seconds_of(lambda: simulate(scenario.with_duration(60.0), soil="sand"))


def show(what: str, here: str, beside: str = "", bar: str = "") -> None:
    """Print a row as two lines within 80 columns."""
    figures = f"    {here:<14}{beside:<44}{bar}".rstrip()
    print(f"{what}\n{figures}" if what else figures, flush=True)


def _drivers(directory: Path) -> None:
    for name, (load, floor) in bench_nodes.drivers(directory).items():
        beside = f"floor {floor.cpu_percent:.1f} %, {floor.rate:.0f} Hz"
        show(f"CPU of {name}, {load.rate:.0f} Hz", f"{load.cpu_percent:.1f} %", beside, "≤ 5 %")


def _graph(directory: Path) -> None:
    graph = bench_nodes.graph(directory, DRIVE)
    loads = {name: graph.loads[name] for name in _NODES if name in graph.loads}
    floors = bench_nodes.bare_loads(directory, graph, DRIVE / 2)
    for name, percent in loads.items():
        show(f"CPU of {name}, live graph", f"{percent:.1f} %", f"a bare node {floors[name]:.1f} %")
    floor = f"bare nodes {sum(floors[name] for name in loads):.1f} %"
    show("CPU of all live nodes together", f"{sum(loads.values()):.1f} %", floor, "≤ 30 %")
    for which in ("p50", "p99"):
        age, bare, floor = (getattr(latency, which) for latency in (graph.odometry, graph.bare, graph.floor))
        beside = f"{age / floor:.1f} × one hop of rclpy, {floor:.2f} ms"
        show(f"stamp of sprockets → odometry, {which}", f"{age:.2f} ms", beside, "≤ 3 ×")
        show(f"  a bare relay for the estimator, {which}", f"{bare:.2f} ms", f"{bare / floor:.1f} ×")
    with open_bag(graph.bag) as bag:
        p = load_slip_parameters(bag_parameters(bag))
        seconds = _median(lambda: seconds_of(lambda: replay(bag, p, InputFilters(), None)))
        show(
            f"replay of a bag of {bag.duration_s:.0f} s, in total",
            f"{bag.duration_s / seconds:.0f} × real time",
        )
        cost_us = _median(lambda: _estimator_us(bag, p))
    show("slip estimator, a measurement", f"{cost_us:.0f} µs")


def _estimator_us(bag: Bag, p: SlipEstimatorParameters) -> float:
    """µs per measurement, including late ones and the reprocessing that they cause."""
    estimator = SlipEstimator(p)
    measurements = read_inputs(bag, p, InputFilters(), ()).measurements(estimator.sources)
    one_by_one = [measurements[k : k + 1] for k in range(len(measurements))]
    seconds = seconds_of(lambda: [estimator.process_records(measurement) for measurement in one_by_one])
    return 1e6 * seconds / len(measurements)


def _median(measure: Callable[[], float]) -> float:
    return statistics.median(measure() for _ in range(RUNS))


if __name__ == "__main__":
    sys.exit(main())
