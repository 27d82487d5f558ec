# SPDX-License-Identifier: Apache-2.0
"""A calibration as a table for people, and as a parameter file for the nodes with its evidence in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from trackslip_common.errors import InputError
from trackslip_tools.calibration.calibrate import Calibration
from trackslip_tools.calibration.finding import Finding


def text(calibration: Calibration) -> str:
    """One line for each number, found or not."""
    return "\n".join(_line(name, finding) for name, finding in calibration.findings.items())


def summary(calibration: Calibration, bags: Sequence[str]) -> dict[str, Any]:
    """The contents of ``--json``."""
    return {
        "bags": list(bags),
        "findings": {name: finding.as_dict() for name, finding in calibration.findings.items()},
        "parameters": {node: dict(values) for node, values in calibration.parameters.items()},
    }


def write_parameters(path: Path, calibration: Calibration, bags: Sequence[str]) -> None:
    """A ROS parameter file for the nodes; the evidence stands above as comments.

    Raises:
        InputError: the file cannot be written.
    """
    evidence = [f"from {bag}" for bag in bags] + text(calibration).splitlines()
    content = {node: {"ros__parameters": _nested(v)} for node, v in calibration.parameters.items()}
    lines = [*(f"# {line}" for line in evidence), yaml.safe_dump(content, sort_keys=False)]
    try:
        path.write_text("\n".join(lines), encoding="utf-8")
    except OSError as error:
        raise InputError(f"--output: '{path}' cannot be written ({error.strerror})") from error


def _line(name: str, finding: Finding) -> str:
    if finding.value is None or finding.interval is None:
        return f"{name:<22} –  {finding.reason}"
    low, high = finding.interval
    unit = "" if finding.unit == "1" else f" {finding.unit}"
    return f"{name:<22} {finding.value:.5g}{unit}  [{low:.5g}, {high:.5g}]  {finding.basis}"


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted names as groups, in the form of a parameter file."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *groups, last = name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = value
    return tree
