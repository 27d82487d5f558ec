# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip --help`` lists every command; the help of each ends with a valid example."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from trackslip_common.errors import ExitCode
from trackslip_tools.cli import main as cli
from trackslip_tools.cli.commands import installed_commands

COMMANDS = tuple(installed_commands())

ROOT = Path(__file__).parents[2]


def help_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--help"])
    assert ended.value.code == 0
    return " ".join(capsys.readouterr().out.split())


def test_all_commands_are_listed_with_what_they_do(capsys: pytest.CaptureFixture[str]) -> None:
    text = help_of(capsys)
    assert [name for name in COMMANDS if f" {name} " not in text] == []
    assert "95 % intervals" in text
    assert "trackslip vehicle new" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_each_ends_with_an_example_that_parses(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    example = help_of(capsys, command).rpartition("example: ")[2]
    program, *arguments = shlex.split(example)
    assert (program, arguments[0]) == ("trackslip", command)
    assert callable(cli.parse_arguments(arguments).run)


@pytest.mark.parametrize(
    ("command", "hint"),
    [("repaly", ", did you mean 'replay'?"), ("xyzzy", ""), ("inf", ", did you mean 'info'?")],
)
def test_an_unknown_command_is_refused_in_one_line(
    command: str, hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([command, "bag"]) == ExitCode.BAD_INPUT
    assert capsys.readouterr().err == f"trackslip: no command '{command}'{hint} (see trackslip --help)\n"


HEAVY = {"numba", "scipy", "rich", "bokeh", "matplotlib", "dask"}


@pytest.mark.parametrize(
    ("arguments", "barred"),
    [
        (["--help"], HEAVY | {"numpy", "yaml", "rosbags", "mcap"}),
        (["replay", "--help"], {"bokeh", "matplotlib", "dask", "rclpy"}),
        (["info", "bags/slalom_sand"], HEAVY | {"rclpy"}),
        (["recover", "--help"], HEAVY),
        (["record", "--help"], HEAVY | {"rosbags", "numpy"}),
    ],
)
def test_command_loads_no_library_it_does_not_need(arguments: list[str], barred: set[str]) -> None:
    """Each command runs in a separate process."""
    code = f"""
import sys
from trackslip_tools.cli.main import main
try:
    main({arguments!r})
except SystemExit:
    pass
print(*({barred!r} & set(sys.modules)))
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == ""
