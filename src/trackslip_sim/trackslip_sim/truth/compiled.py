# SPDX-License-Identifier: Apache-2.0
"""The one door to the compiler: machine code kept on disk, released from the interpreter's lock."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def _cache_directory() -> str:
    """One directory per state of this package's sources.

    Numba looks only at the file of the function itself, so a kernel would keep stale machine code of
    what it calls in other files.
    """
    here = Path(__file__).parent
    sources = b"".join(path.read_bytes() for path in sorted(here.glob("*.py")))
    parent = Path(os.environ.get("NUMBA_CACHE_DIR") or here / "__pycache__")
    return str(parent / hashlib.sha256(sources).hexdigest()[:16])


_CACHE_DIRECTORY = _cache_directory()


def compiled(function: F) -> F:
    """Compile at the first call and keep the result (strict IEEE arithmetic)."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE_DIRECTORY
    try:
        return cast(F, numba.njit(cache=True, nogil=True)(function))
    finally:
        numba.config.CACHE_DIR = before
