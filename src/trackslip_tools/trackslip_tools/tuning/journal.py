# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A file of all scores, with which an interrupted search resumes.

The first line identifies what the scores belong to. Each other line holds a bag, a set of values, and its
score. A truncated line is scored again.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from trackslip_common.errors import InputError
from trackslip_common.json_records import make_record, parse_line, read_lines
from trackslip_tools.tuning.task import Score, Task

Values = tuple[float, ...]


class Journal:
    """Scores by bag and values; each score is written to disk at once."""

    def __init__(self, path: Path, tasks: Iterable[Task], names: Iterable[str]) -> None:
        """Open or create a journal, and read its scores.

        Raises:
            InputError: the file cannot be written, or belongs to other bags, parameters or names.
        """
        self._scores: dict[tuple[int, Values], Score] = {}
        heading = {"names": list(names), "of": _fingerprint(tasks)}
        try:
            entries = [entry for entry in map(parse_line, read_lines(path)) if entry is not None]
            if entries and entries[0] != heading:
                raise InputError(
                    f"'{path}' is of other bags or parameters; accepted: another --output, or remove it"
                )
            for entry in entries[1:]:
                self._scores[_key(entry, len(heading["names"]))] = make_record(Score, entry["score"])
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("w" if not entries else "a", encoding="utf-8")
        except OSError as error:
            raise InputError(f"journal '{path}' cannot be used ({error.strerror})") from error
        except (KeyError, TypeError) as error:
            raise InputError(f"'{path}' is no journal of tune; accepted: another --output") from error
        if not entries:
            self._write(heading)

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *raised: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return len(self._scores)

    def __contains__(self, key: tuple[int, Values]) -> bool:
        return key in self._scores

    def __getitem__(self, key: tuple[int, Values]) -> Score:
        return self._scores[key]

    def add(self, bag: int, values: Values, score: Score) -> None:
        """Add a score."""
        self._scores[bag, values] = score
        self._write({"bag": bag, "values": values, "score": score._asdict()})

    def _write(self, entry: Mapping[str, Any]) -> None:
        self._file.write("\n" * bool(self._file.tell()) + json.dumps(entry))
        self._file.flush()


def _key(entry: Mapping[str, Any], names: int) -> tuple[int, Values]:
    """Bag and values of an entry; raises ``TypeError`` if they are invalid."""
    bag, values = entry["bag"], entry["values"]
    are_numbers = isinstance(values, list) and all(type(value) is float for value in values)
    if type(bag) is not int or not are_numbers or len(values) != names:
        raise TypeError("bag, values")
    return bag, tuple(values)


def _fingerprint(tasks: Iterable[Task]) -> str:
    """Hash of everything on which a score depends, except the values."""
    digest = hashlib.sha256()
    for task in tasks:
        digest.update(repr(task.p).encode())
        for array in task.log:
            digest.update(array.tobytes())
        if task.reference is not None:
            R = task.reference.covariances
            digest.update(task.reference.stamps_ns.tobytes() + task.reference.poses.tobytes())
            digest.update(b"" if R is None else R.tobytes())
    return digest.hexdigest()[:16]
