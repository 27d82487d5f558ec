# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files that a node keeps from one start to the next; what lies in their place and is none is never lost."""

import errno
import os
from pathlib import Path

from trackslip_common.errors import InputError

MOST_ASIDE = 9  # files that were not used, beside one that is kept


def own_file(name: str, text: str) -> Path | None:
    """The path of the file that a node keeps, from its parameter ``name``; it may begin with ~; empty: none.

    Raises:
        InputError: nobody knows that home directory.
    """
    try:
        return Path(text).expanduser() if text else None
    except RuntimeError as error:
        accepted = "a path, from ~ where there is a home directory"
        raise InputError(f"{name}: '{text}' has no home directory; accepted: {accepted}") from error


def move_aside(path: Path) -> None:
    """Rename a file that is not used, to a name that nothing has: ``….unused``, ``….unused-2`` and so on.

    Raises:
        OSError: there are too many already, or it cannot be renamed; it is where it was.
    """
    if not os.path.lexists(path):
        return
    names = [f"{path.name}.unused", *(f"{path.name}.unused-{n}" for n in range(2, MOST_ASIDE + 1))]
    free = next((place for name in names if not os.path.lexists(place := path.with_name(name))), None)
    if free is None:
        raise OSError(errno.EEXIST, f"{MOST_ASIDE} files {names[0]}… are there already; move or delete some")
    path.rename(free)
