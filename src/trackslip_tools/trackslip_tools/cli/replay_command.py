# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip replay``: runs the estimators over a bag."""

import argparse
import shlex
from pathlib import Path

from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.writer import refuse_existing
from trackslip_common.errors import ExitCode, show
from trackslip_tools.cli import fleet_command, publish, replay_options, shared_options, worker_options
from trackslip_tools.cli.elapsed import waiting_time_s
from trackslip_tools.cli.outputs import require_writable, write_json
from trackslip_tools.cli.progress import progress_bar, replay_progress
from trackslip_tools.fleet.entry import Entry, entry_of
from trackslip_tools.replay.output import replay_to_bag, summary, text
from trackslip_tools.replay.parts import Watch
from trackslip_tools.replay.result import Replay

EXAMPLE = (
    "trackslip replay out/demo/bag --withhold box_pose:10:40 --set slip_estimator.sources.box_pose.timeout=3"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    about = "rosbag2 directory (MCAP or SQLite), .mcap or .db3 file; several, or a folder: a table"
    shared_options.add_bags(parser, about)
    shared_options.add_params(parser)
    replay_options.add_options(parser)
    replay_options.add_force(parser)
    about = "write the estimates to a new bag"
    parser.add_argument("--output", metavar="BAG", type=Path, help=about)
    shared_options.add_json(parser, "the summary, of many bags a list,")
    worker_options.add_options(parser)
    publish.add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Replay, print the summary and write the outputs; or publish the bag to a live graph."""
    filters = replay_options.options_of(args).filters()  # reports errors before the work
    if fleet_command.is_fleet(args.bags):
        if not args.publish:
            publish.refuse_without_publish(args)
        return fleet_command.run(args, _bag_entry)
    refuse_existing(args.output)
    require_writable(json=args.json)
    with open_bag(args.bags[0], args.namespace) as bag:
        if args.publish:
            replay_options.note_damage(bag)
            return publish.publish(bag, filters, args)
        publish.refuse_without_publish(args)
        with progress_bar(bag.duration_s, "replaying") as advance:
            result = _replay_bag(bag, args, replay_progress(bag, advance))
    show(text(result, waiting_time_s()))
    if args.output is not None:
        show(f"estimates: {args.output}")
    if args.json is not None:
        write_json(args.json, summary(result, waiting_time_s()))
    if args.output is None and args.json is None and (command := _next_command(args, result)):
        show(f"next: trackslip {command}")
    return ExitCode.FAILED if result.has_failed(force=args.force) else ExitCode.DONE


def _next_command(args: argparse.Namespace, result: Replay) -> str:
    """The suggested next command; empty where the reason for no estimate has the remedy.

    Reports take one parameter file per run, because they compare several.
    """
    words = [str(args.bags[0]), *shared_options.next_command_options(args)]
    if not (result.setup.is_plausible or args.force):
        return shlex.join(["check", *words])
    if result.no_estimate:
        return ""
    if len(args.params) > 1:
        return f"report {shlex.quote(str(args.bags[0]))}, with --params as one file: it compares several"
    return shlex.join(["report", *words, "--output", f"{args.bags[0].stem}.html"])


def _replay_bag(bag: Bag, args: argparse.Namespace, *watches: Watch) -> Replay:
    """Replay with the options, and write ``--output`` if given."""
    replay_options.note_damage(bag)
    p, filters, reference = replay_options.read_settings(bag, replay_options.options_of(args))
    soil_p = replay_options.soil_parameters_of(bag, p, args.params, args.set)
    return replay_to_bag(args.output, bag, p, filters, reference, soil_p, *watches)


def _bag_entry(args: argparse.Namespace, path: Path) -> Entry:
    """Result of one bag of many; runs in a worker."""

    def replay_bag() -> tuple[Replay, str]:
        with open_bag(path, args.namespace) as bag:
            return _replay_bag(bag, args), ""

    return entry_of(path, replay_bag, force=args.force)
