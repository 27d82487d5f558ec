# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip study``: repeats chapter 6 of the thesis and computes errors, bounds and consistency."""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from trackslip_common.errors import ExitCode, InputError
from trackslip_common.vehicle_files import DEFAULT_VEHICLE, load_vehicle
from trackslip_estimation.slip.parameters import NODE
from trackslip_sim.study.engine import TABLE_HEADER, Study
from trackslip_sim.study.slip.parameters import FILTERS, TRUTHS
from trackslip_sim.study.slip.study import SlipStudy
from trackslip_sim.study.soil.study import SoilStudy
from trackslip_tools.cli import shared_options, worker_options
from trackslip_tools.cli.elapsed import waiting_time_s
from trackslip_tools.cli.outputs import (
    PNG_PREFIX,
    make_folder,
    refuse_foreign_file,
    require_writable,
    write_json,
)
from trackslip_tools.cli.progress import iterate_with_bar
from trackslip_tools.terminal_text import format_for_terminal

EXAMPLE = (
    "trackslip study --soil sand dry_clay --filter ekf --sigma-xy 0.01 0.05 --seeds 100 --json study.json"
)


_STUDIES: Mapping[str, type[Study[Any, Any]]] = MappingProxyType({"slip": SlipStudy, "soil": SoilStudy})
_OPTIONS = sorted({option for study in _STUDIES.values() for option in study.PARAMETERS})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``trackslip study``; their defaults are in ``config/study.yaml``."""
    add = parser.add_argument
    add("--estimator", choices=tuple(_STUDIES), default="slip", help="which one (default: %(default)s)")
    add("--truth", nargs="+", choices=TRUTHS, help="slip: shearing soil, or the filter's own model")
    add("--soil", nargs="+", metavar="S", help="names in config/soils.yaml")
    add("--filter", nargs="+", choices=FILTERS, help="slip: which filters")
    add("--drawn", action="store_const", const=True, help="soil: also machines drawn about the nominal one")
    add("--sigma-xy", nargs="+", type=float, metavar="M", help="noise of the fixes' x and y, m")
    add("--sigma-omega", nargs="+", type=float, metavar="W", help="slip: noise of the gyro, rad/s")
    add("--sigma-heading", type=float, metavar="A", help="noise of the fixes' heading, rad")
    add("--seeds", type=int, metavar="N", help="runs of each cell")
    add("--scenario", nargs="+", metavar="NAME|FILE", help="scenarios to drive; slip: one")
    add("--terrain", nargs="+", metavar="NAME|FILE", help="terrains to drive on; default: the scenario's own")
    shared_options.add_vehicle(parser, "none")
    add("--duration", type=float, metavar="S", help="the scenario repeated or cut to S seconds")
    add("--settling", type=float, metavar="S", help="slip: seconds at the start that are not scored")
    shared_options.add_set(parser, "one of the estimator's")
    worker_options.add_options(parser)
    add(
        "--cache",
        type=Path,
        metavar="FILE",
        default=_cache_file(),
        help="file of the finished pieces (%(default)s)",
    )
    add("--fresh", action="store_true", help="compute also what is in the cache")
    add(
        "--output",
        type=Path,
        metavar="DIR",
        help="write study_table.md and figures/, or soil_table.md, there",
    )
    shared_options.add_json(parser, "the rows")


def run(args: argparse.Namespace) -> int:
    """Run the study, print its table, write the requested files; returns the exit code."""
    study = _make_study(args)
    _check_outputs(args, study.files())
    workers = partial(worker_options.requested_workers, args, most=len(study))
    running = study.run(args.cache, workers, fresh=args.fresh)
    rows = study.rows(list(iterate_with_bar(running, study.UNIT, total=len(study))))
    vehicle = load_vehicle(args.vehicle or DEFAULT_VEHICLE)
    print(f"vehicle: {vehicle.name}\n\n{format_for_terminal(study.markdown(rows))}", end="")
    print(f"\n{len(study)} {study.UNIT} in {waiting_time_s():.1f} s")
    if args.json is not None:
        write_json(args.json, [asdict(row) for row in rows])
    if args.output is not None:
        study.write(rows, args.output)
    return ExitCode.DONE


def _make_study(args: argparse.Namespace) -> Study[Any, Any]:
    """The study with the options of the command; ``InputError`` for an option that it does not have."""
    kind = _STUDIES[args.estimator]
    values = {option: value for option in _OPTIONS if (value := getattr(args, option)) is not None}
    for option in values.keys() - kind.PARAMETERS.keys():
        raise InputError(f"--{option.replace('_', '-')}: does not go with --estimator {args.estimator}")
    vehicle = [f"{NODE}.vehicle={args.vehicle}"] if args.vehicle else []
    return kind({kind.PARAMETERS[option]: value for option, value in values.items()}, [*vehicle, *args.set])


def _cache_file() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trackslip" / "study.jsonl"


def _check_outputs(args: argparse.Namespace, names: Sequence[str]) -> None:
    """Refuse, before the study runs, output files that cannot be written or belong to another program."""
    require_writable(json=args.json)
    files = [] if args.output is None else [args.output / name for name in names]
    for file in files:
        refuse_foreign_file("output", file, PNG_PREFIX if file.suffix == ".png" else TABLE_HEADER)
    for file in files:
        make_folder("output", file.parent)
        require_writable(output=file)
