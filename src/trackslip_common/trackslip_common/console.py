# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Output of programs: beside a progress line, and after a failure of stdout."""

import io
import os
import sys
from contextlib import suppress

from trackslip_common.errors import ExitCode, printable


def escape_unencodable() -> None:
    """Make stdout and stderr escape characters that their encoding lacks (``LC_ALL=C``, old terminals)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def clear_line() -> None:
    """Clear the present line of stderr, if that is a terminal."""
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def report_output_failure(program: str, error: OSError) -> ExitCode:
    """The exit code after a failure of a file or stdout; prints one line, unless stdout's reader has left.

    The buffer of stdout is discarded, as Python would fail on it again at its end.
    """
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return ExitCode.DONE
    name = f" '{error.filename}'" if error.filename else ""
    print(printable(f"{program}: cannot read or write{name} ({error.strerror})"), file=sys.stderr)
    return ExitCode.BAD_INPUT
