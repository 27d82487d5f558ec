# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""File of the finished pieces of a study, from which an interrupted study resumes.

A piece is reused only while its inputs are unchanged: the parts of its key, and the source files of
estimators, truth and study.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from trackslip_common.errors import InputError
from trackslip_common.json_records import make_record, parse_line, read_lines

R = TypeVar("R")


class Cache(Generic[R]):
    """One JSON line per piece, appended as soon as it is finished; lines of other kinds are ignored."""

    def __init__(self, path: Path, kind: type[R], fresh: bool = False) -> None:
        """Read the file, unless ``fresh``; truncated lines are skipped.

        Raises:
            InputError: the file cannot be read or created, or is not a cache.
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
            self._add_line(line)

    def get(self, key: str) -> R | None:
        """A piece; None if the cache does not have it."""
        return self._pieces.get(key)

    def add(self, key: str, piece: R) -> None:
        """Store a piece in memory and in the file."""
        self._pieces[key] = piece
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, "row": vars(piece)}) + "\n")

    def _add_line(self, line: str) -> None:
        entry = parse_line(line) or {}
        with suppress(TypeError):  # truncated, or of another kind or version
            self._pieces[str(entry.get("key"))] = make_record(self._kind, entry.get("row"))


def key_of(parts: Mapping[str, Any], *modules: ModuleType) -> str:
    """Hash of the inputs of a piece: the parts, and the source files in the folders of the modules."""
    named = {**parts, "sources": _sources(modules)}
    return hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()


@cache
def _sources(modules: tuple[ModuleType, ...]) -> str:
    digest = hashlib.sha256()
    for path in source_files(modules):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def source_files(modules: Sequence[ModuleType]) -> list[Path]:
    """The source files in the folders of the modules, at any depth."""
    return [path for m in modules for path in sorted(Path(str(m.__file__)).parent.rglob("*.py"))]
