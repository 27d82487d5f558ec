# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip check``: finds the setup mistake that explains contradictions between the sensors of a bag."""

import argparse
import shlex

from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode, show
from trackslip_tools.check.bag import check_bag, remedy_settings, setup_report
from trackslip_tools.cli import replay_options, shared_options
from trackslip_tools.cli.outputs import require_writable, write_json
from trackslip_tools.cli.progress import progress_bar
from trackslip_tools.replay.no_estimate import start_setting

EXAMPLE = "trackslip check out/demo/bag --json check.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    shared_options.add_bag(parser)
    shared_options.add_params(parser)
    shared_options.add_set(parser)
    shared_options.add_vehicle(parser, "the bag's")
    shared_options.add_namespace(parser)
    shared_options.add_json(parser, "what was found")


def run(args: argparse.Namespace) -> int:
    """Check and print the result; exit code 1 if a cause was found."""
    require_writable(json=args.json)
    with open_bag(args.bag, args.namespace) as bag:
        replay_options.note_damage(bag)
        p = replay_options.parameters_of(bag, args.params, args.set, args.vehicle)
        with progress_bar(bag.duration_s, "checking") as advance:
            result = check_bag(bag, p, advance=advance)
        settings = [*remedy_settings(result), *filter(None, [start_setting(bag, p)])]
    show(setup_report(result))
    if args.json is not None:
        write_json(args.json, result.as_dict())
    elif result.is_plausible or remedy_settings(result):
        remedies = [word for setting in settings for word in ("--set", setting)]
        words = [str(args.bag), *shared_options.next_command_options(args), *remedies]
        show(f"next: trackslip replay {shlex.join(words)}")
    return ExitCode.DONE if result.is_plausible else ExitCode.FAILED
