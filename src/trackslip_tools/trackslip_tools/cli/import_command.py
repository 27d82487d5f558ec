# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip import``: a log of another robot becomes a bag."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from trackslip_bags.importing.importer import Imported, import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.input_filters import relative
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.writer import refuse_existing
from trackslip_common.config_files import config_file
from trackslip_common.errors import ExitCode, collected, show
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.setup_check.finding import Result
from trackslip_tools.check.bag import check_bag
from trackslip_tools.check.text import finding
from trackslip_tools.cli import machine_options, replay_options
from trackslip_tools.cli.description import describe
from trackslip_tools.cli.progress import counted
from trackslip_tools.replay.inputs import SPROCKETS
from trackslip_tools.terminal_text import wrapped

EXAMPLE = "trackslip import field_log.csv --mapping mappings/warthog.yaml --output out/field_log"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add = parser.add_argument
    add(
        "logs",
        metavar="LOG",
        type=Path,
        nargs="+",
        help="CSV files, logs of a CAN bus or GNSS receiver, or a directory of them; or a bag",
    )
    add(
        "--mapping",
        metavar="YAML",
        required=True,
        help="columns and units, or topics; a path or a file of config/ (docs/import.md)",
    )
    machine_options.add_vehicle(parser, "the mapping's")
    add("--output", metavar="BAG", type=Path, required=True, help="directory to create")


def run(args: argparse.Namespace) -> int:
    """Import and show what the bag holds.

    Raises:
        InputError: the log, the mapping or the output cannot be used.
    """
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    refuse_existing(args.output)
    mapping = read_mapping(config_file(args.mapping), vehicle)
    with counted(None, "importing"):
        imported = import_log(args.logs, mapping, args.output)
    with open_bag(args.output) as bag:
        setup = _check(bag)
        if setup is not None:
            show(finding(setup))
        show(describe(bag))
    for line in _notes(imported):
        show(line)
    for line in setup.facts if setup is not None else ():
        show(wrapped(line))
    show(f"next: trackslip {'replay' if setup is None or setup.is_plausible else 'check'} {args.output}")
    return ExitCode.DONE


def _check(bag: Bag) -> Result | None:
    """Of what was imported; None where it has no tracks."""
    if not any(relative(topic) == SPROCKETS for topic in bag.topics):
        return None
    with collected():  # which vehicle it is stands in the list of topics
        p = replay_options.parameters_of(bag, [], [])
    return check_bag(bag, p)


def _notes(imported: Imported) -> Iterator[str]:
    """What a user must know of it."""
    if imported.datum is not None:
        latitude, longitude, altitude = imported.datum
        yield f"datum: latitude {latitude:.9f}, longitude {longitude:.9f} deg, altitude {altitude:.3f} m"
    for topic, late in imported.lateness.items():
        yield f"late: {topic} came {late.median:.3f} s after its stamps, at most {late.longest:.3f} s"
        if late.is_other_clock:
            yield f"note: stamps of {topic} and the log are of different clocks (stamp: log, or time_offset)"
    for topic, reasons in imported.left_out.items():
        for reason, count in reasons.items():
            yield f"left out: {count} of {topic}: {reason}"
    for note in imported.notes:
        yield f"note: {note}"
