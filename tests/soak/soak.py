# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the graph for as long as requested and measures the growth of resources: ``make soak``.

Localizer, estimators and recorder process a repeated drive of ten minutes at SPEED times real time. Drivers
run beside them in real time, on the emulated machine and in a separate domain, because serial lines and buses
have fixed rates. All processes and the received messages are sampled several times a minute. The page
``out/soak/soak.md`` has the growth per hour. The exit code is 1 if a node ended, messages were lost, or a
quantity certainly grew by more than its limit.

A drive of the emulated machine lasts an hour. Then the machine is switched off and on again.
"""

import argparse
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from soak_monitor import Monitor
from soak_page import Sample, growths, page
from trackslip_common.errors import ExitCode, InputError
from trackslip_sim.demo.graph import DemoOptions, NodeSpec, demo_nodes
from trackslip_sim.demo.output import LOGS, Results, claim
from trackslip_sim.demo.processes import Processes
from trackslip_tools.cli.progress import iterate_with_bar

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "soak"
RESULTS = Results("soak", ("bag*", "devices", "drive", *LOGS, "soak.md", "state.yaml*"))
DRIVE_S, SPEED = 600, 10.0
MAX_DRIVE_S = 3600.0  # longest drive of the emulator
LIMITS = {"RSS (MB)": 10.0, "threads": 1.0, "open files": 1.0}  # growth per hour
_SAMPLES = 240  # per run
_PERIODS = (1.0, 30.0)  # s between samples
_DISK = 2_000_000_000  # bytes, limit of the recordings
_PAGE = os.sysconf("SC_PAGE_SIZE")
_TICKS = os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Run the soak; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=300.0, metavar="S", help="(%(default)s)")
    parser.add_argument("--speed", type=float, default=SPEED, help="of the drive (%(default)s)")
    args = parser.parse_args()
    if not (args.duration >= 30.0 and 0.1 <= args.speed <= 20.0):
        print("soak: accepted: DURATION 30 s or more, SPEED 0.1 to 20", file=sys.stderr)
        return ExitCode.BAD_INPUT
    try:
        with claim(OUT, RESULTS):
            return _soak(args.duration, args.speed)
    except InputError as error:
        print(f"soak: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return ExitCode.INTERRUPTED


def _soak(duration_s: float, speed: float) -> int:
    drive = OUT / "drive"
    simulate = ["simulate", "--scenario", "field_trial", "--duration", str(DRIVE_S), "--output", str(drive)]
    subprocess.run([*_TRACKSLIP, *simulate], check=True, stdout=subprocess.DEVNULL)
    domain = 1 + os.getpid() % 50
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    print(f"soak: {duration_s:.0f} s at {speed:g} times real time; logs in {OUT}", flush=True)
    with _running(domain, _estimators()) as fast, _running(domain + 50, _devices(duration_s)) as slow:
        monitor = Monitor(domain)
        _play(drive, speed, fast)
        graph = Graph(fast, slow)
        samples: list[Sample] = []
        try:
            for sample in iterate_with_bar(
                _samples(monitor, graph, duration_s), "soak", total=_sampling(duration_s)[0]
            ):
                samples.append(sample)
            interrupted = False
        except KeyboardInterrupt:  # the page covers the samples so far
            interrupted = True
        finally:
            ended = graph.exit_codes()
            fast.stop(["player"])
            monitor.close()
        lasted_s = samples[-1].time_s if samples else 0.0
        code = _conclude(samples, monitor, f"{lasted_s:.0f} s at {speed:g} times real time", ended)
        return ExitCode.INTERRUPTED if interrupted else code


_TRACKSLIP = (sys.executable, "-m", "trackslip_tools.cli.main")


def _play(drive: Path, speed: float, beside: Processes) -> None:
    """Start the player in a loop."""
    player = ["replay", str(drive), "--publish", "--loop", "--rate", str(speed)]
    player += ["--remap", "box_pose:=recorded_box_pose"]  # the localizer publishes its own poses
    beside.run("player", [*_TRACKSLIP, *player])


class Graph:
    """All processes of a soak."""

    def __init__(self, fast: Processes, slow: Processes) -> None:
        self._fast, self._slow = fast, slow
        self._restart_s = MAX_DRIVE_S

    def pids(self) -> dict[str, int]:
        """Process ids by name."""
        return {**self._fast.pids(), **self._slow.pids()}

    def exit_codes(self) -> dict[str, int]:
        """Exit codes of processes that ended too early."""
        return {**self._fast.exit_codes(), **self._slow.exit_codes()}

    def keep_driving(self, elapsed_s: float, left_s: float) -> None:
        """Restart the emulated machine when its drive is over."""
        if elapsed_s > self._restart_s:
            self._slow.stop(["emulator"])
            self._slow.start(next(node for node in _devices(left_s) if node.executable == "emulator"))
            self._restart_s = elapsed_s + MAX_DRIVE_S


def _sampling(duration_s: float) -> tuple[int, float]:
    """Number of samples, and their period, s."""
    period_s = min(max(duration_s / _SAMPLES, _PERIODS[0]), _PERIODS[1])
    return round(duration_s / period_s) - 1, period_s


def _samples(monitor: Monitor, graph: Graph, duration_s: float) -> Iterator[Sample]:
    """Samples from the settled graph until the time is over or a node has ended."""
    count, period_s = _sampling(duration_s)
    began_s = time.monotonic()
    monitor.spin_until(began_s + period_s)
    monitor.latency()
    cpu = {pid: _cpu_s(pid) for pid in graph.pids().values()}
    for k in range(2, count + 2):
        monitor.spin_until(began_s + k * period_s)
        if graph.exit_codes():
            return
        values = monitor.latency()
        for name, pid in graph.pids().items():
            values |= {(name, quantity): value for quantity, value in _process(pid).items()}
            now_s = _cpu_s(pid)
            values[name, "processor (%)"] = 100.0 * (now_s - cpu.get(pid, now_s)) / period_s
            cpu[pid] = now_s
        elapsed_s = time.monotonic() - began_s
        yield Sample(elapsed_s, values)
        graph.keep_driving(elapsed_s, duration_s - elapsed_s)


def _conclude(samples: list[Sample], monitor: Monitor, what: str, ended: Mapping[str, int]) -> int:
    """Write the page; returns the exit code."""
    if len(samples) < 2:
        print(f"soak: ended at once: {dict(ended)}", file=sys.stderr)
        return ExitCode.FAILED
    grown = [
        f"{node} {quantity}: {g.per_hour:.3g} ± {g.uncertainty:.2g} in an hour"
        for (node, quantity), g in growths(samples).items()
        if g.per_hour - g.uncertainty > LIMITS.get(quantity, math.inf)
    ]
    notes = [*(f"{text} ({count} times)" for text, count in sorted(monitor.errors.items())), *grown]
    notes += [f"{name} ended with exit code {code}" for name, code in ended.items()]
    notes += [] if monitor.totals["estimates"] else ["the slip estimator published no estimates"]
    heading = f"{what}, {len(samples)} samples, on {os.cpu_count()} cores."
    text = page(samples, monitor.totals, heading) + "\n" + "".join(f"- {note}\n" for note in notes)
    (OUT / "soak.md").write_text(text, encoding="utf-8")
    print(text)
    lost = monitor.totals["reports missing"] or not monitor.totals["estimates"]
    return ExitCode.FAILED if ended or grown or lost else ExitCode.DONE


@contextmanager
def _running(domain: int, nodes: list[NodeSpec]) -> Iterator[Processes]:
    """Run nodes in a domain; ends them at the exit."""
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
        duration=min(duration_s + 60.0, MAX_DRIVE_S),
        soil="sand",
        scenario="thesis",
        vehicle="pc05",
        autostart=True,
    )
    return [node for node in demo_nodes(options) if node.package in ("trackslip_sim", "trackslip_drivers")]


def _process(pid: int) -> dict[str, float]:
    """Memory, threads and open files of a process."""
    folder = Path(f"/proc/{pid}")
    pages = int((folder / "statm").read_text().split()[1])
    threads = sum(1 for _ in (folder / "task").iterdir())
    return {
        "RSS (MB)": pages * _PAGE / 1e6,
        "threads": threads,
        "open files": sum(1 for _ in (folder / "fd").iterdir()),
    }


def _cpu_s(pid: int) -> float:
    """CPU time since the start, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


if __name__ == "__main__":
    sys.exit(main())
