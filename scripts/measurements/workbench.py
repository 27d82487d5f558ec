# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs commands of ``trackslip``, written as on a page, in this process, and returns their results."""

import io
import json
import shlex
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import yaml

from trackslip_tools.cli.main import main

SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")


class NotMeasured(Exception):
    """A log that is not part of the project is missing, or a command failed."""


def run(line: str, folder: Path) -> str:
    """Output of ``trackslip LINE``; ``{}`` in the line stands for ``folder``.

    Raises:
        NotMeasured: the command failed.
    """
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        code = main(shlex.split(line.replace("{}", str(folder))))
    if code:
        raise NotMeasured(f"trackslip {line}: {output.getvalue().strip()}")
    return output.getvalue()


def trackslip(line: str, folder: Path) -> Any:
    """JSON result of a command; see ``run``."""
    file = folder / "result.json"
    run(f"{line} --json {file}", folder)
    return json.loads(file.read_text(encoding="utf-8"))


def write_yaml(path: Path, content: Any) -> Path:
    """Write a YAML file of a vehicle, scenario or mapping; returns its path."""
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path
