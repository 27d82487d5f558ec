# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Writes files completely or not at all: on a full disk the previous file remains.

Every file of the project that replaces another one is written here: beside its place, under an unpredictable
name, which must not exist and is never followed as a link. Then it is moved into place.
"""

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

UNFINISHED_NAME = re.compile(r"\.trackslip-[0-9a-f]{16}\.new")  # names that a killed process may leave
_CREATE_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write the file of a user's option; links, devices and files in a locked folder are written directly.

    Characters of a text that are no valid Unicode, as names of files may contain, are escaped.

    Raises:
        OSError: the file cannot be written; unless it is written directly, its content remains.
    """
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    is_special = path.is_symlink() or (path.exists() and not path.is_file())
    if is_special or not os.access(path.parent, os.W_OK):
        path.write_bytes(data)
        return
    replace_atomically(path, data)


def replace_atomically(path: Path, content: str | bytes) -> None:
    """Replace a file; a link is replaced, not followed. Text is encoded as UTF-8.

    Raises:
        OSError: the file cannot be written; the previous one remains.
    """
    with atomic_replacement(path, content):
        pass


@contextmanager
def atomic_replacement(
    path: Path, content: str | bytes, mode: int = 0o666, *, sync: bool = False
) -> Iterator[None]:
    """Replace a file; the block runs when all is written, before the file is moved into place.

    ``mode``: permissions, limited by the process' umask.
    ``sync``: write to the disk before the block runs, for a machine that may lose power at any time.

    Raises:
        OSError: the file cannot be written; the previous one remains.
    """
    data = content.encode() if isinstance(content, str) else content
    beside = path.with_name(f".trackslip-{secrets.token_hex(8)}.new")
    descriptor = os.open(beside, _CREATE_FLAGS, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            if sync:
                os.fsync(file.fileno())
        yield
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise
