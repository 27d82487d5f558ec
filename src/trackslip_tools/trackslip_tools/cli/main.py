# SPDX-License-Identifier: Apache-2.0
"""``trackslip``: the workbench around bags."""

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import NoReturn

from trackslip_common.errors import ExitCode, InputError

# name → module with DESCRIPTION, EXAMPLE, add_arguments and run; those of the simulator where it is installed
_COMMANDS = {
    "calibrate": "trackslip_tools.cli.calibrate_command",
    "import": "trackslip_tools.cli.import_command",
    "info": "trackslip_tools.cli.info_command",
    "record": "trackslip_tools.cli.record_command",
    "recover": "trackslip_tools.cli.recover_command",
    "replay": "trackslip_tools.cli.replay_command",
    "report": "trackslip_tools.cli.report_command",
    "simulate": "trackslip_sim.cli",
    "smooth": "trackslip_tools.cli.smooth_command",
    "study": "trackslip_sim.study.cli",
    "tune": "trackslip_tools.cli.tune_command",
}


class _Parser(argparse.ArgumentParser):
    """argparse, with one line on stderr for bad input."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        raise InputError(f"{self.prog}: {message} (see {self.prog} --help)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    try:
        args = _parser().parse_args(argv)
        code: int = args.run(args)
        return code
    except InputError as error:
        print(error, file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    except BrokenPipeError:  # the reader of our output has left
        sys.stdout = None
        return ExitCode.DONE


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="trackslip",
        description="The workbench around bags.",
        epilog="example: trackslip info out/demo/bag; 'trackslip COMMAND --help' has one for each",
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, module_name in _COMMANDS.items():
        try:
            module = importlib.import_module(module_name)
        except ModuleNotFoundError as error:
            if error.name is None or error.name not in module_name:
                raise
            continue
        command = commands.add_parser(
            name,
            help=module.DESCRIPTION.replace("%", "%%"),  # argparse puts values into this one
            description=module.DESCRIPTION,
            epilog=f"example: {module.EXAMPLE}",
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
