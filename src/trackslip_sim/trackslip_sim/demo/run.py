# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the demo: start the graph, turn the key, watch, stop, replay, report."""

import argparse
import json
import math
import os
import random
import shutil
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from trackslip_bags.reader import open_bag
from trackslip_common.config_files import load_parameters
from trackslip_common.console import report_output_failure
from trackslip_common.errors import ExitCode, InputError, printable
from trackslip_common.soils import soil
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.demo.command import run_commands
from trackslip_sim.demo.graph import LIVE_NODE, DemoOptions, demo_nodes
from trackslip_sim.demo.output import claim
from trackslip_sim.demo.processes import DemoFailure, Processes, deferred_interrupts
from trackslip_sim.demo.results import counts_of, shortfalls
from trackslip_sim.demo.session import Session
from trackslip_sim.demo.show import counts_table
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_tools.cli.outputs import write_json
from trackslip_tools.live.parameters import DEFAULT_FILES, LiveParameters

_MAX_DURATION = 3600.0  # s
_FIRST_DOMAIN, _DOMAIN_COUNT = 1, 100
_LAST_DOMAIN = 101  # later ones use ephemeral ports
_UDP_PORTS = range(20_000, 32_768)  # below the ephemeral ones


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; returns the exit code."""
    console = Console(highlight=False)
    try:
        options = _options(argv)
        with claimed_domain() as domain, claim(options.output):  # if refused, files stay unchanged
            code = _run(options, domain, console)
        sys.stdout.flush()
        return code
    except InputError as error:
        print(error, file=sys.stderr)
        return ExitCode.BAD_INPUT
    except DemoFailure as error:
        print(error, file=sys.stderr)
        return ExitCode.FAILED
    except OSError as error:
        return report_output_failure("make demo", error)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return ExitCode.INTERRUPTED


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make demo", description=__doc__)
    parser.add_argument("--duration", default="40", help="seconds of driving")
    parser.add_argument("--soil", default="sand", help="a name of config/soils.yaml")
    parser.add_argument("--scenario", default="thesis", help="a name of config/scenarios, or a file")
    parser.add_argument("--vehicle", help="a name of config/vehicles, or a file; default: the scenario's")
    parser.add_argument("--output", type=Path, default=Path("out/demo"), help="directory of the results")
    parser.add_argument("--no-live", dest="live", action="store_false", help="serve no live page")
    options = parser.parse_args(argv)
    options.duration = _parse_duration(options.duration)
    soil(options.soil)  # raises InputError if unknown
    options.vehicle = options.vehicle or load_scenario(options.scenario).vehicle
    machine = load_vehicle(options.vehicle)
    machine.whole()
    options.machine = printable(machine.name)
    options.gnss = machine.has_receiver
    return options


def _parse_duration(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 1.0 <= seconds <= _MAX_DURATION:
        raise InputError(
            f"DURATION: '{text}' is refused; accepted: 1 to {_MAX_DURATION:g} (seconds of driving)"
        )
    return seconds


def _run(options: argparse.Namespace, domain: int, console: Console) -> int:
    output: Path = options.output
    nodes = DemoOptions(
        devices=(output / "dev").resolve(),
        bag=(output / "bag").resolve(),
        can_port=free_udp_port(),
        duration=options.duration,
        vehicle=options.vehicle,
        soil=options.soil,
        scenario=options.scenario,
        autostart=False,
        laser=not options.gnss,
        gnss=options.gnss,
    )
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    console.print(
        f"Trackslip demo: {options.duration:g} s of '{options.scenario}' on {options.soil}; "
        f"observe with ROS_DOMAIN_ID={domain}"
    )
    console.print(f"vehicle: {escape(options.machine)}")
    live = [replace(LIVE_NODE, parameters={"port": _free_tcp_port()})] if options.live else []
    for page in live:
        console.print(f"the live page: http://127.0.0.1:{page.parameters['port']}/")
    processes = Processes(output, os.environ)
    with deferred_interrupts() as check:
        try:
            session = Session(processes, console, check)
            try:
                session.bring_up([*demo_nodes(nodes), *live])
                session.show_drive(options.duration)
            finally:
                session.close()
                processes.stop(["record"])  # first, while the other nodes still publish
        finally:
            processes.stop()
            shutil.rmtree(nodes.devices, ignore_errors=True)
    return _replay_and_report(output, session, output / "bag", console)


def _replay_and_report(output: Path, session: Session, path: Path, console: Console) -> int:
    """Run replay and report, count the messages; returns the exit code."""
    numbers, page = output / "summary.json", output / "report.html"
    code = run_commands(
        (["replay", str(path), "--json", str(numbers)], ["report", str(path), "--output", str(page)])
    )
    if code != ExitCode.DONE:
        print(f"the nodes' logs are in {output}/*.log", file=sys.stderr)
        return code
    with open_bag(path) as bag:
        counts = counts_of(bag, session.monitor.emitted, session.monitor.received)
    console.print(counts_table(counts))
    summary = json.loads(numbers.read_text(encoding="utf-8"))
    write_json(numbers, {**summary, "topics": {topic: vars(count) for topic, count in counts.items()}})
    missed = shortfalls(summary, counts)
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return ExitCode.FAILED if missed else ExitCode.DONE


def _free_tcp_port() -> int:
    """The port in ``config/live.yaml``; another one if it is in use."""
    usual = load_parameters(LiveParameters, LIVE_NODE.executable, DEFAULT_FILES).port
    for requested in (usual, 0):
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", requested))
            return int(probe.getsockname()[1])
    return usual


def free_udp_port() -> int:
    """A port that no program uses now; none gets it by chance, as the system gives out higher ones."""
    while True:
        port = random.choice(_UDP_PORTS)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.bind(("", port))
            return port


@contextmanager
def claimed_domain() -> Iterator[int]:
    """A ROS domain that no other demo of this host uses: demos in one domain would interfere.

    The domain of ``ROS_DOMAIN_ID``, or a free one; reserved until the exit.

    Raises:
        InputError: another demo runs in the domain, or ``ROS_DOMAIN_ID`` is not one of 0 to 101.
    """
    requested = os.environ.get("ROS_DOMAIN_ID")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as lock:
        domain = next((d for d in _candidate_domains(requested) if _bind_domain(lock, d)), None)
        if domain is None:
            where = f"in domain {requested}" if requested else "in each domain"
            raise InputError(f"ROS_DOMAIN_ID: another demo runs {where}; accepted: another one, or none set")
        yield domain


def _candidate_domains(requested: str | None) -> list[int]:
    if requested:
        if requested not in map(str, range(_LAST_DOMAIN + 1)):
            raise InputError(f"ROS_DOMAIN_ID: '{requested}' is no domain; accepted: 0 to {_LAST_DOMAIN}")
        return [int(requested)]
    return [_FIRST_DOMAIN + (os.getpid() + k) % _DOMAIN_COUNT for k in range(_DOMAIN_COUNT)]


def _bind_domain(lock: socket.socket, domain: int) -> bool:
    """Bind the abstract socket name of a domain; False if it is taken. The name ends with the process."""
    try:
        lock.bind(f"\0trackslip-demo-domain-{domain}")
    except OSError:
        return False
    return True
