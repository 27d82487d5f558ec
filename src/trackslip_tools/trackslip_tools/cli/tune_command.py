# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip tune``: the parameters with which the estimator explains recorded drives best."""

import argparse
import sys
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from trackslip_bags.reader import open_bag
from trackslip_common.config_files import config_file
from trackslip_common.errors import ExitCode, InputError, show
from trackslip_tools.check.bag import check_bag, setup_summary
from trackslip_tools.cli import replay_options, shared_options, worker_options
from trackslip_tools.cli.elapsed import waiting_time_s
from trackslip_tools.cli.outputs import refuse_foreign_file, write_json
from trackslip_tools.cli.progress import iterate_with_bar, progress_bar
from trackslip_tools.fleet.find import find_bags
from trackslip_tools.result_cache import ResultCache
from trackslip_tools.terminal_text import format_for_terminal
from trackslip_tools.tuning.evidence import (
    FILE_PREFIXES,
    JOURNAL,
    NUMBERS,
    PARAMETERS,
    numbers,
    table,
    write_evidence,
)
from trackslip_tools.tuning.plan import LIKELIHOOD, read_plan
from trackslip_tools.tuning.task import Score, Task, read_task, score_of
from trackslip_tools.tuning.tuner import Tuner

EXAMPLE = "trackslip tune bags/slalom_sand bags/outage_sandy_loam --plan tune.yaml --output out/tuned"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add = parser.add_argument
    shared_options.add_bags(parser, "rosbag2 directory, .mcap or .db3 file, or a folder of them")
    add("--plan", metavar="FILE", default="tune.yaml", help="what is tuned, within which bounds, for what")
    add(
        "--output",
        metavar="DIR",
        type=Path,
        required=True,
        help=f"gets {PARAMETERS}, the evidence, and the journal from which an interrupted run goes on",
    )
    add("--params", metavar="FILE", action="append", default=[], help="ROS parameter file over the bag's own")
    replay_options.add_options(parser)
    worker_options.add_options(parser)
    add("--no-cross-validation", action="store_true", help="do not tune again without each bag in turn")


def run(args: argparse.Namespace) -> int:
    """Tune, print the evidence, and write it."""
    plan = read_plan(config_file(args.plan))
    for name, beginning in FILE_PREFIXES.items():
        refuse_foreign_file("output", args.output / name, beginning)
    bags = find_bags(args.bags)
    needs_reference = plan.settings.objective != LIKELIHOOD
    tasks, mistaken = [], []
    for bag in iterate_with_bar(bags, "reading"):
        task, is_plausible = _load_task(bag, args, needs_reference=needs_reference)
        tasks.append(task)
        mistaken += [] if is_plausible else [task.name]
    cross_validate = not args.no_cross_validation and len(tasks) > 1
    sets = plan.settings.evaluations * (1 + len(tasks) * cross_validate)
    with ExitStack() as stack:
        map_items = stack.enter_context(worker_options.requested_workers(args, shared=tasks))
        journal = ResultCache(args.output / JOURNAL, Score, "--output")
        if journal:
            note = f"{args.output / JOURNAL} holds {len(journal)} scores; going on"
            show(f"note: {note} with those of these bags and parameters", file=sys.stderr)
        advance = stack.enter_context(progress_bar(sets, "tuning"))
        tuner = Tuner(plan, tasks, partial(map_items, score_of), journal, advance)
        tuning = replace(tuner.run(cross_validate), mistaken=tuple(mistaken))
    write_evidence(args.output, tuning, tasks[0].p)
    write_json(args.output / NUMBERS, numbers(tuning))
    show(format_for_terminal(table(tuning)))
    show(f"\ntuned in {waiting_time_s():.1f} s")
    show(f"parameters: {args.output / PARAMETERS}")
    return ExitCode.DONE if tuning.improves_unseen and not mistaken else ExitCode.FAILED


def _load_task(path: Path, args: argparse.Namespace, *, needs_reference: bool) -> tuple[Task, bool]:
    """A bag's task, and whether its setup is plausible."""
    with open_bag(path, args.namespace) as bag:
        replay_options.note_damage(bag)
        p, filters, reference = replay_options.read_settings(bag, replay_options.options_of(args))
        setup = check_bag(bag, p, filters)
        show(("" if setup.is_plausible else f"{path}: ") + setup_summary(setup), file=sys.stderr)
        if not setup.facts:
            raise InputError(f"bag '{path}': the tracks do not move, or have no speeds; accepted: drives")
        task = read_task(bag, p, filters, reference, needs_reference=needs_reference)
        return task, setup.is_plausible
