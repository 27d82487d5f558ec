# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Options that say which machine a bag is of; they load nothing."""

import argparse

from trackslip_common.vehicle_files import ASSUMED


def add_vehicle(parser: argparse._ActionsContainer, default: str) -> None:
    """Declare ``--vehicle``."""
    about = f"a name of config/vehicles, or a file (default: {default}, else {ASSUMED})"
    parser.add_argument("--vehicle", metavar="NAME|FILE", help=about)


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Declare ``--namespace``."""
    about = "the machine's part of a bag: topic sprockets is /NS/sprockets, and so on"
    parser.add_argument("--namespace", metavar="NS", default="", help=about)


def stated(args: argparse.Namespace) -> list[str]:
    """Options of a command that the next one needs too: machine, parameters; as words of a command line."""
    named = {"--vehicle": args.vehicle, "--namespace": args.namespace}
    found = [word for option, value in named.items() if value for word in (option, value)]
    found += [word for setting in args.set for word in ("--set", setting)]
    return [*found, "--params", *args.params] if args.params else found
