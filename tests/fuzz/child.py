# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs hostile work in a child process with limits, and reports how it ended."""

import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from trackslip_common.errors import ExitCode, InputError

CODES = (ExitCode.DONE, ExitCode.FAILED, ExitCode.BAD_INPUT)
WAITING = 10  # ratio of wall time to processor time while others use the processors


class Ended(NamedTuple):
    """Result of the work."""

    code: int
    out: str
    err: str
    seconds: float  # of processor time
    megabytes: int

    def problem(self, longest_s: float, most_mb: float) -> str:
        """The fault of the result, or an empty text."""
        if "Traceback" in self.err:
            return "\n" + self.err
        if self.code not in CODES:
            return f"exit code {self.code}, {self.seconds:.0f} s, {self.megabytes} MB"
        if self.code == ExitCode.BAD_INPUT and not self.err.splitlines():
            return "rejected without a message"
        for text in (self.out, self.err):
            if not all(line.isprintable() for line in text.split("\n")):
                return f"not printable: {text!r:.500}"
        if self.seconds > longest_s:
            return f"{self.seconds:.0f} s"
        return f"{self.megabytes} MB" if self.megabytes > most_mb else ""


def run_in_child(work: Callable[[], int | None], folder: Path, longest_s: int) -> Ended:
    """Fork and run the work in the child; its output goes to two files in ``folder``."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _work(work, folder, longest_s)
    _, status, used = os.wait4(child, 0)
    out, err = (
        (folder / name).read_text(encoding="utf-8", errors="replace") for name in ("stdout", "stderr")
    )
    seconds, megabytes = used.ru_utime + used.ru_stime, used.ru_maxrss // 1024
    return Ended(os.waitstatus_to_exitcode(status), out, err, seconds, megabytes)


def _work(work: Callable[[], int | None], folder: Path, longest_s: int) -> None:
    """Run the work in the child; never returns."""
    code = 70
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (longest_s + 5, longest_s + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(WAITING * longest_s)
        for stream, name in ((sys.stdout, "stdout"), (sys.stderr, "stderr")):
            os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), stream.fileno())
        try:
            code = work() or ExitCode.DONE
        except InputError as error:
            print(error, file=sys.stderr)
            code = ExitCode.BAD_INPUT
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 70
        except BaseException:  # noqa: BLE001 (that is what is looked for)
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)
