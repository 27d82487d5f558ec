# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Options common to several commands: bag, machine, parameters; imports no other modules of the tools."""

import argparse
from pathlib import Path

from trackslip_common.vehicle_files import DEFAULT_VEHICLE


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Declare the one bag of a command."""
    about = "rosbag2 directory (MCAP or SQLite), .mcap or .db3 file"
    parser.add_argument("bag", metavar="BAG", type=Path, help=about)


def add_bags(parser: argparse.ArgumentParser, about: str) -> None:
    """Declare the bags of a command that takes several."""
    parser.add_argument("bags", metavar="BAG", type=Path, nargs="+", help=about)


def add_params(parser: argparse.ArgumentParser, of: str = "the bag's") -> None:
    """Declare ``--params``."""
    about = f"ROS parameter files over {of} own"
    parser.add_argument("--params", metavar="FILE", nargs="+", default=[], help=about)


def add_set(parser: argparse.ArgumentParser, about: str = "one parameter, over all files") -> None:
    """Declare ``--set``."""
    parser.add_argument("--set", metavar="node.param=value", action="append", default=[], help=about)


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare ``--json``."""
    parser.add_argument("--json", metavar="FILE", type=Path, help=f"write {what} as JSON")


def add_vehicle(parser: argparse._ActionsContainer, default: str) -> None:
    """Declare ``--vehicle``."""
    about = f"a name of config/vehicles, or a file (default: {default}, else {DEFAULT_VEHICLE})"
    parser.add_argument("--vehicle", metavar="NAME|FILE", help=about)


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Declare ``--namespace``."""
    about = "the machine's part of a bag: topic sprockets is /NS/sprockets, and so on"
    parser.add_argument("--namespace", metavar="NS", default="", help=about)


def next_command_options(args: argparse.Namespace) -> list[str]:
    """Command-line words of the options that the next command needs too: machine, parameters."""
    options = {"--vehicle": args.vehicle, "--namespace": args.namespace}
    words = [word for name, value in options.items() if value for word in (name, value)]
    words += [word for setting in args.set for word in ("--set", setting)]
    return [*words, "--params", *args.params] if args.params else words
