# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip import``: converts a log of another robot to a bag."""

import argparse
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trackslip_bags.importing.first_mapping import first_mapping
from trackslip_bags.importing.importer import Imported, import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.writer import refuse_existing
from trackslip_common.atomic_files import write_atomically
from trackslip_common.config_files import config_file, node_parameters, read_yaml
from trackslip_common.errors import ExitCode, InputError, collect_output, show
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.slip.parameters import NODE
from trackslip_tools.cli import replay_options, shared_options
from trackslip_tools.cli.description import describe
from trackslip_tools.cli.progress import progress_bar
from trackslip_tools.replay.no_estimate import start_setting
from trackslip_tools.terminal_text import wrap_line

_VEHICLE = "excavator_20t"

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
        help="columns and units, or topics; a path or a file of config/ (docs/import.md); "
        "none: a first one is written for a CSV log, from the names of its columns",
    )
    shared_options.add_vehicle(parser, "the mapping's")
    add("--output", metavar="BAG", type=Path, help="directory to create; needed with --mapping")


def run(args: argparse.Namespace) -> int:
    """Import a log and describe the bag; without a mapping, write a draft of one."""
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    if args.mapping is None:
        return _write_mapping(args.logs, args.vehicle, args.output)
    if args.output is None:
        raise InputError("--output is missing; accepted: a directory to create, for the bag")
    refuse_existing(args.output)
    mapping = read_mapping(config_file(args.mapping), vehicle)
    with progress_bar(None, "importing"):
        imported = import_log(args.logs, mapping, args.output)
    with open_bag(args.output) as bag:
        setup = replay_options.check_setup(bag)
        show(describe(bag))
        next_words = _next_words(bag, is_plausible=setup is None or setup.is_plausible)
    for line in _notes(imported):
        show(line)
    for line in setup.facts if setup is not None else ():
        show(wrap_line(line))
    show(f"next: trackslip {shlex.join(next_words)}")
    return ExitCode.DONE


def _next_words(bag: Bag, *, is_plausible: bool) -> list[str]:
    """The next command for a new bag: a replay that can start, or the check of a setup with a mistake."""
    if not is_plausible:
        return ["check", str(bag.path)]
    with collect_output():  # the vehicle is printed before
        setting = start_setting(bag, replay_options.parameters_of(bag))
    return ["replay", str(bag.path), *(("--set", setting) if setting else ())]


def _write_mapping(logs: Sequence[Path], vehicle: str | None, output: Path | None) -> int:
    """Write a draft mapping into the working directory, named after the log."""
    missing = next((log for log in logs if not log.exists()), None)
    if missing is not None:
        raise InputError(
            f"log '{missing}' not found; accepted: logs or their directory, or a bag; --output is the new one"
        )
    if len(logs) > 1 or not logs[0].is_file():
        raise InputError(
            f"--mapping is missing for {logs[0]}; only one CSV log can do without, or the first part of one"
        )
    (log,) = logs
    path = Path(f"{log.stem}_mapping.yaml")
    bag = str(output or f"{log.stem}_bag")
    import_command = shlex.join(["trackslip", "import", str(log), "--mapping", str(path), "--output", bag])
    if path.exists():
        raise InputError(f"'{path}' exists; accepted: {import_command}")
    draft = first_mapping(log, vehicle or _VEHICLE, _priors(vehicle))
    write_atomically(path, draft.text)
    for field, column in draft.columns.items():
        show(f"found: {field}: {column}")
    for line in draft.guessed:
        show(f"guessed: {line}")
    for name in draft.unused:
        show(f"not used: {name}")
    if vehicle is None:
        show(f"guessed: vehicle: {_VEHICLE}; trackslip vehicle new writes a file of yours, for --vehicle")
    show(f"mapping: {path}; correct it where it is wrong")
    show(f"next: {import_command}")
    return ExitCode.DONE


def _priors(vehicle: str | None) -> dict[str, Any]:
    """Parameters of the slip estimator that ``trackslip vehicle new`` wrote beside the vehicle's file."""
    if vehicle is None:
        return {}
    path = Path(vehicle)
    priors = path.with_name(f"{path.stem}_estimator.yaml")
    return node_parameters(read_yaml(priors), NODE, str(priors)) if priors.is_file() else {}


def _notes(imported: Imported) -> Iterator[str]:
    """Lines on the import for the user."""
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
