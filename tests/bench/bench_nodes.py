# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measures running nodes: CPU of the drivers at full rate, CPU and latency of the whole graph."""

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rclpy

import bench_bare
from bench_devices import SICK_BAUD, WATSON_BAUD
from bench_ros import FLOOR, Listener
from trackslip_sim.demo.graph import DemoOptions, demo_nodes
from trackslip_sim.demo.processes import Processes
from trackslip_sim.demo.run import free_udp_port

DRIVERS = {
    "can_driver": ("sprockets", "hydraulics"),
    "watson_imu": ("imu/data_raw", "imu/mag"),
    "sick_pls": ("scan",),
}
WINDOW = 5.0  # s of each measurement
REPEATS = 3
_WARM_UP = 12.0  # s; the inertial unit initialises for 5 s, the scanner changes its rate
_GRAPH_TIMEOUT = 60.0  # s until the graph publishes odometry
_CPU_CLOCK = 2  # Linux: clock number of a process' CPU time is ~pid << 3 | 2


@dataclass(frozen=True)
class Load:
    """CPU and rate of a node; medians of the windows."""

    cpu_percent: float  # of one core
    rate: float  # Hz, of its first topic; 0 if not counted


@dataclass(frozen=True)
class Latency:
    """Ages on arrival, ms."""

    p50: float
    p99: float

    @staticmethod
    def of(ages_ms: list[float]) -> "Latency":
        """Quantiles of the ages; NaN if there are none."""
        return Latency(*np.percentile(ages_ms or [np.nan], (50, 99)).tolist())


@contextlib.contextmanager
def children(directory: Path) -> Iterator[Processes]:
    """Processes that are stopped at the end; their logs are in the directory."""
    started = Processes(directory, os.environ)
    try:
        yield started
    finally:
        started.stop()


def cpu_s(running: Processes) -> dict[str, float]:
    """CPU time of each process, s."""
    return {name: time.clock_gettime(~pid << 3 | _CPU_CLOCK) for name, pid in running.pids().items()}


def drivers(directory: Path) -> dict[str, tuple[Load, Load]]:
    """Name → (load of the driver, load of its floor); all run together, window after window."""
    port = free_udp_port()
    nodes = {node.executable: node for node in demo_nodes(_options(directory, port))}
    changes: dict[str, dict[str, object]] = {
        "can_driver": {},
        "watson_imu": {"serial_baud": WATSON_BAUD},
        "sick_pls": {"serial_baud": SICK_BAUD},
    }
    real = {name: topics[0] for name, topics in DRIVERS.items()}
    topics = tuple(topic for topics in DRIVERS.values() for topic in topics)
    with _listener(topics) as listener, children(directory) as running:
        folder = Path(__file__).parent
        running.run("devices", [sys.executable, str(folder / "bench_devices.py"), str(directory), str(port)])
        _wait_for(directory / "sick")
        for name, parameters in changes.items():
            running.start(replace(nodes[name], parameters={**nodes[name].parameters, **parameters}))
        listener.listen(_WARM_UP)
        loads = _measure(running, listener, real)
        messages = listener.last
    path = directory / "topics.json"
    outputs = {name: {"subscribes": {}, "publishes": dict.fromkeys(DRIVERS[name], True)} for name in DRIVERS}
    sent = {
        topic: (messages[topic], loads[name].rate)
        for name, topics in DRIVERS.items()
        for topic in topics
        if loads[name].rate > 0.0
    }
    bench_bare.write_topics(path, outputs, sent)
    with _listener(topics) as listener, children(directory) as running:
        for name in DRIVERS:
            running.run(name, [sys.executable, str(folder / "bench_bare.py"), str(path), name])
        listener.listen(3.0)
        floors = _measure(running, listener, real)
    return {name: (loads[name], floors[name]) for name in DRIVERS}


@dataclass(frozen=True)
class Graph:
    """Measurements of the whole live graph."""

    loads: dict[str, float]  # CPU of each node, % of a core
    odometry: Latency  # from the stamp of the sprockets
    floor: Latency  # one hop of rclpy, at the same time
    bare: Latency  # of odometry, with a bare relay in place of the slip estimator
    bag: Path
    endpoints: dict[str, bench_bare.Endpoints]  # subscriptions and publications by node


def graph(directory: Path, seconds: float) -> Graph:
    """Run the demo's graph with recorder for so long; a bare publisher of odometry runs beside it.

    Half of the time measures the nodes. A quarter measures the graph with a bare relay in place of the slip
    estimator: its latency is the share of CAN driver and rclpy, independent of the estimator.
    """
    options = _options(directory, free_udp_port(), seconds)
    ours, bare = "odometry", FLOOR + "odometry"
    with _listener((), (ours, bare)) as listener, children(directory) as running:
        for node in demo_nodes(options):
            running.start(node)
        script = str(Path(__file__).parent / "bench_ros.py")
        running.run("floor", [sys.executable, script, "odometry"])
        _receive(listener, ours)
        before, began = cpu_s(running), time.monotonic()
        listener.listen(seconds / 2)
        after, elapsed = cpu_s(running), time.monotonic() - began
        endpoints = bench_bare.endpoints_of(listener.node)
        odometry, floor = (Latency.of(listener.ages_ms[topic]) for topic in (ours, bare))
        running.stop(("record", "slip_estimator"))
        running.run("relay", [sys.executable, script, "relay"])
        listener.reset()
        _receive(listener, ours)
        listener.listen(seconds / 4)
        relayed = Latency.of(listener.ages_ms[ours])
    loads = {name: 100.0 * (after[name] - before[name]) / elapsed for name in before}
    return Graph(loads, odometry, floor, relayed, options.bag, endpoints)


def bare_loads(directory: Path, measured: Graph, seconds: float) -> dict[str, float]:
    """CPU, % of a core, of bare nodes in place of all nodes of a graph (``bench_bare``)."""
    topics, script = directory / "topics.json", str(Path(__file__).parent / "bench_bare.py")
    bench_bare.write_topics(topics, measured.endpoints, bench_bare.recorded_topics(measured.bag))
    with _listener((), ("odometry",)) as listener, children(directory) as running:
        for name in measured.loads.keys() & measured.endpoints.keys():
            running.run(name, [sys.executable, script, str(topics), name])
        _receive(listener, "odometry")
        before, began = cpu_s(running), time.monotonic()
        listener.listen(seconds)
        after, elapsed = cpu_s(running), time.monotonic() - began
    return {name: 100.0 * (after[name] - before[name]) / elapsed for name in before}


def _receive(listener: Listener, topic: str) -> None:
    """Wait until the topic is flowing, and reset the counts."""
    until = time.monotonic() + _GRAPH_TIMEOUT
    while len(listener.ages_ms[topic]) < 100 and time.monotonic() < until:
        listener.listen(0.2)
    listener.reset()


def _measure(running: Processes, listener: Listener, topics: dict[str, str]) -> dict[str, Load]:
    """Medians over the windows: CPU of processes, and the rate of a topic of each."""
    windows = []
    for _ in range(REPEATS):
        listener.reset()
        before, began = cpu_s(running), time.monotonic()
        listener.listen(WINDOW)
        after, elapsed = cpu_s(running), time.monotonic() - began
        windows.append(
            [
                (100.0 * (after[n] - before[n]) / elapsed, listener.received[t] / elapsed)
                for n, t in topics.items()
            ]
        )
    return {name: Load(*pair) for name, pair in zip(topics, np.median(windows, axis=0).tolist(), strict=True)}


@contextlib.contextmanager
def _listener(topics: tuple[str, ...], odometry: tuple[str, ...] = ()) -> Iterator[Listener]:
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    rclpy.init()
    listener = Listener(topics, odometry)
    try:
        yield listener
    finally:
        listener.close()
        rclpy.try_shutdown()


def _options(directory: Path, port: int, duration: float = 1.0) -> DemoOptions:
    bag = directory / "bag"
    return DemoOptions(directory, bag, port, duration, "sand", "thesis", "pc05", autostart=True)


def _wait_for(path: Path) -> None:
    until = time.monotonic() + 10.0
    while not path.exists() and time.monotonic() < until:
        time.sleep(0.05)
