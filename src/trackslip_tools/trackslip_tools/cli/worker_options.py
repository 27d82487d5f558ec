# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``--workers`` and ``--scheduler``: the workers of a command over many bags."""

import argparse
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trackslip_tools.workers import Map


_MAX_PER_CORE = 4  # processes; more take memory, some 200 MB each, without being faster
_MAX_DIGITS = 12


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare both."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--workers", metavar="N", type=_parse_count, help="processes at a time (default: one per core)"
    )
    group.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="the workers of this Dask scheduler instead, which is trusted with code",
    )


def requested_workers(
    args: argparse.Namespace, shared: Any = None, most: int | None = None
) -> AbstractContextManager["Map"]:
    """Context of the requested workers; ``most``: largest number of them that have work."""
    from trackslip_tools.workers import core_count, open_workers  # takes a twentieth of a replay of one bag

    count = args.workers or core_count()
    return open_workers(count if most is None else min(count, most), args.scheduler, shared)


def _parse_count(text: str) -> int:
    from trackslip_tools.workers import core_count

    most = _MAX_PER_CORE * core_count()
    if not text.isdecimal() or len(text) > _MAX_DIGITS or not 1 <= int(text) <= most:
        shown = text if len(text) <= _MAX_DIGITS else f"{text[:_MAX_DIGITS]}…"
        accepted = f"a whole number from 1 to {most}, {_MAX_PER_CORE} for each core"
        raise argparse.ArgumentTypeError(f"'{shown}' is refused; accepted: {accepted}")
    return int(text)
