# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hatchling hooks of the wheel: its dependencies, and the platform tag of a wheel with machine code."""

import re
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

KERNELS = Path("out/wheel/kernels")  # written by make_wheel.py
_OF_ROS = ("colcon-common-extensions", "setuptools")  # build the workspace
# Oldest C library of numba 0.68's wheels; numba loads the machine code.
_PLATFORM = "manylinux_2_28_x86_64"


class Dependencies(MetadataHookInterface):
    """Dependencies: the libraries of requirements/with-apt-ros.txt with their version limits."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the dependencies; machine code requires the numba version that compiled it."""
        root = Path(self.root)
        lines = (root / "requirements/with-apt-ros.txt").read_text(encoding="utf-8").splitlines()
        names = [line.split("#")[0].strip() for line in lines]
        needed = [name for name in names if name and not name.startswith(_OF_ROS)]
        if (root / KERNELS).is_dir():
            text = (root / "requirements/libraries.txt").read_text(encoding="utf-8")
            (exact,) = re.findall(r"^numba==\S+", text, re.MULTILINE)
            needed = [exact if name.startswith("numba") else name for name in needed]
        metadata["dependencies"] = needed


class MachineCode(BuildHookInterface):
    """Adds the compiled code to the wheel, which is then specific to one Python and platform."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add files and tag before the wheel is written."""
        kernels = Path(self.root) / KERNELS
        if kernels.is_dir():
            python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
            build_data["pure_python"] = False
            build_data["tag"] = f"{python}-{python}-{_PLATFORM}"
            build_data["force_include"][str(kernels)] = "trackslip_common/kernels"
