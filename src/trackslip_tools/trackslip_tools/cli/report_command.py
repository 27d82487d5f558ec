# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip report``: one HTML page about one run, or several side by side."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag, open_bag
from trackslip_common.arrays import Rows
from trackslip_common.errors import ExitCode, InputError, show
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ESTIMATE
from trackslip_tools.check.bag import setup_summary
from trackslip_tools.cli import fleet_command, replay_options, shared_options, worker_options
from trackslip_tools.cli.outputs import (
    PAGE_PREFIX,
    make_folder,
    refuse_foreign_file,
    require_writable,
    write_file,
)
from trackslip_tools.cli.progress import progress_bar, replay_progress, scale_progress
from trackslip_tools.fleet.entry import Entry, entry_of, exit_code
from trackslip_tools.fleet.find import is_folder, short_names
from trackslip_tools.fleet.pages import INDEX, write_pages
from trackslip_tools.replay.growing import MOST_DRAWN, GrowingRows
from trackslip_tools.replay.parts import Watch, combine_watches
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.run import replay
from trackslip_tools.report.details import Details
from trackslip_tools.report.panel import MOST_RUNS
from trackslip_tools.report.recording import Recording, read_recording
from trackslip_tools.report.run import Run
from trackslip_tools.report.verdict import VerdictLimits, load_limits
from trackslip_tools.smoothing.smooth_bag import smooth_bag

EXAMPLE = "trackslip report out/demo/bag --params own --params tuned.yaml --output report.html"

_OWN_PARAMETERS = "own"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add = parser.add_argument
    shared_options.add_bags(parser, "several are compared; of a folder, each has a page")
    add(
        "--params",
        metavar="FILE",
        action="append",
        help="ROS parameter file over the bag's own; several are compared, "
        f"'{_OWN_PARAMETERS}' stands for no file",
    )
    replay_options.add_options(parser)
    replay_options.add_force(parser)
    add("--smooth", action="store_true", help="show beside each estimate what the smoother makes of it")
    add("--limits", metavar="FILE", action="append", help="limits of the verdict over config/report.yaml")
    add(
        "--output",
        metavar="HTML",
        type=Path,
        required=True,
        help="file to write; for a folder of bags, a folder of pages with an index.html",
    )
    worker_options.add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Replay, write the page, and print its path."""
    replay_options.options_of(args).filters()  # reports errors before the work, as for the limits
    limits = load_limits(args.limits or ())
    files = args.params or [_OWN_PARAMETERS]
    if any(map(is_folder, args.bags)):
        return _write_folder(args, files)
    count = len(args.bags) * len(files)
    if count > MOST_RUNS:
        raise InputError(f"{count} runs (bags × --params) in one report; accepted: at most {MOST_RUNS}")
    several = (len(args.bags) > 1, len(files) > 1)
    pairs = [(path, name) for path in args.bags for name in files]
    short = short_names(args.bags) if len(set(args.bags)) > 1 else [str(path) for path in args.bags]
    names = dict(zip(args.bags, short, strict=True))
    recordings: dict[Path, Recording] = {}
    runs = []
    require_writable(output=args.output)
    refuse_foreign_file("output", args.output, PAGE_PREFIX)
    with progress_bar(len(pairs), "replaying") as advance:
        for path, name in pairs:
            label = _run_label(names[path], name, *several)
            with open_bag(path, args.namespace) as bag:
                watch = replay_progress(bag, scale_progress(advance, bag.duration_s))
                runs.append(_replay_run(args, bag, name, recordings.get(path), label, watch))
            recordings[path] = runs[-1].recording
    page = _render_page(runs, limits)
    write_file("output", args.output, page)
    for one in runs:
        show((f"{one.label}: " if len(runs) > 1 else "") + setup_summary(one.replay.setup))
    show(f"report: {args.output} ({len(page) / 1e6:.1f} MB)")
    return ExitCode.FAILED if all(one.replay.has_failed(force=args.force) for one in runs) else ExitCode.DONE


def _replay_run(
    args: argparse.Namespace, bag: Bag, name: str, recording: Recording | None, label: str, *further: Watch
) -> Run:
    """Run over a bag with a parameter file; ``recording``: contents of the bag, if already read."""
    files = [] if name == _OWN_PARAMETERS else [name]
    options = replace(replay_options.options_of(args), params=files)
    p, filters, reference = replay_options.read_settings(bag, options)
    soil_p = replay_options.soil_parameters_of(bag, p, files, args.set)
    recording = recording or read_recording(bag, filters, args.namespace)
    details = Details()
    result = replay(bag, p, filters, reference, soil_p, combine_watches(details.add, *further))
    smoothed = _smoothed_estimates(bag, p, filters) if args.smooth else None
    return Run(label, recording, p, filters, result, details, smoothed)


def _write_folder(args: argparse.Namespace, files: Sequence[str]) -> int:
    """Write a page of each bag, and an index."""
    if len(files) > 1:
        raise InputError(f"--params {files[1]}: one too many; accepted: one for a folder of bags")
    make_folder("output", args.output)
    for page in args.output.glob("*.html"):
        if page.name == INDEX or page.stem.isdecimal():
            refuse_foreign_file("output", page, PAGE_PREFIX)
    entries = fleet_command.process_bags(args, _bag_entry)
    write_pages(entries, args.output)
    show(f"report: {args.output / INDEX}")
    return exit_code(entries)


def _bag_entry(args: argparse.Namespace, path: Path) -> Entry:
    """Result of one bag of many; runs in a worker."""

    def replay_bag() -> tuple[Replay, str]:
        (name,) = args.params or [_OWN_PARAMETERS]
        with open_bag(path, args.namespace) as bag:
            one = _replay_run(args, bag, name, None, path.name)
        return one.replay, _render_page([one], load_limits(args.limits or ()))

    return entry_of(path, replay_bag, force=args.force)


def _smoothed_estimates(bag: Bag, p: SlipEstimatorParameters, filters: InputFilters) -> Rows:
    """(n,) ESTIMATE of the smoother."""
    smoothed = GrowingRows(ESTIMATE, MOST_DRAWN)
    smooth_bag(bag, p, filters, None, lambda block: smoothed.add(block.smoothed))
    return smoothed.rows()


def _run_label(bag: str, name: str, bags: bool, files: bool) -> str:
    """Label that distinguishes this run from the others."""
    if files and not bags:
        return name
    return bag if name == _OWN_PARAMETERS and not files else f"{bag}, {name}"


def _render_page(runs: Sequence[Run], limits: VerdictLimits) -> str:
    from trackslip_tools.report.page import render  # Bokeh takes half a second

    with np.errstate(over="ignore", invalid="ignore"):  # recorded numbers may be of any size
        return render(runs, limits)
