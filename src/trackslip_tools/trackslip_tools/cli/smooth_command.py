# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip smooth``: smoothed estimates of a bag, each from the measurements before and after it."""

import argparse
import shlex
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

from trackslip_bags.reader import open_bag
from trackslip_bags.writer import refuse_existing
from trackslip_common.errors import ExitCode, show
from trackslip_tools.cli import replay_options, shared_options
from trackslip_tools.cli.elapsed import waiting_time_s
from trackslip_tools.cli.outputs import require_writable, write_json
from trackslip_tools.cli.progress import progress_bar
from trackslip_tools.replay.no_estimate import start_setting
from trackslip_tools.smoothing.smooth_bag import SmoothedWriter, smooth_bag
from trackslip_tools.smoothing.smoothing import Smoothed

EXAMPLE = "trackslip smooth out/demo/bag --withhold box_pose:20:30 --output out/smoothed"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    shared_options.add_bag(parser)
    shared_options.add_params(parser)
    replay_options.add_options(parser)
    about = "write smoothed/odometry and smoothed/track_slip there"
    parser.add_argument("--output", metavar="BAG", type=Path, help=about)
    shared_options.add_json(parser, "the errors of filter and smoother")


def run(args: argparse.Namespace) -> int:
    """Smooth, print the errors, and write the outputs."""
    options = replay_options.options_of(args)
    options.filters()  # reports errors before the work
    refuse_existing(args.output)
    require_writable(json=args.json)
    with open_bag(args.bag, args.namespace) as bag:
        replay_options.note_damage(bag)
        p, filters, reference = replay_options.read_settings(bag, options)
        written = SmoothedWriter(args.output, p) if args.output else nullcontext()
        with written as writer, progress_bar(bag.duration_s, "smoothing") as advance:
            result = smooth_bag(bag, p, filters, reference, _watch(writer, advance))
        setting = start_setting(bag, p)
    show(result.text(waiting_time_s()))
    if setting:
        words = [str(args.bag), *shared_options.next_command_options(args), "--set", setting]
        show(f"next: trackslip smooth {shlex.join(words)}")
    if args.output is not None:
        show(f"smoothed: {args.output}")
    if args.json is not None:
        write_json(args.json, result.summary())
    return ExitCode.DONE if result.estimates else ExitCode.FAILED


def _watch(writer: SmoothedWriter | None, advance: Callable[[float], None]) -> Callable[[Smoothed], None]:
    """Watch that writes each block, with a ``writer``, and advances the bar."""

    def watch(block: Smoothed) -> None:
        if writer is not None:
            writer.add(block)
        stamps_ns = block.smoothed["stamp_ns"]
        advance(float(stamps_ns[-1] - stamps_ns[0]) * 1e-9)

    return watch
