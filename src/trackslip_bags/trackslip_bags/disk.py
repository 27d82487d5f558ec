# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Disk space of a recorder: its files, the files beyond a budget, the time until the disk is full."""

import os
import re
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from mcap.stream_reader import StreamReader

from trackslip_bags.metadata import METADATA
from trackslip_common.atomic_files import UNFINISHED_NAME

LIBRARY = "trackslip record"  # name of the writer in each file of a recording
_BLANK_SIZE = 64  # bytes of a file that are empty or zeros if it had not reached the disk
_IDLE_TIME = 60.0  # s since the last write, after which no running recorder uses a file
_OBSERVATION_TIME = 60.0  # s, window of the rate
_MIN_OBSERVATION = 10.0  # s, shortest window of a rate


class RecordedFile(NamedTuple):
    """One file of a recording."""

    path: Path
    size: int  # B
    changed_s: float  # time of day


def is_recording(folder: Path) -> bool:
    """Whether a directory is a bag written by ``trackslip record``, without other files."""
    own_names = re.compile(
        rf"{re.escape(folder.name)}_\d+\.mcap|{re.escape(METADATA)}(\.tmp)?|{UNFINISHED_NAME.pattern}"
    )
    try:
        files = list(folder.iterdir()) if folder.is_dir() and not folder.is_symlink() else []
    except OSError:
        return False
    named = all(own_names.fullmatch(file.name) and file.is_file() and not file.is_symlink() for file in files)
    data_files = [file for file in files if file.suffix == ".mcap"]
    return named and bool(data_files) and all(map(_is_recorded, data_files))


def _is_recorded(file: Path) -> bool:
    """Whether a file's header names ``trackslip record`` as its writer, or was lost when the power failed."""
    try:
        with file.open("rb") as stream:
            if not stream.read(_BLANK_SIZE).strip(b"\0"):
                return True
            stream.seek(0)
            first = next(iter(StreamReader(stream).records), None)
    except Exception:  # noqa: BLE001 (foreign bytes can raise anything in the parser)
        return False
    return getattr(first, "library", "") == LIBRARY


def recorded_files(folder: Path) -> Iterator[RecordedFile]:
    """The files of all recordings in a directory."""
    for bag in folder.iterdir():
        if is_recording(bag):
            for file in bag.glob("*.mcap"):
                with suppress(OSError):  # removed meanwhile
                    status = file.stat()
                    yield RecordedFile(file, status.st_size, status.st_mtime)


def files_over_budget(
    files: list[RecordedFile], max_size: int, bag: Path, writing: Path, now_s: float
) -> list[Path]:
    """The oldest files, to be removed so that at most ``max_size`` bytes remain.

    Excluded are ``writing``, and recently changed files of other bags than ``bag``. Files of other bags are
    older than those of ``bag``, even if the computer's clock says otherwise: it may have started in 1970.
    """
    surplus = sum(file.size for file in files) - max_size
    removed: list[Path] = []
    for file in sorted(files, key=lambda file: (file.path.parent == bag, file.changed_s, file.path)):
        is_idle = file.path.parent == bag or abs(now_s - file.changed_s) > _IDLE_TIME
        if surplus > 0 and file.path != writing and is_idle:
            removed.append(file.path)
            surplus -= file.size
    return removed


def remove_recorded(file: Path) -> None:
    """Remove a file of a finished bag, the bag's outdated metadata, and with the last file its directory.

    Raises:
        OSError: it cannot be removed.
    """
    (file.parent / METADATA).unlink(missing_ok=True)
    file.unlink(missing_ok=True)
    with suppress(OSError):  # other files remain
        file.parent.rmdir()


class DiskWatch:
    """Time until the disk is full at the rate of the last minute."""

    def __init__(self) -> None:
        self._free_space: deque[tuple[float, int]] = deque()

    def add(self, free: int, now_s: float) -> None:
        """Add the free space now, bytes; ``now_s``: time of a steady clock."""
        self._free_space.append((now_s, free))
        while now_s - self._free_space[0][0] > _OBSERVATION_TIME:
            self._free_space.popleft()

    @property
    def minutes_left(self) -> float | None:
        """Minutes until the disk is full; None if the free space does not shrink, or is not yet known."""
        if (
            not self._free_space
            or (passed_s := self._free_space[-1][0] - self._free_space[0][0]) < _MIN_OBSERVATION
        ):
            return None
        used = self._free_space[0][1] - self._free_space[-1][1]
        return self._free_space[-1][1] / (used / passed_s) / 60.0 if used > 0 else None


def sync_file(file: Path) -> None:
    """Flush a file and its directory entry from the system's cache to the disk; may block."""
    for path in (file, file.parent):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
