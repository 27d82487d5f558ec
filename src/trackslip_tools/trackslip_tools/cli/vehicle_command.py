# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip vehicle``: creates the file of a new machine, and lists the existing ones."""

import argparse
import re
import sys
from contextlib import suppress
from pathlib import Path

from trackslip_common.errors import ExitCode, InputError, printable, show
from trackslip_common.vehicle_files import vehicle_names
from trackslip_tools.cli.outputs import write_file
from trackslip_tools.machine.draft import (
    ANTENNA,
    MEASURING_METHODS,
    REQUIRED_NUMBERS,
    draft_vehicle,
    number_options,
)

EXAMPLE = "trackslip vehicle new --name digger --mass 20000 --tread 2.4"

_NAME = re.compile(r"[A-Za-z][\w-]*")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the two actions and their options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    actions.add_parser("list", help="vehicles that commands know by name")
    new = actions.add_parser(
        "new", help="write the file of a machine; what is not given is asked for, or guessed from its mass"
    )
    new.add_argument("--name", default="my_machine", help="of machine and files (default: my_machine)")
    for option, name, spec in number_options():
        about = f"{spec.description}, {spec.unit}" if spec.unit else spec.description
        new.add_argument(f"--{option}", dest=name, type=float, metavar="N", help=about)
    new.add_argument(
        "--antenna",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="of the GNSS receiver, forward, left of and above the middle between the tracks, m",
    )
    new.add_argument("--output", type=Path, metavar="DIR", default=Path(), help="folder (default: this one)")
    new.add_argument("--no-questions", dest="asks", action="store_false", help="ask for nothing")


def run(arguments: argparse.Namespace) -> int:
    """List the vehicles, or write the files and print the guesses and the next steps."""
    if arguments.action == "list":
        show("\n".join(vehicle_names()))
        return ExitCode.DONE
    if not _NAME.fullmatch(arguments.name):
        accepted = "letters, digits, _ and -, a letter first"
        raise InputError(f"--name: '{printable(arguments.name)}' is refused; accepted: {accepted}")
    known = {name: getattr(arguments, name) for _, name, _ in number_options()}
    known = {name: value for name, value in known.items() if value is not None}
    if arguments.antenna is not None:
        known |= {f"{ANTENNA}.{axis}": value for axis, value in zip("xyz", arguments.antenna, strict=True)}
    if arguments.asks and sys.stdin.isatty():
        known |= _ask_numbers(known)
    draft = draft_vehicle(arguments.name, known)
    paths = [arguments.output / name for name in draft.files]
    for path in paths:
        if path.exists():
            raise InputError(f"'{path}' exists; accepted: another --name or --output")
    for path, text in zip(paths, draft.files.values(), strict=True):
        write_file("output", path, text)
    for line in draft.implausible_lengths:
        show(f"implausible: {line}")
    for name in draft.guessed:
        show(f"guessed: {name} {draft.values[name]:g}: {MEASURING_METHODS[name]}")
    for line in draft.missing:
        show(f"left out: {line}")
    show(f"vehicle: {paths[0]}")
    priors = "".join(f" --params {path}" for path in paths[1:])
    show(f"next: trackslip import LOG.csv --vehicle {paths[0]}")
    show(f"of a bag: trackslip replay BAG --vehicle {paths[0]}{priors}")
    return ExitCode.DONE


def _ask_numbers(known: dict[str, float]) -> dict[str, float]:
    """The user's answers for important numbers that are not known; an empty answer omits a number.

    The end of the input (Ctrl-D) ends the questions.
    """
    specs = {name: spec for _, name, spec in number_options()}
    answers: dict[str, float] = {}
    unknown = [name for name in REQUIRED_NUMBERS if name not in known]
    with suppress(EOFError):
        while unknown:
            name = unknown[0]
            about = f"{specs[name].description}, {specs[name].unit} ({MEASURING_METHODS[name]}"
            answer = input(f"{about}; Enter: unknown): ")
            try:
                answers |= {name: float(answer)} if answer.strip() else {}
                unknown.pop(0)
            except ValueError:
                show(f"{printable(answer)!r} is no number")
    return answers
