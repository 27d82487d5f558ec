# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip``: the command line. Only the module of the requested command is loaded."""

import argparse
import atexit
import gc
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from trackslip_common import __version__
from trackslip_common.compiling import announce_compilation
from trackslip_common.console import escape_unencodable, report_output_failure
from trackslip_common.errors import ExitCode, InputError, did_you_mean
from trackslip_common.start import collect_garbage_seldom, repeat_lost_interrupts, was_interrupted
from trackslip_tools.cli import progress
from trackslip_tools.cli.commands import Command, installed_commands
from trackslip_tools.cli.elapsed import begin_command


class _Parser(argparse.ArgumentParser):
    """argparse with errors as one line on stderr."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError for the command line."""
        raise InputError(f"{self.prog}: {message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """Print the version and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        print(f"trackslip {__version__}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    if argv is None:  # in a process of its own
        _open_closed_output()
        escape_unencodable()
        repeat_lost_interrupts()
        collect_garbage_seldom()
        atexit.register(gc.freeze)  # skips the final garbage collection: 0.3 s
    else:
        begin_command()
    try:
        args = parse_arguments(sys.argv[1:] if argv is None else argv)
        with announce_compilation(progress.show_status):
            code: int = args.run(args)
        sys.stdout.flush()
        return code
    except InputError as error:
        print(error, file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    except OSError as error:
        return report_output_failure("trackslip", error)
    except Exception:
        if was_interrupted():
            return ExitCode.INTERRUPTED
        raise


def _open_closed_output() -> None:
    """Replace a closed stdout or stderr (``>&-``), which Python sets to None, by /dev/null."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 (open until the end)
            setattr(sys, name, nowhere)


def parse_arguments(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of a command, and its ``run`` function.

    Raises:
        InputError: the command or an argument is unknown.
    """
    commands = installed_commands()
    requested = next((word for word in argv if not word.startswith("-")), None)
    if requested is not None and requested not in commands:
        raise InputError(
            f"trackslip: no command '{requested}'{did_you_mean(requested, commands)} (see trackslip --help)"
        )
    parser = _Parser(
        prog="trackslip",
        description="The workbench around bags.",
        epilog="begin with: trackslip demo; with a machine of yours: trackslip vehicle new --mass 20000 "
        "--tread 2.4; 'trackslip COMMAND --help' has an example of each",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version, and exit")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, command in commands.items():
        _add_command(subparsers, name, command, whole=name == requested)
    args, unknown = parser.parse_known_args(argv)
    if unknown and requested is not None:
        _refuse_arguments(unknown, subparsers.choices[requested])
    return args


def _refuse_arguments(unknown: Sequence[str], parser: argparse.ArgumentParser) -> NoReturn:
    """Raise InputError for a mistyped option or an extra word."""
    options = [option for action in parser._actions for option in action.option_strings]
    hint = did_you_mean(unknown[0], options) if unknown[0].startswith("-") else ""
    words = " ".join(unknown)
    raise InputError(f"{parser.prog}: unrecognized arguments: {words}{hint} (see {parser.prog} --help)")


def _add_command(subparsers: Any, name: str, command: Command, *, whole: bool) -> None:
    """Add a command; ``whole``: with its arguments, which requires its module."""
    text = command.description.replace("%", "%%")  # argparse formats this text
    parser = subparsers.add_parser(name, help=text, description=command.description)
    if whole:
        module = importlib.import_module(command.module)
        parser.epilog = f"example: {module.EXAMPLE}"
        module.add_arguments(parser)
        parser.set_defaults(run=module.run)


if __name__ == "__main__":
    sys.exit(main())
