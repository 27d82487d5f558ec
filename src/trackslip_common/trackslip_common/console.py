# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a program prints: beside a line of progress, and where stdout takes no more."""

import io
import os
import sys
from contextlib import suppress

from trackslip_common.errors import ExitCode, printable


def escape_unencodable() -> None:
    """Have stdout and stderr escape what their encoding has not, by ``LC_ALL=C`` or on an old terminal."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def clear_line() -> None:
    """Take away what stands on the line of stderr; where that is no terminal nothing does."""
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def end_of_output(program: str, error: OSError) -> ExitCode:
    """The exit code where a file or stdout failed. One line on stderr says so, but not where its reader left.

    What stays in the buffer of stdout goes nowhere: at the end, Python would fail on it again.
    """
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return ExitCode.DONE
    name = f" '{error.filename}'" if error.filename else ""
    print(printable(f"{program}: cannot read or write{name} ({error.strerror})"), file=sys.stderr)
    return ExitCode.BAD_INPUT
