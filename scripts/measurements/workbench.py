# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Commands of ``trackslip`` as a page has them, run in this process, and what they give."""

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
    """A log that does not come with the project is not there, or a command failed."""


def run(line: str, folder: Path) -> str:
    """What ``trackslip LINE`` prints; ``{}`` in the line stands for ``folder``.

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
    """The JSON of a command; see ``run``."""
    file = folder / "result.json"
    run(f"{line} --json {file}", folder)
    return json.loads(file.read_text(encoding="utf-8"))


def write_yaml(path: Path, content: Any) -> Path:
    """A vehicle, scenario or mapping of a measurement's own."""
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path
