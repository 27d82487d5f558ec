# SPDX-License-Identifier: Apache-2.0
"""The one door to the compiler: machine code kept on disk, released from the interpreter's lock."""

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


@cache
def _cache_directory(*folders: Path) -> str:
    """In the first folder, one directory per state of the sources in all of them.

    Numba looks only at the file of the function itself, so a kernel would keep stale machine code of
    what it calls in other files.
    """
    sources = b"".join(path.read_bytes() for folder in folders for path in sorted(folder.glob("*.py")))
    parent = Path(os.environ.get("NUMBA_CACHE_DIR") or folders[0] / "__pycache__")
    return str(parent / hashlib.sha256(sources).hexdigest()[:16])


def compiled(function: F) -> F:
    """Compile at the first call and keep the result (strict IEEE arithmetic); calls its own folder only."""
    return compiled_upon()(function)


def compiled_upon(*modules: ModuleType) -> Callable[[F], F]:
    """``compiled`` for a kernel that also calls those in the folders of these modules."""

    def compile_(function: F) -> F:
        files = (function.__code__.co_filename, *(str(module.__file__) for module in modules))
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = _cache_directory(*(Path(file).parent for file in files))
        try:
            return cast(F, numba.njit(cache=True, nogil=True)(function))
        finally:
            numba.config.CACHE_DIR = before

    return compile_
