# SPDX-License-Identifier: Apache-2.0
"""``trackslip study``: chapter 6 of the thesis again, with numbers: errors, bounds, honesty."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from trackslip_common.errors import ExitCode, InputError
from trackslip_estimation.cli.json_file import write_json
from trackslip_estimation.cli.progress import shown
from trackslip_estimation.cli.replay_options import parse_set
from trackslip_estimation.slip_parameters import load_slip_parameters
from trackslip_sim.study.cache import Cache
from trackslip_sim.study.parameters import FILTERS, TRUTHS, StudyParameters, cells, load_study_parameters
from trackslip_sim.study.results import Row
from trackslip_sim.study.run import run_study
from trackslip_sim.study.table import markdown

DESCRIPTION = (
    "Filter many simulated drives, and hold the errors against the least possible (config/study.yaml)."
)
EXAMPLE = (
    "trackslip study --soil sand dry_clay --filter ekf --sigma-xy 0.01 0.05 --seeds 100 --json study.json"
)

_PARAMETERS = {"truth": "truths", "soil": "soils", "filter": "filters"} | {
    name: name
    for name in (
        *("sigma_xy", "sigma_omega", "sigma_heading"),
        *("seeds", "scenario", "duration", "settling"),
    )
}  # option → parameter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``trackslip study``; what is not given is in ``config/study.yaml``."""
    add = parser.add_argument
    add("--truth", nargs="+", choices=TRUTHS, help="shearing soil, or the filter's own model")
    add("--soil", nargs="+", metavar="S", help="names in config/soils.yaml")
    add("--filter", nargs="+", choices=FILTERS)
    add("--sigma-xy", nargs="+", type=float, metavar="M", help="noise of the fixes' x and y, m")
    add("--sigma-omega", nargs="+", type=float, metavar="W", help="noise of the gyro, rad/s")
    add("--sigma-heading", type=float, metavar="A", help="noise of the fixes' heading, rad")
    add("--seeds", type=int, metavar="N", help="runs of each cell")
    add("--scenario", metavar="NAME|FILE", help="what is driven")
    add("--duration", type=float, metavar="S", help="the scenario repeated or cut to S seconds")
    add("--settling", type=float, metavar="S", help="seconds at the start that are not scored")
    add("--set", metavar="node.param=value", action="append", default=[], help="one of slip_estimator's")
    add("--jobs", type=_whole, metavar="N", default=os.cpu_count(), help="threads; default: one per core")
    add("--cache", type=Path, metavar="FILE", default=_cache_file(), help="finished cells (%(default)s)")
    add("--fresh", action="store_true", help="compute also what is in the cache")
    add("--output", type=Path, metavar="DIR", help="write study_table.md and figures/study_*.png there")
    add("--json", type=Path, metavar="FILE", help="write the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the study, print its table, write what was asked for; returns the exit code.

    Raises:
        InputError: an option is refused, or a file cannot be written.
    """
    p = _parameters(args)
    estimator = load_slip_parameters(dict(map(parse_set, args.set)))
    _prepare(args)
    running = run_study(p, estimator, Cache(args.cache, args.fresh), args.jobs)
    rows = list(shown(running, "cells", total=len(list(cells(p)))))
    print(markdown(rows), end="")
    if args.json is not None:
        write_json(args.json, [asdict(row) for row in rows])
    if args.output is not None:
        _write_output(args.output, rows)
    return ExitCode.DONE


def _write_output(folder: Path, rows: Sequence[Row]) -> None:
    """``study_table.md``, and in ``figures`` what the Monte Carlo says."""
    from trackslip_sim.study.figures import write_monte_carlo  # matplotlib: not for every command's start

    (folder / "study_table.md").write_text(markdown(rows), encoding="utf-8")
    write_monte_carlo(rows, folder / "figures")


def _parameters(args: argparse.Namespace) -> StudyParameters:
    given = {parameter: getattr(args, option) for option, parameter in _PARAMETERS.items()}
    return load_study_parameters({name: value for name, value in given.items() if value is not None})


def _whole(text: str) -> int:
    """A number of threads."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is refused; accepted: a whole number >= 1")
    return int(text)


def _cache_file() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trackslip" / "study.jsonl"


def _prepare(args: argparse.Namespace) -> None:
    """Refuse before the study what cannot be written after it."""
    if args.json is not None and not args.json.parent.is_dir():
        raise InputError(f"--json: '{args.json}' cannot be written (no such folder: {args.json.parent})")
    if args.output is not None:
        try:
            (args.output / "figures").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--output: '{args.output}' cannot be used ({error.strerror})") from error
