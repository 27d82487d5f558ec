# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results in lines of JSON that are truncated, edited or written by others."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from trackslip_tools.result_cache import ResultCache, make_record


@dataclass(frozen=True)
class Piece:
    name: str
    error: float
    seeds: int
    passed: bool
    interval: tuple[float, float]


class Score(NamedTuple):
    nis: dict[str, float]
    count: int  # type: ignore[assignment]  # the tuple's own is hidden


GOOD: dict[str, Any] = {"name": "a", "error": 1, "seeds": 2, "passed": True, "interval": [0.1, 1]}


def test_written_record_is_read() -> None:
    piece = make_record(Piece, GOOD)
    assert piece == Piece("a", 1.0, 2, True, (0.1, 1.0))
    assert isinstance(piece.error, float)
    assert make_record(Score, {"nis": {"box_pose": 1}, "count": 3}) == Score({"box_pose": 1.0}, 3)


CHANGES: list[dict[str, Any]] = [
    *({"name": None}, {"error": "0.5"}, {"error": True}, {"seeds": 2.0}, {"seeds": True}, {"passed": 1}),
    *({"error": 10**400}, {"interval": [0.1]}, {"interval": [0.1, "b"]}, {"interval": 0.1}, {"more": 1}),
]


@pytest.mark.parametrize(
    "entry", [*(GOOD | changes for changes in CHANGES), None, [], {}, {"name": "a"}], ids=str
)
def test_entry_of_another_type_is_refused(entry: Any) -> None:
    with pytest.raises(TypeError):
        make_record(Piece, entry)


@pytest.mark.parametrize(
    "line",
    [
        *("", "{", "[" * 100_000, '{"a": ' * 100_000, "[1]", "7" * 5000, "null", '"a"', "{}"),
        *('{"key": "b"}', '{"row": {}}', '{"key": "b", "row": {"nis": 1, "count": 2}}', '{"key": "b", "ro'),
    ],
)
def test_other_lines_are_passed_over(tmp_path: Path, line: str) -> None:
    file, score = tmp_path / "cache.jsonl", Score({"box_pose": 1.0}, 3)
    ResultCache(file, Score, "--cache").add("a", score)
    with file.open("a", encoding="utf-8") as stream:
        stream.write(f"\n{line}")
    again = ResultCache(file, Score, "--cache")
    assert again == {"a": score}
    again.add("c", score)
    assert ResultCache(file, Score, "--cache") == {"a": score, "c": score}
