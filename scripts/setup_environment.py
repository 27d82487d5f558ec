# SPDX-License-Identifier: Apache-2.0
"""The variables that ROS 2 and the workspace live by: for the build, and for every python of ``.venv``."""

from __future__ import annotations

import json
import os
import shutil
import sys

import environment_hook
from setup_commands import ROOT

VENV = ROOT / ".venv"
WORKSPACE = ROOT / "ros2_ws"
SYSTEM = "system"  # the ROS 2 that is sourced, in place of wheels

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
SITE = VENV / "lib" / PYTHON / "site-packages"
HOOK = SITE / "_trackslip.pth"
PATH_VARIABLES = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH")


def bare_environment() -> dict[str, str]:
    """This process's environment without the caller's make and without any ROS."""
    dropped = {"MAKEFLAGS", "MAKELEVEL", "MFLAGS", environment_hook.GUARD, *PATH_VARIABLES}
    return {name: value for name, value in os.environ.items() if name not in dropped}


def build_environment(ros: str) -> dict[str, str]:
    """ROS and ``.venv``, but nothing of the workspace that is to be built."""
    path = os.pathsep.join([str(VENV / "bin"), os.environ.get("PATH", os.defpath)])
    paths = {name: os.pathsep.join(paths) for name, paths in _ros_paths(ros).items()}
    return bare_environment() | {"PATH": path, "VIRTUAL_ENV": str(VENV)} | paths | _ros_values(ros)


def install_hook(ros: str, stamp: str) -> None:
    """Has every python of ``.venv`` start within ROS and the workspace, and makes ``trackslip`` a command."""
    packages = sorted(path.parent.name for path in (ROOT / "src").glob("*/package.xml"))
    prefixes = [WORKSPACE / "install" / name for name in packages]
    libraries = sorted({str(file.parent) for prefix in prefixes for file in prefix.glob("lib/*.so")})
    paths = _ros_paths(ros)
    paths["AMENT_PREFIX_PATH"] = [*map(str, prefixes), *paths["AMENT_PREFIX_PATH"]]
    paths["CMAKE_PREFIX_PATH"] = [*map(str, prefixes), *paths["CMAKE_PREFIX_PATH"]]
    paths["LD_LIBRARY_PATH"] = [*libraries, *paths["LD_LIBRARY_PATH"]]
    settings = {"values": _ros_values(ros), "defaults": _defaults(ros), "paths": paths}
    (SITE / "_trackslip_environment.json").write_text(json.dumps(settings, indent=1))
    shutil.copyfile(environment_hook.__file__, SITE / "_trackslip_environment.py")

    python_packages = [name for name in packages if (ROOT / "src" / name / "setup.py").is_file()]
    modules = [ROOT / "src" / name for name in python_packages]
    modules += [WORKSPACE / "build" / name for name in python_packages]  # version and entry points
    modules += [path for prefix in prefixes for path in prefix.glob(f"lib/{PYTHON}/site-packages")]
    enter = f"import _trackslip_environment; _trackslip_environment.enter({stamp!r})"
    HOOK.write_text("\n".join([enter, *map(str, modules)]) + "\n")

    command = VENV / "bin" / "trackslip"
    command.unlink(missing_ok=True)
    command.symlink_to(WORKSPACE / "install/trackslip_tools/lib/trackslip_tools/trackslip")


def _ros_paths(ros: str) -> dict[str, list[str]]:
    """Where ROS itself is found, per variable."""
    if ros != SYSTEM:
        libraries = [str(VENV / "lib"), *sorted(str(path) for path in SITE.glob("ros_*.libs"))]
        prefix = [str(VENV)]
        return {"AMENT_PREFIX_PATH": prefix, "CMAKE_PREFIX_PATH": prefix, "LD_LIBRARY_PATH": libraries}
    sourced = {name: os.environ.get(name, "").split(os.pathsep) for name in PATH_VARIABLES}
    ours = str(ROOT)
    return {
        name: [path for path in paths if path and not path.startswith(ours)]
        for name, paths in sourced.items()
    }


def _ros_values(ros: str) -> dict[str, str]:
    """Variables that have these values and no others; the last saves the wheels' own hook its work."""
    if ros == SYSTEM:
        return {name: value for name, value in os.environ.items() if name in ("ROS_DISTRO", "ROS_VERSION")}
    values = {"ROS_DISTRO": ros, "ROS_VERSION": "2", "ROS_PYTHON_VERSION": "3"}
    return values | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}


def _defaults(ros: str) -> dict[str, str]:
    """Variables that the user may have set otherwise. A ROS from apt keeps the settings of its vehicle."""
    if ros == SYSTEM:
        return {}
    return {
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "FASTDDS_DEFAULT_PROFILES_FILE": str(ROOT / "config" / "fastdds.xml"),
    }
