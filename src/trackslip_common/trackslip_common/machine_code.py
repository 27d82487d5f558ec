# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code on disk, identified by content: neither the path nor the time of a file matters.

A directory has the machine code of one state of a module's source and of all our sources that it imports;
numba adds its own version and Python's. The wheel has code for any processor of a family (``SHIPPED``). Other
code is compiled for this processor, and kept.
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

SHIPPED = Path(__file__).with_name("kernels")  # in the wheel, from ``scripts/make_wheel.py``
GENERIC_TARGET = ("generic", "")  # processor and features of the shipped code

_PACKAGE_PREFIX = "trackslip_"
_real_path = cache(os.path.realpath)
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


class KernelCache(FunctionCache):
    """Cache of the machine code of one function: first kept code, then shipped code."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._impl_class = _cache_class(cache_directory(function.__code__.co_filename))
        super().__init__(function)
        self._shipped = _ShippedCache(function) if SHIPPED.is_dir() else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function of the signature; None if it must be compiled."""
        code = super().load_overload(sig, target_context)
        if code is None and self._shipped is not None:
            code = self._shipped.load_overload(sig, target_context)
        return code


class _ShippedCache(FunctionCache):
    """Code in the wheel; it runs on every processor of the family."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._impl_class = _cache_class(SHIPPED)
        super().__init__(function)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        signature, (triple, *_), code = super()._index_key(sig, codegen)
        return signature, (triple, *GENERIC_TARGET), code


@cache
def _cache_class(root: Path) -> type[CompileResultCacheImpl]:
    """The cache implementation with its files below ``root``."""

    class Locator(_CacheLocator):
        """The directory of a function's machine code."""

        def __init__(self, function: Callable[..., Any], file: str) -> None:
            self._line = function.__code__.co_firstlineno
            self._directory = root / source_digest(file, function.__module__)

        @classmethod
        def from_function(cls, function: Callable[..., Any], file: str) -> "Locator":
            return cls(function, file)

        def get_cache_path(self) -> str:
            return str(self._directory)

        def get_source_stamp(self) -> str:
            """Digest of the sources, which is the directory's name."""
            return self._directory.name

        def get_disambiguator(self) -> str:
            return str(self._line)

    class Implementation(CompileResultCacheImpl):
        """Numba's implementation with this locator alone."""

        _locator_classes = (Locator,)

    return Implementation


def cache_directory(file: str) -> Path:
    """Where machine code is kept: beside the source, or in the user's cache if that is not writable."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    beside = Path(file).parent / "__pycache__"
    if os.access(beside if beside.is_dir() else beside.parent, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trackslip"


@cache
def source_digest(file: str, module: str) -> str:
    """Digest of a module's source and of all our sources that it imports, at any depth.

    Numba checks only the file of the function itself, so a kernel would keep stale code of functions in other
    files. Machine code contains the module's name, of which a test file has two.
    """
    files: set[str] = set()
    waiting = {file}
    while waiting:
        source = waiting.pop()
        files.add(source)
        waiting.update(path for path in _imported_files(source) if path not in files)
    state = hashlib.sha256(module.encode())
    for text in sorted(map(_source_bytes, files)):
        state.update(text)
    return state.hexdigest()[:16]


@cache
def _source_bytes(file: str) -> bytes:
    return Path(file).read_bytes()


@cache
def _imported_files(file: str) -> tuple[str, ...]:
    """Files of the modules that a file imports, from our packages and from its own folder."""
    paths = []
    for match in _IMPORT.finditer(_source_bytes(file).decode()):
        parent, names = match.group(1), re.findall(r"\w+", match.group(2) or "")
        for name in (parent, *(f"{parent}.{name}" for name in names)):
            path = getattr(sys.modules.get(name), "__file__", None)
            path = path and _real_path(path)
            if path and (name.startswith(_PACKAGE_PREFIX) or Path(path).parent == Path(file).parent):
                paths.append(path)
    return tuple(paths)
