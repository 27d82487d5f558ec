# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of a log on a terminal on which a line of progress stands."""

import sys


def clear_line() -> None:
    """Take away what stands on the line of stderr; where that is no terminal nothing does."""
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
