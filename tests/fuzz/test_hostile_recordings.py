# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""All hostile bags of ``make fuzz`` can be made; one that cannot is reported, and the others still run."""

import re
from pathlib import Path

import pytest

import hostile_recordings
from hostile_containers import records
from hostile_messages import Made

SMALL = [(name, made) for name, made in records() if "MB" not in name and "0000" not in name]


@pytest.mark.parametrize(("name", "made"), SMALL, ids=[name for name, _ in SMALL])
def test_hostile_file_is_written(name: str, made: Made, tmp_path: Path) -> None:
    assert made(tmp_path).stat().st_size > 0, name


@pytest.mark.parametrize(
    "pattern",
    [
        pytest.param("/scan.*1e308", marks=pytest.mark.slow),
        pytest.param("/scan.*1e155", marks=pytest.mark.slow),
        pytest.param("^diagnostics=", marks=pytest.mark.slow),
    ],
)
def test_message_of_numbers_that_its_fields_cannot_hold_is_written(pattern: str, tmp_path: Path) -> None:
    makers = [made for name, made in hostile_recordings.made_by_name().items() if re.search(pattern, name)]
    assert makers
    for k, make in enumerate(makers):
        (tmp_path / str(k)).mkdir()
        assert make(tmp_path / str(k)).is_dir()


def test_failed_generation_of_a_bag_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(folder: Path) -> Path:
        raise ValueError("no such number")

    monkeypatch.setattr(hostile_recordings, "made_by_name", lambda: {"bag": fail})
    (run,) = hostile_recordings._work("bag", ["info"])
    assert (run.bag, run.command) == ("bag", "making")
    assert "ValueError: no such number" in run.problem
