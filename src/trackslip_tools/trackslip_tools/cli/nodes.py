# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Loads the nodes of the few commands that need ROS; all other commands run without ROS."""

import importlib
import json
import os
import sys
from collections.abc import Mapping
from typing import Any

from trackslip_common.errors import InputError


def load_node_module(name: str, asked_by: str) -> Any:
    """The module of a node, by its full name.

    Raises:
        InputError: ROS is not available; ``asked_by`` is the start of the message.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        why = f"ROS is not available (no module {error.name})"
        text = f"{asked_by}: {why}; accepted: a shell that sourced its setup"
        raise InputError(text) from error


def run_node(module: str, name: str, options: Mapping[str, Any], *further: str) -> int:
    """Run a node until it ends; returns its exit code.

    Args:
        module: its full name.
        name: of the node, and of its function in the module.
        options: parameters of the node.
        further: arguments of ROS.

    Raises:
        InputError: ROS is not available.
    """
    words = [word for key, value in options.items() for word in ("-p", f"{key}:={json.dumps(value)}")]
    code: int = getattr(load_node_module(module, name), name)(["--ros-args", *words, *further])
    return code


def shorten_logs() -> None:
    """Omit date and node name from ROS log lines: there is only one node here.

    On a terminal, a log line replaces the progress display, which appears again below it.
    """
    begin = "\r\x1b[K" if sys.stderr.isatty() else ""
    os.environ.setdefault("RCUTILS_CONSOLE_OUTPUT_FORMAT", f"{begin}[{{severity}}] {{message}}")
