# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A newcomer's path from a CSV log to a report: the output of each command suggests the next one."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from fixtures.newcomer import write_log

from trackslip_tools.cli.main import main

MOST = 10  # commands
_SUGGESTED = re.compile(r"(?:next|machine of yours): (trackslip [^;\n]+)|see (trackslip --help)")
_GUESSED = re.compile(r"^guessed: unit of (\w+): ", re.MULTILINE)
REPLACEMENTS = {"LOG.csv": "log.csv"}  # replaced by the reader
UNITS = {"v_left": "km/h", "v_right": "km/h", "yaw_rate": "deg/s", "t": "s"}  # not part of the column names


def correct(mapping: Path, columns: list[str]) -> None:
    """Set the units of these columns, as a reader would after the note that they are guessed."""
    for name in columns:
        text = mapping.read_text(encoding="utf-8")
        changed = re.sub(rf"(column: {name}, unit: )[\w/]+", rf"\g<1>{UNITS.get(name, 'deg')}", text)
        mapping.write_text(changed, encoding="utf-8")


@pytest.fixture
def commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[str]:
    """Each suggested command, starting with ``trackslip``; it runs when the next one is requested."""
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "log.csv")

    def run() -> Iterator[str]:
        line = "trackslip"
        while line:
            yield line
            try:
                code = main(shlex.split(line)[1:])
            except SystemExit as ended:  # --help
                code = int(ended.code or 0)
            printed = "".join(capsys.readouterr())
            assert code == 0 or line in ("trackslip", "trackslip check log_bag"), printed
            correct(tmp_path / "log_mapping.yaml", _GUESSED.findall(printed))
            suggestion = _SUGGESTED.search(" ".join(printed.split()) if "--help" in line else printed)
            line = next(filter(None, suggestion.groups())).strip() if suggestion else ""
            for placeholder, value in REPLACEMENTS.items():
                line = line.replace(placeholder, value)

    return run()


@pytest.mark.slow
def test_each_command_suggests_the_next_until_there_is_a_report(
    commands: Iterator[str], tmp_path: Path
) -> None:
    lines = list(commands)
    assert len(lines) <= MOST
    assert lines[-1].startswith("trackslip report "), lines
    assert (tmp_path / shlex.split(lines[-1])[-1]).stat().st_size > 100_000
