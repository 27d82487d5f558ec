# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip replay`` and ``report`` over many bags: one piece of work per bag, one table of all."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from trackslip_common.errors import InputError, show
from trackslip_tools.cli import worker_options
from trackslip_tools.cli.elapsed import waiting_time_s
from trackslip_tools.cli.outputs import require_writable, write_json
from trackslip_tools.cli.progress import iterate_with_bar
from trackslip_tools.fleet.entry import Entry, exit_code
from trackslip_tools.fleet.find import find_bags, is_folder
from trackslip_tools.fleet.table import notes, text

_SINGLE_BAG_OPTIONS = ("output", "publish")  # replay options for a single bag


def is_fleet(paths: Sequence[Path]) -> bool:
    """Whether several bags or a folder of bags are named."""
    return len(paths) > 1 or is_folder(paths[0])


def run(args: argparse.Namespace, one: Callable[[argparse.Namespace, Path], Entry]) -> int:
    """Replay all bags, print their table, write ``--json``; returns the worst exit code.

    Raises:
        InputError: an option or the workers cannot be used.
    """
    for option in _SINGLE_BAG_OPTIONS:
        if getattr(args, option):
            raise InputError(f"--{option}: not with several bags; accepted: one bag")
    require_writable(json=args.json)
    entries = process_bags(args, one)
    if args.json is not None:
        write_json(args.json, [entry.as_dict() for entry in entries])
    return exit_code(entries)


def process_bags(args: argparse.Namespace, one: Callable[[argparse.Namespace, Path], Entry]) -> list[Entry]:
    """Results of the bags that ``args`` name, in order; prints their table."""
    bags = find_bags(args.bags)
    with worker_options.requested_workers(args, shared=args, most=len(bags)) as map_items:
        entries = list(iterate_with_bar(map_items(one, bags), f"{len(bags)} bags", total=len(bags)))
    for note in notes(entries):
        show(note, file=sys.stderr)
    show(text(entries))
    total_s = sum(entry.summary.get("duration_s", 0.0) for entry in entries)
    show(f"{len(bags)} bags, {total_s:.0f} s, in {waiting_time_s():.1f} s")
    return entries
