# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Output files: checked for writability before the work, and written after it."""

import json
import os
from pathlib import Path
from typing import Any

from trackslip_common.atomic_files import write_atomically
from trackslip_common.errors import InputError
from trackslip_tools.live.encoding import replace_nonfinite

# First characters of the files.
PAGE_PREFIX = "<!DOCTYPE html>\n<!-- SPDX-FileCopyrightText: 2026 Trackslip authors"
PNG_PREFIX = b"\x89PNG\r\n\x1a\n"
_JSON_PREFIXES = ("{", "[")


def require_writable(**files: Path | None) -> None:
    """Check that the files of these options can be written; existing files will be replaced.

    Raises:
        InputError: a path is a directory or ``-``, has no parent folder or may not be written; or ``json``
            names an existing file that is no JSON.
    """
    for option, path in files.items():
        if path is None:
            continue
        folder = path.parent
        if str(path) == "-":
            why = "it is no file; name one, such as results.json"
        elif path.is_dir():
            why = "it is a directory"
        elif not folder.is_dir():
            why = f"no such folder: {folder}"
        elif not os.access(path if path.exists() else folder, os.W_OK):
            why = "Permission denied"
        else:
            if option == "json":
                refuse_foreign_file(option, path, *_JSON_PREFIXES)
            continue
        raise InputError(f"--{option}: '{path}' cannot be written ({why})")


def refuse_foreign_file(option: str, path: Path, *prefixes: str | bytes) -> None:
    """Check that an existing file begins as the outputs of this option do.

    A bag or a text that was named by mistake is therefore not replaced.

    Raises:
        InputError: the file begins otherwise, or cannot be read.
    """
    if not path.is_file():
        return
    accepted_prefixes = tuple(prefix.encode() if isinstance(prefix, str) else prefix for prefix in prefixes)
    try:
        with path.open("rb") as file:
            head = file.read(max(map(len, accepted_prefixes)))
    except OSError as error:
        raise InputError(f"--{option}: '{path}' cannot be written ({error.strerror})") from error
    if head and not head.startswith(accepted_prefixes):
        accepted = "a new file, or one that this command wrote"
        raise InputError(
            f"--{option}: '{path}' holds something else, and is not replaced; accepted: {accepted}"
        )


def write_file(option: str, path: Path, content: str) -> None:
    """Write the file that an option names.

    Raises:
        InputError: it cannot be written.
    """
    try:
        write_atomically(path, content)
    except OSError as error:
        raise InputError(f"--{option}: '{path}' cannot be written ({error.strerror})") from error


def make_folder(option: str, path: Path) -> None:
    """Create the folder that an option names, unless it exists.

    Raises:
        InputError: the folder cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--{option}: '{path}' cannot be a folder of results ({error.strerror})") from error


def write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Write a summary as JSON; nan and infinity become null.

    Raises:
        InputError: the file cannot be written.
    """
    write_file("json", path, json.dumps(replace_nonfinite(content), indent=2, allow_nan=False) + "\n")
