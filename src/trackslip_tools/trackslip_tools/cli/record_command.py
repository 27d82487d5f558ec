# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip record``: the recorder, with its parameters as options."""

import argparse

from trackslip_tools.cli.nodes import run_node, shorten_logs

EXAMPLE = "trackslip record --output runs/field_3 --more-topics '/gnss.*' --split-duration 600"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments; defaults are in ``record.yaml``."""
    add = parser.add_argument
    add("--output", metavar="BAG", help="directory to create (default: trackslip_<date>_<time>)")
    add("--more-topics", metavar="REGEX", help="record topics whose whole name matches, too")
    add("--split-size", metavar="B", type=int, help="begin another file at this size; 0: never")
    add("--split-duration", metavar="S", type=float, help="begin another file after this time; 0: never")
    add(
        "--max-disk",
        metavar="B",
        type=int,
        help="remove the oldest recordings beside it beyond this; 0: never",
    )


def run(args: argparse.Namespace) -> int:
    """Run the node until it ends; returns its exit code."""
    names = ("output", "more_topics", "split_size", "split_duration", "max_disk")
    options = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    shorten_logs()
    return run_node("trackslip_bags.nodes.record", "record", options)
