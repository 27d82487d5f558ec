# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A directory of results: marked as such, so that nothing of a user's is ever removed."""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple

from trackslip_common.errors import InputError


class Results(NamedTuple):
    """Of one kind of run."""

    of: str
    made: tuple[str, ...]  # what a run writes, and a later one replaces
    option: str = ""  # by which the directory was given

    @property
    def marker(self) -> str:
        """Name of the file that marks a directory of these."""
        return f".trackslip-{self.of}"

    def refusal(self, reason: str) -> InputError:
        """In one line."""
        accepted = f"a new or an empty directory, or that of an earlier {self.of}"
        return InputError(f"{self.option}{reason}; accepted: {accepted}")


# One of each node that a demo may run; a name of a user's own ends in .log, too.
LOGS = (
    *("emulator.log", "can_driver.log", "watson_imu.log", "sick_pls.log", "nmea_gnss.log"),
    *("box_localizer.log", "gnss_localizer.log", "slip_estimator.log", "soil_estimator.log"),
    *("record.log", "live.log"),
)
DEMO = Results("demo", ("bag", "dev", *LOGS, "summary.json", "report.html"), "--output: ")


def claim(output: Path, results: Results = DEMO) -> AbstractContextManager[None]:
    """Mark ``output``, remove an earlier run's results, and keep other runs of the kind out until the exit.

    Raises:
        InputError: it cannot be made, holds what no such run made, or another one is writing there.
    """
    try:
        return _claim(output, results)
    except OSError as error:
        raise results.refusal(f"'{output}' cannot be written ({error.strerror})") from error


def _claim(output: Path, results: Results) -> AbstractContextManager[None]:
    output.mkdir(parents=True, exist_ok=True)
    marker = output / results.marker
    if not marker.is_file() and any(output.iterdir()):
        raise results.refusal(f"'{output}' holds files that are not a {results.of}'s")
    lock = os.open(marker, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise results.refusal(f"another {results.of} is writing to '{output}'") from None
    for pattern in results.made:
        for path in output.glob(pattern):
            _remove(path)
    return _held(lock)


@contextmanager
def _held(lock: int) -> Iterator[None]:
    try:
        yield
    finally:
        os.close(lock)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
