# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the graph for as long as asked, at several times its speed, and looks for what grows: ``make soak``.

Localizer, estimators and recorder live on a drive of ten minutes that a player repeats, at SPEED times real
time. Drivers cannot be hurried, for bytes take their time: they run beside it in a domain of their own, on
the emulated machine, in real time. Some times a minute it looks at every process and at the messages that
came since; what all that grew by in an hour is the page ``out/soak/soak.md``. The exit code is 1 if a node
ended, messages were lost, or something certainly grew by more than its limit.
"""

import argparse
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from soak_page import Sample, growths, page
from trackslip_common.nodes.messages import message_class, topic_class
from trackslip_common.nodes.qos import subscriber_qos
from trackslip_sim.demo.graph import DemoOptions, NodeSpec, demo_nodes
from trackslip_sim.demo.processes import Processes

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "soak"
DRIVE_S, SPEED = 600, 10.0
LIMITS = {"RSS (MB)": 10.0, "threads": 1.0, "open files": 1.0}  # growth in an hour
_SAMPLES = 240  # in a run
_PERIODS = (1.0, 30.0)  # s between them
_DISK = 2_000_000_000  # bytes that recordings may take
_NUMBER = re.compile(r"\d+(\.\d+)?")  # of two messages that differ in numbers the second is the first again
_PAGE = os.sysconf("SC_PAGE_SIZE")
_TICKS = os.sysconf("SC_CLK_TCK")


class Monitor:
    """A node that sees what comes of the graph."""

    def __init__(self, domain: int) -> None:
        rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("soak")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._came: dict[int, float] = {}  # stamp of sprockets → s, steady
        self._sequence = -1
        self._latencies: list[float] = []
        self.totals = {"estimates": 0, "reports missing": 0, "restarts of the drive": 0, "errors": 0}
        self.errors: dict[str, int] = {}
        for topic, handle in (
            ("sprockets", self._on_sprockets),
            ("odometry", self._on_odometry),
            ("measurement_reports", self._on_report),
        ):
            self._node.create_subscription(topic_class(topic), topic, handle, subscriber_qos(topic))
        kind = message_class("diagnostic_msgs/msg/DiagnosticArray")
        self._node.create_subscription(kind, "/diagnostics", self._on_diagnostics, 100)

    def spin_until(self, until_s: float) -> None:
        """Handle what comes."""
        while (left := until_s - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def latency(self) -> dict[tuple[str, str], float]:
        """From sprockets to their odometry, both as they came here, since the last look."""
        found, self._latencies = self._latencies or [math.nan], []
        p50, p99 = np.quantile(found, (0.5, 0.99))
        return {("graph", "latency p50 (ms)"): 1e3 * p50, ("graph", "latency p99 (ms)"): 1e3 * p99}

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _on_sprockets(self, message: Any) -> None:
        if len(self._came) > 10_000:
            self._came.clear()
        self._came[_stamp(message)] = time.monotonic()

    def _on_odometry(self, message: Any) -> None:
        self.totals["estimates"] += 1
        came = self._came.pop(_stamp(message), None)
        if came is not None:
            self._latencies.append(time.monotonic() - came)

    def _on_report(self, message: Any) -> None:
        self.totals["reports missing"] += max(message.sequence - self._sequence - 1, 0) * (
            self._sequence >= 0
        )
        self.totals["restarts of the drive"] += message.outcome == message.RESTARTED
        self._sequence = message.sequence

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.level == status.ERROR:
                self.totals["errors"] += 1
                text = _NUMBER.sub("…", f"{status.name}: {status.message}")
                self.errors[text] = self.errors.get(text, 0) + 1


def main() -> int:
    """Run it; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=300.0, metavar="S", help="(%(default)s)")
    parser.add_argument("--speed", type=float, default=SPEED, help="of the drive (%(default)s)")
    args = parser.parse_args()
    if not (args.duration >= 30.0 and 0.1 <= args.speed <= 20.0):
        print("soak: accepted: DURATION 30 s or more, SPEED 0.1 to 20", file=sys.stderr)
        return 2
    try:
        return _soak(args.duration, args.speed)
    except KeyboardInterrupt:
        return 130


def _soak(duration_s: float, speed: float) -> int:
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    drive = OUT / "drive"
    simulate = ["simulate", "--scenario", "field_trial", "--duration", str(DRIVE_S), "--output", str(drive)]
    subprocess.run([*_TRACKSLIP, *simulate], check=True, stdout=subprocess.DEVNULL)
    domain = 1 + os.getpid() % 50
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with _running(domain, _estimators()) as fast, _running(domain + 50, _devices(duration_s)) as slow:
        monitor = Monitor(domain)
        player = ["replay", str(drive), "--publish", "--loop", "--rate", str(speed)]
        player += ["--remap", "box_pose:=recorded_box_pose"]  # the localizer makes its own
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        with (OUT / "player.log").open("wb") as log:
            playing = subprocess.Popen([*_TRACKSLIP, *player], env=environment, stdout=log, stderr=log)
        try:
            pids = {**fast.pids(), **slow.pids(), "player": playing.pid}
            samples = list(_samples(monitor, pids, duration_s, (fast, slow)))
        finally:
            playing.send_signal(signal.SIGINT)
            playing.wait()
            monitor.close()
        what = f"{duration_s:.0f} s at {speed:g} times real time"
        return _conclude(samples, monitor, what, {**fast.ended(), **slow.ended()})


_TRACKSLIP = (sys.executable, "-m", "trackslip_tools.cli.main")


def _samples(
    monitor: Monitor, pids: Mapping[str, int], duration_s: float, all_of: tuple[Processes, ...]
) -> Iterator[Sample]:
    """From when the graph has settled; until the time is over, or a node has ended."""
    period_s = min(max(duration_s / _SAMPLES, _PERIODS[0]), _PERIODS[1])
    began_s = time.monotonic()
    monitor.spin_until(began_s + period_s)
    monitor.latency()
    cpu = {name: _cpu_s(pid) for name, pid in pids.items()}
    for k in range(2, round(duration_s / period_s) + 1):
        monitor.spin_until(began_s + k * period_s)
        if any(processes.ended() for processes in all_of):
            return
        values = monitor.latency()
        for name, pid in pids.items():
            values |= {(name, quantity): value for quantity, value in _process(pid).items()}
            now_s = _cpu_s(pid)
            values[name, "processor (%)"], cpu[name] = 100.0 * (now_s - cpu[name]) / period_s, now_s
        yield Sample(time.monotonic() - began_s, values)


def _conclude(samples: list[Sample], monitor: Monitor, what: str, ended: Mapping[str, int]) -> int:
    """Write the page; the exit code."""
    if len(samples) < 2:
        print(f"soak: ended at once: {dict(ended)}", file=sys.stderr)
        return 1
    grown = [
        f"{node} {quantity}: {g.per_hour:.3g} ± {g.uncertainty:.2g} in an hour"
        for (node, quantity), g in growths(samples).items()
        if g.per_hour - g.uncertainty > LIMITS.get(quantity, math.inf)
    ]
    notes = [*(f"- {text} ({count} times)" for text, count in sorted(monitor.errors.items())), *grown]
    notes += [f"- {name} ended with exit code {code}" for name, code in ended.items()]
    heading = f"{what}, {len(samples)} samples, on {os.cpu_count()} cores."
    text = page(samples, monitor.totals, heading) + "\n" + "".join(f"{note}\n" for note in notes)
    (OUT / "soak.md").write_text(text, encoding="utf-8")
    print(text)
    return int(bool(ended or grown or monitor.totals["reports missing"]))


@contextmanager
def _running(domain: int, nodes: list[NodeSpec]) -> Iterator[Processes]:
    """Nodes in a domain, until the end."""
    processes = Processes(OUT, {**os.environ, "ROS_DOMAIN_ID": str(domain)})
    try:
        for node in nodes:
            processes.start(node)
        yield processes
    finally:
        processes.stop()


def _estimators() -> list[NodeSpec]:
    recorder = {"output": str(OUT / "bag"), "split_size": 200_000_000, "max_disk": _DISK}
    return [
        NodeSpec("trackslip_estimation", "box_localizer"),
        NodeSpec("trackslip_estimation", "slip_estimator", {"state_file": str(OUT / "state.yaml")}),
        NodeSpec("trackslip_estimation", "soil_estimator"),
        NodeSpec("trackslip_bags", "record", recorder),
    ]


def _devices(duration_s: float) -> list[NodeSpec]:
    """The emulated machine and its drivers."""
    options = DemoOptions(
        devices=OUT / "devices",
        bag=OUT,
        can_port=42000 + os.getpid() % 1000,
        duration=min(duration_s + 60.0, 3600.0),
        soil="sand",
        scenario="thesis",
        vehicle="pc05",
        autostart=True,
    )
    return [node for node in demo_nodes(options) if node.package in ("trackslip_sim", "trackslip_drivers")]


def _process(pid: int) -> dict[str, float]:
    """What a process holds."""
    folder = Path(f"/proc/{pid}")
    pages = int((folder / "statm").read_text().split()[1])
    threads = sum(1 for _ in (folder / "task").iterdir())
    return {
        "RSS (MB)": pages * _PAGE / 1e6,
        "threads": threads,
        "open files": sum(1 for _ in (folder / "fd").iterdir()),
    }


def _cpu_s(pid: int) -> float:
    """Processor time so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


if __name__ == "__main__":
    sys.exit(main())
