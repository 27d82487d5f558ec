# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Refuses before the work what could not be written after it."""

import os
from pathlib import Path

from trackslip_common.errors import InputError


def require_writable(**files: Path | None) -> None:
    """Files that are written at the end, by the option that names them; one that is there is replaced.

    Raises:
        InputError: one is a directory, has no folder to be in, or may not be written.
    """
    for option, path in files.items():
        if path is None:
            continue
        folder = path.parent
        if path.is_dir():
            why = "it is a directory"
        elif not folder.is_dir():
            why = f"no such folder: {folder}"
        elif not os.access(path if path.exists() else folder, os.W_OK):
            why = "Permission denied"
        else:
            continue
        raise InputError(f"--{option}: '{path}' cannot be written ({why})")
