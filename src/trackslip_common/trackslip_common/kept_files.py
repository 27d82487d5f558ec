# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files that a node keeps across restarts; an unusable file in their place is renamed, never lost."""

import errno
import os
from pathlib import Path

from trackslip_common.errors import InputError

MAX_UNUSED_FILES = 9  # unused files beside one that is kept


def parameter_path(name: str, text: str) -> Path | None:
    """The path in a node's parameter ``name``, with ~ expanded; None if it is empty.

    Raises:
        InputError: the home directory is unknown.
    """
    try:
        return Path(text).expanduser() if text else None
    except RuntimeError as error:
        accepted = "a path, from ~ where there is a home directory"
        raise InputError(f"{name}: '{text}' has no home directory; accepted: {accepted}") from error


def move_aside(path: Path) -> None:
    """Rename an unused file to a free name: ``….unused``, ``….unused-2`` and so on.

    Raises:
        OSError: all names are taken, or the file cannot be renamed; it stays in place.
    """
    if not os.path.lexists(path):
        return
    names = [f"{path.name}.unused", *(f"{path.name}.unused-{n}" for n in range(2, MAX_UNUSED_FILES + 1))]
    free_path = next(
        (candidate for name in names if not os.path.lexists(candidate := path.with_name(name))), None
    )
    if free_path is None:
        raise OSError(
            errno.EEXIST, f"{MAX_UNUSED_FILES} files {names[0]}… are there already; move or delete some"
        )
    path.rename(free_path)
