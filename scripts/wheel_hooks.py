# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What pyproject.toml cannot say of the wheel: its dependencies, and the tag of one with machine code."""

import re
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

KERNELS = Path("out/wheel/kernels")  # by make_wheel.py
_OF_ROS = ("colcon-common-extensions", "setuptools")  # build the workspace
# Numba's wheels of 0.68 run from this version of the C library on; the machine code is loaded by numba.
_PLATFORM = "manylinux_2_28_x86_64"


class Dependencies(MetadataHookInterface):
    """The libraries of requirements/with-apt-ros.txt, at any version from there on."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in; with machine code the version of numba is that which made it."""
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
    """Puts what was compiled into the wheel, which then is of one Python on one platform."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Before the wheel is written."""
        kernels = Path(self.root) / KERNELS
        if kernels.is_dir():
            python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
            build_data["pure_python"] = False
            build_data["tag"] = f"{python}-{python}-{_PLATFORM}"
            build_data["force_include"][str(kernels)] = "trackslip_common/kernels"
