# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What Tornado and asyncio log of the page's connections, in at most one line a second."""

import logging
import time
from collections.abc import Callable
from traceback import format_exception_only

_SOURCES = ("tornado", "asyncio")  # loggers
_PAUSE_S = 1.0


class ServerLog(logging.Handler):
    """Gives ``log`` one line a second; ``count`` is of all warnings and errors.

    Strangers cause what is logged, thousands of times a second where they want to.
    """

    def __init__(self, log: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(logging.WARNING)
        self.count = 0
        self._log, self._clock = log, clock
        self._next_s = -float("inf")

    def attach(self) -> None:
        """Take what is logged from now on."""
        for name in _SOURCES:
            logging.getLogger(name).addHandler(self)

    def detach(self) -> None:
        """Take no more."""
        for name in _SOURCES:
            logging.getLogger(name).removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record, and log its first line and its cause."""
        self.count += 1
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + _PAUSE_S
        lines = record.getMessage().splitlines()[:1]
        if record.exc_info is not None and record.exc_info[0] is not None:
            lines += format_exception_only(record.exc_info[0], record.exc_info[1])[-1:]
        self._log(f"live page: {': '.join(line.strip() for line in lines)} ({self.count} such lines so far)")
