# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The few commands that need ROS load their node here, so that all others run without it."""

import importlib
import os
import sys
from typing import Any

from trackslip_common.errors import InputError


def node_module(name: str, asked_by: str) -> Any:
    """The module of a node, by its whole name.

    Raises:
        InputError: ROS is not there; ``asked_by`` opens the message.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        text = (
            f"{asked_by}: ROS is not there (no module {error.name}); accepted: a shell that sourced its setup"
        )
        raise InputError(text) from error


def shorten_logs() -> None:
    """Leave out the date and the name that ROS prints before every line: there is only one node here.

    On a terminal a line takes the place of the progress that is shown, which comes again below it.
    """
    begin = "\r\x1b[K" if sys.stderr.isatty() else ""
    os.environ.setdefault("RCUTILS_CONSOLE_OUTPUT_FORMAT", f"{begin}[{{severity}}] {{message}}")
