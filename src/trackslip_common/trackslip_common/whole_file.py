# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all: a full disk leaves no half page, and the one before it.

Every file of the project that replaces another one is written here: beside its place, under a name that
nobody can foresee, which must not exist and is never followed as a link; then it is moved.
"""

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

UNFINISHED = re.compile(r"\.trackslip-[0-9a-f]{16}\.new")  # a name that a killed process may leave
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def write_whole(path: Path, content: str | bytes) -> None:
    """Write the file of a user's option; through a link, into a device, or in a locked folder directly.

    What of a text is no Unicode, as names of files may be, is written escaped.

    Raises:
        OSError: it cannot be written; what was there is as before.
    """
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    is_special = path.is_symlink() or (path.exists() and not path.is_file())
    if is_special or not os.access(path.parent, os.W_OK):
        path.write_bytes(data)
        return
    replace_whole(path, data)


def replace_whole(path: Path, content: str | bytes) -> None:
    """Put a file in place of what is there; a link there is replaced, not followed. Texts become UTF-8.

    Raises:
        OSError: it cannot be written; what was there is as before.
    """
    with replacing(path, content):
        pass


@contextmanager
def replacing(path: Path, content: str | bytes, mode: int = 0o666, *, sync: bool = False) -> Iterator[None]:
    """The same, with something to do when all is written and before it is moved into place.

    ``mode``: permissions, less those that the process' umask takes.
    ``sync``: it is on the disk by then, for a machine whose power may go at any time.

    Raises:
        OSError: it cannot be written; what was there is as before.
    """
    data = content.encode() if isinstance(content, str) else content
    beside = path.with_name(f".trackslip-{secrets.token_hex(8)}.new")
    descriptor = os.open(beside, _NEW, mode)
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
