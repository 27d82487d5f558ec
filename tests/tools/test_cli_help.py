# SPDX-License-Identifier: Apache-2.0
"""``trackslip --help`` lists every command; the help of each ends with an example that it would take."""

import shlex

import pytest

from trackslip_tools.cli import main as cli

COMMANDS = tuple(cli._COMMANDS)


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--help"])
    assert ended.value.code == 0
    return " ".join(capsys.readouterr().out.split())


def test_all_commands_are_listed_with_what_they_do(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys)
    assert [name for name in COMMANDS if f" {name} " not in text] == []
    assert "95 % intervals" in text
    assert "example: trackslip info" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_each_ends_with_an_example_that_parses(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    example = told(capsys, command).rpartition("example: ")[2]
    program, *arguments = shlex.split(example)
    assert (program, arguments[0]) == ("trackslip", command)
    assert callable(cli._parser().parse_args(arguments).run)
