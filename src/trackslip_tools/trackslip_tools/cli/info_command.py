# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip info``: what a bag holds."""

import argparse

from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode, show
from trackslip_tools.cli import shared_options
from trackslip_tools.cli.description import describe

EXAMPLE = "trackslip info out/demo/bag"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    shared_options.add_bag(parser)
    shared_options.add_namespace(parser)


def run(args: argparse.Namespace) -> int:
    """Print the table."""
    with open_bag(args.bag, args.namespace) as bag:
        show(describe(bag))
    return ExitCode.DONE
