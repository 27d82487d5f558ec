# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gives hostile bags to every command that takes one: part of ``make fuzz``.

A bag is hostile in one way of a family: its messages, stamps, types, topics, parameters, metadata,
records, names. Of each family some are drawn, the same for the same ``--seed``. Each command runs in a
process of its own. A finding is a traceback, an undefined exit code, a control character in the output,
more than 60 s of a processor, or more than 1 GB. To run one again:
``.venv/bin/python tests/fuzz/hostile_recordings.py 'scan=angles nan' --command report``.
"""

import argparse
import contextlib
import io
import os
import random
import re
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from child import run_in_child
from hostile_containers import FAMILIES_OF_CONTAINERS
from hostile_messages import FAMILIES_OF_MESSAGES, Made, good, write
from trackslip_tools.cli.main import main as trackslip

FAMILIES = (*FAMILIES_OF_MESSAGES, *FAMILIES_OF_CONTAINERS)
BAGS = 246
LONGEST_S = 60
MOST_MB = 1000
_PLAN = """objective: likelihood
evaluations: 20
seed: 0
parameters:
  turning.efficiency: {low: 5.0e-4, high: 0.5, scale: log}

"""
COMMANDS = {
    "info": "info BAG",
    "recover": "recover BAG --output OUT/recovered",
    "replay": "replay BAG --output OUT/estimates --json OUT/replay.json",
    "report": "report BAG --smooth --output OUT/report.html",
    "smooth": "smooth BAG --output OUT/smoothed --json OUT/smooth.json",
    "calibrate": "calibrate BAG --all --output OUT/calibration.yaml --json OUT/calibrate.json",
    "tune": "tune BAG --plan OUT/plan.yaml --output OUT/tuned --workers 1",
}


class Run(NamedTuple):
    """Result of one command with one bag."""

    bag: str
    command: str
    problem: str  # empty if none
    seconds: float  # of processor time
    megabytes: int


def main() -> int:
    """Make the bags, run the commands; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bags", type=int, default=BAGS, help="that are drawn of all (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (%(default)s)")
    parser.add_argument("--command", choices=COMMANDS, action="append", help="this one alone")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="(%(default)s)")
    parser.add_argument("names", nargs="*", metavar="REGEX", help="bags whose names it matches, all of them")
    args = parser.parse_args()
    bags = made_by_name()
    chosen = [name for name in bags if any(re.search(one, name) for one in args.names)] or drawn(
        args.bags, args.seed
    )
    commands = args.command or list(COMMANDS)
    began, runs = time.monotonic(), list[Run]()
    with ProcessPoolExecutor(
        args.workers, get_context("spawn"), initializer=_begin, initargs=(commands,)
    ) as pool:
        for done in as_completed([pool.submit(_work, name, commands) for name in chosen]):
            runs += done.result()
            for run in done.result():
                if run.problem:
                    print(f"FOUND {run.command} of '{run.bag}': {run.problem}", flush=True)
    slowest, largest = max(runs, key=lambda run: run.seconds), max(runs, key=lambda run: run.megabytes)
    wrong = [run for run in runs if run.problem]
    print(
        f"{len(chosen)} bags of {len(bags)}, {len(runs)} runs in {time.monotonic() - began:.0f} s; "
        f"{len(wrong)} found in {len({run.bag for run in wrong})} bags; "
        f"slowest {slowest.seconds:.0f} s ({slowest.command} of '{slowest.bag}'), "
        f"largest {largest.megabytes} MB ({largest.command} of '{largest.bag}')"
    )
    return int(bool(wrong))


@cache
def made_by_name() -> dict[str, Made]:
    """Every hostile bag by name."""
    return {name: made for family in FAMILIES for name, made in family()}


def drawn(count: int, seed: int) -> list[str]:
    """Names of ``count`` bags, evenly from all families while these last."""
    draw = random.Random(seed)
    by_family = [[name for name, _ in family()] for family in FAMILIES]
    for names in by_family:
        draw.shuffle(names)
    chosen: list[str] = []
    while any(by_family) and len(chosen) < count:
        for names in by_family:
            if names and len(chosen) < count:
                chosen.append(names.pop())
    return chosen


def _begin(commands: Sequence[str]) -> None:
    """In a worker: load and compile what the commands need before the children are forked."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        bag = write(good(), Path(folder))
        for command in commands:
            trackslip(_words(command, bag, Path(folder)))


def _words(command: str, bag: Path, output: Path) -> list[str]:
    (output / "plan.yaml").write_text(_PLAN, encoding="utf-8")
    words = COMMANDS[command].replace("OUT", str(output)).split()
    return [str(bag) if word == "BAG" else word for word in words]


def _work(name: str, commands: Sequence[str]) -> list[Run]:
    """Run all commands on one bag."""
    folder = Path(tempfile.mkdtemp(prefix="trackslip_hostile_"))
    try:
        (folder / "in").mkdir()
        try:
            bag = made_by_name()[name](folder / "in")
        except Exception:  # noqa: BLE001 (of this script's own code; the other bags are tried)
            return [Run(name, "making", "\n" + traceback.format_exc(), 0.0, 0)]
        return [_run(name, command, bag, folder / command) for command in commands]
    finally:
        shutil.rmtree(os.fsencode(folder), ignore_errors=True)


def _run(name: str, command: str, bag: Path, output: Path) -> Run:
    output.mkdir()
    ended = run_in_child(partial(trackslip, _words(command, bag, output)), output, LONGEST_S)
    problem = ended.problem(LONGEST_S, MOST_MB) or (ended.err if "Warning" in ended.err else "")
    return Run(name, command, problem, ended.seconds, ended.megabytes)


if __name__ == "__main__":
    sys.exit(main())
