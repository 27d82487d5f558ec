# SPDX-License-Identifier: Apache-2.0
"""``trackslip import``: a CSV log becomes a bag."""

import argparse
from dataclasses import replace
from pathlib import Path

from trackslip_bags.importing.importer import import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.info import describe
from trackslip_bags.reader import open_bag
from trackslip_common.config_files import config_file
from trackslip_common.errors import ExitCode
from trackslip_common.vehicle import load_vehicle
from trackslip_tools.cli import machine_options

EXAMPLE = "trackslip import field_log.csv --mapping mappings/warthog.yaml --output out/field_log"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("log", metavar="CSV", type=Path, help="comma-separated, names in the first line")
    parser.add_argument(
        "--mapping",
        metavar="YAML",
        required=True,
        help="columns, units and vehicle; a path or a file of config/",
    )
    machine_options.add_vehicle(parser, "the mapping's")
    parser.add_argument("--output", metavar="BAG", type=Path, required=True, help="directory to create")


def run(args: argparse.Namespace) -> int:
    """Import and show what the bag holds.

    Raises:
        InputError: the log, the mapping or the output cannot be used.
    """
    mapping = read_mapping(config_file(args.mapping))
    if args.vehicle is not None:
        mapping = replace(mapping, vehicle=load_vehicle(args.vehicle))
    imported = import_log(args.log, mapping, args.output)
    with open_bag(args.output) as bag:
        print(describe(bag))
    for topic, count in imported.left_out.items():
        print(f"left out: {count} of {topic}, which time_offset moves to before 0 s")
    return ExitCode.DONE
