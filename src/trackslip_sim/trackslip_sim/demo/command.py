# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip demo``: simulates, replays and shows a drive by the commands of a user."""

import argparse
import shlex
import webbrowser
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from trackslip_common.errors import ExitCode, InputError, show
from trackslip_common.soils import soil
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_tools.cli import main
from trackslip_tools.cli.elapsed import begin_command
from trackslip_tools.cli.outputs import make_folder

EXAMPLE = "trackslip demo --vehicle excavator_20t --soil sandy_loam"

_DEFAULT_SOIL = "sand"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``trackslip demo``."""
    add = parser.add_argument
    add("--vehicle", metavar="NAME|FILE", default="excavator_20t", help="default: excavator_20t")
    add("--scenario", metavar="NAME|FILE", default="slalom", help="default: slalom")
    add(
        "--soil",
        metavar="S",
        default=_DEFAULT_SOIL,
        help=f"a name of config/soils.yaml; default: {_DEFAULT_SOIL}",
    )
    add("--duration", type=float, metavar="S", default=30.0, help="of driving; default: 30 s")
    add("--output", type=Path, metavar="DIR", default=Path("trackslip_demo"), help="directory to create")
    add("--no-browser", dest="browser", action="store_false", help="do not open the report")


def run(arguments: argparse.Namespace) -> int:
    """Run the commands, each printed before; returns the exit code of the first that fails."""
    output: Path = arguments.output
    if output.exists():
        raise InputError(f"--output: '{output}' exists; accepted: a directory that does not")
    load_scenario(arguments.scenario)
    soil(arguments.soil)  # raises InputError if unknown
    make_folder("output", output)
    if (code := run_commands(_commands(arguments))) != ExitCode.DONE:
        return code
    page = output / "report.html"
    if arguments.browser:
        webbrowser.open(page.resolve().as_uri())
    show(f"next: trackslip check {output / 'bag'}, or a log of your own: docs/import.md")
    return int(ExitCode.DONE)


def run_commands(lines: Iterable[Sequence[str]]) -> int:
    """Run commands of ``trackslip``, each printed before; returns the exit code of the first that fails.

    Raises:
        InputError: one is refused.
    """
    for line in lines:
        show(f"$ trackslip {shlex.join(line)}")
        begin_command()
        args = main.parse_arguments(line)
        if (code := int(args.run(args))) != ExitCode.DONE:
            return code
    return int(ExitCode.DONE)


def _commands(arguments: argparse.Namespace) -> Iterator[list[str]]:
    """The arguments of each command of the demo."""
    bag, page = str(arguments.output / "bag"), str(arguments.output / "report.html")
    drive = ["--scenario", arguments.scenario, "--vehicle", arguments.vehicle, "--soil", arguments.soil]
    yield ["simulate", *drive, "--duration", f"{arguments.duration:g}", "--output", bag]
    receiver = ["--params", "gnss.yaml"] if load_vehicle(arguments.vehicle).has_receiver else []
    yield ["replay", bag, *receiver]
    yield ["report", bag, *receiver, "--output", page]
