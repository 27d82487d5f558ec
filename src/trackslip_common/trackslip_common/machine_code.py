# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code on disk, found by its content: no path and no time of a file counts.

A directory holds the machine code of one state of a module's source and of all sources of ours that it
imports; numba adds its own version and Python's. Code for any processor of a family comes with the wheel
(``SHIPPED``); what that lacks is compiled for this processor, and kept.
"""

import hashlib
import os
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

SHIPPED = Path(__file__).with_name("kernels")  # of the wheel, by ``scripts/make_wheel.py``
GENERIC = ("generic", "")  # processor and its features, for which code is shipped

_OURS = "trackslip_"
_real_path = cache(os.path.realpath)
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


class KernelCache(FunctionCache):
    """Where numba looks for the machine code of one function: first what was kept, then what was shipped."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._impl_class = _kept_in(directory(function.__code__.co_filename))
        super().__init__(function)
        self._shipped = _Shipped(function) if SHIPPED.is_dir() else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for the signature; None where it is to be compiled."""
        found = super().load_overload(sig, target_context)
        if found is None and self._shipped is not None:
            found = self._shipped.load_overload(sig, target_context)
        return found


class _Shipped(FunctionCache):
    """What came with the wheel; it runs on every processor of the family."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._impl_class = _kept_in(SHIPPED)
        super().__init__(function)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        signature, (triple, *_), code = super()._index_key(sig, codegen)
        return signature, (triple, *GENERIC), code


@cache
def _kept_in(root: Path) -> type[CompileResultCacheImpl]:
    """What names the files of a function below ``root``."""

    class Locator(_CacheLocator):
        """The directory of a function's machine code."""

        def __init__(self, function: Callable[..., Any], file: str) -> None:
            self._line = function.__code__.co_firstlineno
            self._directory = root / digest(file, function.__module__)

        @classmethod
        def from_function(cls, function: Callable[..., Any], file: str) -> "Locator":
            return cls(function, file)

        def get_cache_path(self) -> str:
            return str(self._directory)

        def get_source_stamp(self) -> str:
            """Of the sources: the directory's name has it."""
            return self._directory.name

        def get_disambiguator(self) -> str:
            return str(self._line)

    class Implementation(CompileResultCacheImpl):
        """Numba's, with that locator alone."""

        _locator_classes = (Locator,)

    return Implementation


def directory(file: str) -> Path:
    """Where this computer keeps machine code: beside the source, or with the user where nobody may write."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    beside = Path(file).parent / "__pycache__"
    if os.access(beside if beside.is_dir() else beside.parent, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trackslip"


@cache
def digest(file: str, module: str) -> str:
    """Of a module's source and of all that it imports of ours, at any depth.

    Numba looks only at the file of the function itself, so a kernel would keep stale machine code of what it
    calls in other files. Machine code names its module, which a file of tests has two names for.
    """
    found: set[str] = set()
    waiting = {file}
    while waiting:
        source = waiting.pop()
        found.add(source)
        waiting.update(path for path in _imported(source) if path not in found)
    state = hashlib.sha256(module.encode())
    for text in sorted(map(_text, found)):
        state.update(text)
    return state.hexdigest()[:16]


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
