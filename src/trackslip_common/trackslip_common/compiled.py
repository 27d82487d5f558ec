# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The one door to the compiler: machine code kept on disk, released from the interpreter's lock.

``compiled`` is for kernels and for what several of them call. Each such function is optimised together with
all that it calls, so a chain of them is optimised over and over. ``inlined`` is for the parts of a longer
function, which have one caller: they become part of it.
"""

import hashlib
import os
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

os.environ.setdefault("NUMBA_OPT", "1")  # compiles in 60 % of the time, and what it makes is as fast here

import llvmlite.binding
import numba

# Loops go over a dozen elements; unrolled for any number of passes they are a third of all code, not faster.
llvmlite.binding.set_option("trackslip", "--unroll-runtime=false")

F = TypeVar("F", bound=Callable[..., Any])

_OURS = "trackslip_"
_real_path = cache(os.path.realpath)
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


def compiled(function: F) -> F:
    """Compile at the first call and keep the result (strict IEEE arithmetic).

    Numba keeps it by the path of the file; colcon and ``make setup`` import the same file by two.
    """
    file = _real_path(function.__code__.co_filename)
    function.__code__ = function.__code__.replace(co_filename=file)
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _cache_directory(file, function.__module__)
    try:
        return cast(
            F, numba.njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
        )
    finally:
        numba.config.CACHE_DIR = before


def inlined(function: F) -> F:
    """Compile as part of the one function that calls it."""
    return cast(F, numba.njit(nogil=True, error_model="numpy", inline="always")(function))


@cache
def _cache_directory(file: str, module: str) -> str:
    """One directory per state of a module's source and of all that it imports of ours, at any depth.

    Numba looks only at the file of the function itself, so a kernel would keep stale machine code of
    what it calls in other files. Machine code names its module, which a file of tests has two names for.
    """
    found: set[str] = set()
    waiting = {file}
    while waiting:
        source = waiting.pop()
        found.add(source)
        waiting.update(path for path in _imported(source) if path not in found)
    digest = hashlib.sha256(module.encode())
    for source in sorted(found):
        digest.update(_text(source))
    parent = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(file).parent / "__pycache__")
    return str(parent / digest.hexdigest()[:16])


@cache
def _text(file: str) -> bytes:
    return Path(file).read_bytes()


@cache
def _imported(file: str) -> tuple[str, ...]:
    """Files of the modules that a file imports, those of our packages and of its own folder."""
    found = []
    for match in _IMPORT.finditer(_text(file).decode()):
        parent, names = match.group(1), re.findall(r"\w+", match.group(2) or "")
        for name in (parent, *(f"{parent}.{name}" for name in names)):
            path = getattr(sys.modules.get(name), "__file__", None)
            path = path and _real_path(path)
            if path and (name.startswith(_OURS) or Path(path).parent == Path(file).parent):
                found.append(path)
    return tuple(found)
