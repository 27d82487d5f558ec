# SPDX-License-Identifier: Apache-2.0
"""The one door to the compiler: machine code kept on disk, released from the interpreter's lock."""

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


@cache
def _cache_directory(folder: Path) -> str:
    """One directory per state of the sources in a folder.

    Numba looks only at the file of the function itself, so a kernel would keep stale machine code of
    what it calls in other files. Kernels call kernels of their own folder only.
    """
    sources = b"".join(path.read_bytes() for path in sorted(folder.glob("*.py")))
    parent = Path(os.environ.get("NUMBA_CACHE_DIR") or folder / "__pycache__")
    return str(parent / hashlib.sha256(sources).hexdigest()[:16])


def compiled(function: F) -> F:
    """Compile at the first call and keep the result (strict IEEE arithmetic)."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _cache_directory(Path(function.__code__.co_filename).parent)
    try:
        return cast(F, numba.njit(cache=True, nogil=True)(function))
    finally:
        numba.config.CACHE_DIR = before
