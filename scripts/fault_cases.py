# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``make cases``: drives with injected faults, scored beside a baseline; exit code 1 where a bar is missed.

It imports the packages of the checkout that it stands in.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), *(str(path) for path in sorted((ROOT / "src").iterdir()))]

from fixtures.fault_cases.bars import Bar, bars, timing_bars  # noqa: E402
from fixtures.fault_cases.catalogue import CATALOGUE  # noqa: E402
from fixtures.fault_cases.running import (  # noqa: E402
    BASELINE,
    named_cases,
    read_scores,
    score_cases,
    write_scores,
)
from fixtures.fault_cases.scoring import Score  # noqa: E402

from trackslip_common.errors import ExitCode  # noqa: E402

HEAD = f"{'case':54s}   RMSE m  ratio     NEES > 13.8    rad leaps     gated    µs"


def row(name: str, score: Score, before: Score | None) -> str:
    """One line of the table."""
    ratio = f"{score.rmse / before.rmse:6.2f}" if before is not None else f"{'':6s}"
    line = f"{name:54s} {score.rmse:8.3f} {ratio} {score.nees:8.1f} {score.inconsistent:6.1%}"
    line += f" {score.heading_rmse:6.3f} {score.leaps:5d}"
    line += f" {score.gated:4d}/{score.fixes:<4d} {score.cost:5.1f}"
    if score.outage_rmse is not None and score.outage_median_nees is not None:
        line += f"  outages {score.outage_rmse:.2f} m, median NEES {score.outage_median_nees:.1f}"
    if score.slip_error is not None:
        line += f"  i₀ {score.slip_error:.3f}"
    return line if score.live_equals_replay else f"{line}  one by one: other poses"


def bar_row(bar: Bar) -> str:
    """One line of a bar."""
    limits = f"≤ {bar.upper:g}" if bar.lower < 0.0 else f"{bar.lower:g} to {bar.upper:g}"
    where = f"  ({bar.where})" if bar.where else ""
    return f"{'' if bar.is_met else 'missed':6s} {bar.what:76s} {bar.value:8.3f}  {limits}{where}"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table and the bars; returns the exit code."""
    parser = argparse.ArgumentParser(prog="scripts/fault_cases.py", description=__doc__)
    parser.add_argument("--only", default="", metavar="REGEX", help="cases whose name it finds")
    parser.add_argument("--list", action="store_true", help="print the names of the cases and their groups")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the scores")
    parser.add_argument(
        "--baseline", type=Path, default=BASELINE, metavar="FILE", help="(default: %(default)s)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time (default: %(default)s)")
    arguments = list(sys.argv[1:] if argv is None else argv)
    args = parser.parse_args(arguments)
    names = named_cases(args.only)
    if args.list:
        print("\n".join(f"{name:60s} {CATALOGUE[name].group.value}" for name in names))
        return ExitCode.DONE
    baseline = read_scores(args.baseline) if args.baseline.is_file() else {}
    print(HEAD)
    scores: dict[str, Score] = {}
    for name, score in score_cases(names, args.jobs):
        scores[name] = score
        print(row(name, score, baseline.get(name)), flush=True)
    if args.json is not None:
        write_scores(args.json, scores, shlex.join(["python", "scripts/fault_cases.py", *arguments]))
    found = [*bars(scores, baseline).values(), *timing_bars(scores).values()]
    for bar in found:
        print(bar_row(bar))
    return ExitCode.DONE if all(bar.is_met for bar in found) else ExitCode.FAILED


if __name__ == "__main__":
    sys.exit(main())
