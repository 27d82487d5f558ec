# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip recover``: writes a valid bag from one whose recorder was killed or whose disk failed."""

import argparse
from pathlib import Path

from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import Recovery, recover
from trackslip_bags.writer import CHUNK_SPAN_NS, refuse_existing
from trackslip_common.errors import ExitCode, show
from trackslip_tools.cli.description import describe
from trackslip_tools.cli.progress import progress_bar

EXAMPLE = "trackslip recover bags/power_cut --output out/recovered"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="bag directory, or one file of it")
    parser.add_argument(
        "--output", metavar="BAG", type=Path, help="directory to create (default: BAG_recovered)"
    )


def run(args: argparse.Namespace) -> int:
    """Recover, list the losses, and describe the new bag."""
    damaged = args.bag.resolve()
    output = args.output or damaged.with_name(f"{damaged.stem}_recovered")
    refuse_existing(output)
    with progress_bar(1.0, "recovering") as advance:
        recovery = recover(args.bag, output, advance)
    for line in _loss_lines(recovery):
        show(line)
    with open_bag(output) as bag:
        show(describe(bag))
    return ExitCode.DONE if recovery.messages or recovery.stated == 0 else ExitCode.FAILED


def _loss_lines(recovery: Recovery) -> list[str]:
    """Lines on the losses."""
    lines = list(recovery.problems)
    if recovery.lost_bytes:
        lines.append(f"lost: {recovery.lost_bytes} bytes behind the last whole chunk")
    if recovery.rejected:
        lines.append(f"lost: {recovery.rejected} messages that are not CDR, or of a topic with two types")
    if recovery.stated is not None and recovery.stated > recovery.messages:
        lines.append(f"lost: {recovery.stated - recovery.messages} of {recovery.stated} messages")
    elif recovery.truncated_files:
        span = CHUNK_SPAN_NS * 1e-9
        lines.append(f"lost: what a killed recorder had not written yet, at most {span:g} s if it was ours")
    if not recovery.messages:
        lines.append("saved: nothing")
    return lines or ["nothing was lost"]
