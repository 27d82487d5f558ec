# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all: a full disk leaves no half page, and the one before it."""

import os
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a text, or bytes, beside its place, and move it there; directly where that cannot be.

    Raises:
        OSError: it cannot be written; what was there is as before.
    """
    data = content.encode() if isinstance(content, str) else content
    is_special = path.is_symlink() or (path.exists() and not path.is_file())
    if is_special or not os.access(path.parent, os.W_OK):
        path.write_bytes(data)
        return
    beside = path.with_name(f".{path.name}.new")
    try:
        beside.write_bytes(data)
        beside.replace(path)
    except OSError:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise
