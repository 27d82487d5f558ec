# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The directory of a demo's results: marked as such, so that nothing of a user's is ever removed."""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from trackslip_common.errors import InputError

MARKER = ".trackslip-demo"
_MADE = ("bag", "dev", "*.log", "summary.json", "demo.png")  # what a demo writes, and a later one replaces
_ACCEPTED = "accepted: a new or an empty directory, or that of an earlier demo"


def claim(output: Path) -> AbstractContextManager[None]:
    """Mark ``output`` as a demo's, remove an earlier demo's results, and keep other demos out until the exit.

    Raises:
        InputError: it cannot be made, holds what no demo made, or another demo is writing there.
    """
    try:
        return _claim(output)
    except OSError as error:
        raise InputError(f"--output: '{output}' cannot be written ({error.strerror}); {_ACCEPTED}") from error


def _claim(output: Path) -> AbstractContextManager[None]:
    output.mkdir(parents=True, exist_ok=True)
    marker = output / MARKER
    if not marker.is_file() and any(output.iterdir()):
        raise InputError(f"--output: '{output}' holds files that are not a demo's; {_ACCEPTED}")
    lock = os.open(marker, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise InputError(
            f"--output: another demo is writing to '{output}'; accepted: another directory"
        ) from None
    for pattern in _MADE:
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
