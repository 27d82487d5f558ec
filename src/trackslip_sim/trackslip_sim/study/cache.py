# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finished pieces of a study in a file, so that a study that was interrupted goes on.

A piece is found again only while everything that it rests on is the same: what its key names, and the sources
of estimators, truth and study.
"""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from trackslip_common.errors import InputError
from trackslip_common.json_records import parse_line, read_lines, record

R = TypeVar("R")


class Cache(Generic[R]):
    """One JSON line per piece, appended as soon as it is finished; pieces of other kinds are left alone."""

    def __init__(self, path: Path, kind: type[R], fresh: bool = False) -> None:
        """Read what is there, unless everything is to be computed afresh; a line cut short is left out.

        Raises:
            InputError: the file cannot be read or made, or is one of something else.
        """
        self._path = path
        self._kind = kind
        self._pieces: dict[str, R] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            lines = read_lines(path)
        except OSError as error:
            raise InputError(f"--cache: '{path}' cannot be used ({error.strerror})") from error
        except TypeError as error:
            raise InputError(
                f"--cache: '{path}' is no cache of a study; accepted: a new file, or such a cache"
            ) from error
        for line in () if fresh else lines:
            self._remember(line)

    def get(self, key: str) -> R | None:
        """A piece; None where it has to be computed."""
        return self._pieces.get(key)

    def add(self, key: str, piece: R) -> None:
        """Keep a piece, on disk too."""
        self._pieces[key] = piece
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, "row": vars(piece)}) + "\n")

    def _remember(self, line: str) -> None:
        entry = parse_line(line) or {}
        with suppress(TypeError):  # cut short, or of another kind or version
            self._pieces[str(entry.get("key"))] = record(self._kind, entry.get("row"))


def key_of(parts: Mapping[str, Any], *modules: ModuleType) -> str:
    """Names all that a piece rests on: the parts, and the sources in the folders of the modules."""
    named = {**parts, "sources": _sources(modules)}
    return hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()


@cache
def _sources(modules: tuple[ModuleType, ...]) -> str:
    digest = hashlib.sha256()
    for module in modules:
        for path in sorted(Path(str(module.__file__)).parent.glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
