# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A directory of results with a marker file, so that a user's files are never removed."""

import fcntl
import shutil
from pathlib import Path
from typing import IO, NamedTuple

from trackslip_common.errors import InputError
from trackslip_sim.demo.graph import EXECUTABLES


class Results(NamedTuple):
    """Files and messages of the results of one kind of run."""

    kind: str
    files: tuple[str, ...]  # names or patterns of files that a run writes and a later one replaces
    option: str = ""  # prefix of messages: the option of the directory

    @property
    def marker(self) -> str:
        """Name of the file that marks a directory of these results."""
        return f".trackslip-{self.kind}"

    def refusal(self, reason: str) -> InputError:
        """The error for a refused directory, in one line."""
        accepted = f"a new or an empty directory, or that of an earlier {self.kind}"
        return InputError(f"{self.option}{reason}; accepted: {accepted}")


LOGS = tuple(f"{name}.log" for name in EXECUTABLES)  # by name: a user's own files may end in .log, too
DEMO = Results("demo", ("bag", "dev", *LOGS, "summary.json", "report.html"), "--output: ")


def claim(output: Path, results: Results = DEMO) -> IO[bytes]:
    """Mark ``output``, remove the results of an earlier run, and lock out other runs.

    Returns the open marker file; the lock ends when it is closed.

    Raises:
        InputError: the directory cannot be created, has other files, or another run is writing there.
    """
    try:
        output.mkdir(parents=True, exist_ok=True)
        marker = output / results.marker
        if not marker.is_file() and any(output.iterdir()):
            raise results.refusal(f"'{output}' holds files that are not a {results.kind}'s")
        lock = marker.open("ab")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise results.refusal(f"another {results.kind} is writing to '{output}'") from None
        for pattern in results.files:  # such as ``bag*``
            for path in output.glob(pattern):
                _remove(path)
    except OSError as error:
        raise results.refusal(f"'{output}' cannot be written ({error.strerror})") from error
    return lock


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
