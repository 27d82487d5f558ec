# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A calibration as a table for the terminal, and as a parameter file for the nodes with its evidence."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from trackslip_common.config_files import unflatten
from trackslip_common.errors import printable
from trackslip_tools.calibration.calibrate import Calibration
from trackslip_tools.calibration.finding import Finding, round_value
from trackslip_tools.cli.outputs import write_file
from trackslip_tools.terminal_text import WIDTH, wrap_line

FILE_PREFIX = "# from "  # first characters of the parameter file


def text(calibration: Calibration) -> str:
    """A line for each finding with its evidence, then the values to adopt, and the confirmed parameters."""
    lines = [line for name, finding in calibration.findings.items() for line in _finding_lines(name, finding)]
    adopted = {name: value for values in calibration.parameters.values() for name, value in values.items()}
    listed = ", ".join(f"{name} {value:g}" for name, value in adopted.items())
    lines.append(f"to adopt (--output writes it): {listed or 'nothing'}")
    if calibration.confirmed:
        names = ", ".join(calibration.confirmed)
        lines.append(f"consistent with the parameters, not written (--all writes it): {names}")
    return "\n".join(map(wrap_line, lines))


def summary(calibration: Calibration, bags: Sequence[str]) -> dict[str, Any]:
    """The contents of ``--json``."""
    return {
        "bags": list(bags),
        "findings": {name: asdict(finding) for name, finding in calibration.findings.items()},
        "parameters": {node: dict(values) for node, values in calibration.parameters.items()},
    }


def write_parameters(path: Path, calibration: Calibration, bags: Sequence[str]) -> None:
    """Write a ROS parameter file for the nodes; comments at its top hold the evidence.

    Raises:
        InputError: the file cannot be written.
    """
    evidence = text(calibration).splitlines()
    content = {node: {"ros__parameters": unflatten(v)} for node, v in calibration.parameters.items()}
    names = [printable(bag, len(bag)) for bag in bags]
    heads = [*(f"{FILE_PREFIX}{name}" for name in names), *(f"# {line}" for line in evidence)]
    lines = [*heads, yaml.safe_dump(content, sort_keys=False)]
    write_file("output", path, "\n".join(lines))


def _finding_lines(name: str, finding: Finding) -> list[str]:
    if finding.value is None or finding.interval is None:
        return [f"{name:<25}–  {finding.reason}"]
    value, low, high = (
        f"{round_value(number, finding.decimals):.{max(finding.decimals, 0)}f}"
        for number in (finding.value, *finding.interval)
    )
    unit = "" if finding.unit == "1" else finding.unit
    line = f"{name:<25}{value:>11} {unit:<6}[{low}, {high}]"
    whole = f"{line:<69}{finding.basis}"
    return [whole] if len(whole) <= WIDTH else [line, f"  {finding.basis}"]
