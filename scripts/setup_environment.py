# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the environment of ROS 2 and the workspace to files, for shells and the Python of ``.venv``.

``.venv`` with wheels becomes a ROS prefix like ``/opt/ros/jazzy``: colcon's ``setup.bash`` of the workspace
sources its ``local_setup.sh`` first. The result of sourcing is stored, since sourcing takes a quarter of a
second. ``make``, ``.venv/bin/trackslip`` and ``activate`` read variables from ``.venv/trackslip.sh``. A plain
``.venv/bin/python`` reads module paths from ``trackslip.pth``.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys

from setup_commands import ROOT, SetupError, write_file, write_stamp

VENV = ROOT / ".venv"
VENV_STAMP = VENV / "trackslip.json"  # state of .venv, complete or not
WORKSPACE = ROOT / "ros2_ws"
SYSTEM = "system"  # the sourced ROS 2 instead of wheels

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
SITE = VENV / "lib" / PYTHON / "site-packages"
ENVIRONMENT = VENV / "trackslip.sh"
LISTS = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PATH")
# Set only if the user has not; a ROS from apt keeps the settings of its vehicle.
DEFAULTS = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
PROFILES = {  # Fast DDS 2 or 3 of a ROS: each reads its own file, named by its own variable
    "jazzy": ("FASTRTPS_DEFAULT_PROFILES_FILE", "fastrtps.xml"),
    "kilted": ("FASTDDS_DEFAULT_PROFILES_FILE", "fastdds.xml"),
}
USERS = (*DEFAULTS, *(variable for variable, _ in PROFILES.values()))
_PREPEND = """\
_trackslip_prepend() {
  eval "_trackslip_now=\\"\\${$1-}\\""
  case ":$_trackslip_now:" in
    *":$2:"*) ;;
    *) export "$1=$2${_trackslip_now:+:$_trackslip_now}" ;;
  esac
}
"""
_WRAPPER = """\
#!/bin/sh
. {environment}
exec {python} -m trackslip_tools.cli.main "$@"
"""


def bare_environment(keep_ros: bool = False) -> dict[str, str]:
    """This process's environment without the caller's make, without this checkout, and without ROS."""
    dropped = {"MAKEFLAGS", "MAKELEVEL", "MFLAGS", "VIRTUAL_ENV", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", *USERS}
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    for name in (*LISTS, "PYTHONPATH"):
        paths = [path for path in environment.pop(name, "").split(os.pathsep) if path]
        others = [path for path in paths if not path.startswith(f"{ROOT}{os.sep}")]
        if others and (keep_ros or name == "PATH"):
            environment[name] = os.pathsep.join(others)
    return environment


def clear_venv(ros: str) -> None:
    """Remove all from ``.venv`` except a stamp, from which the next run resumes.

    Raises:
        SetupError: no earlier set-up made it, or a file in it cannot be removed.
    """
    contents = list(VENV.iterdir()) if VENV.is_dir() else []
    names = [path.name.lstrip(".") for path in contents]
    is_ours = not contents or any(name.startswith("trackslip") for name in names)  # the stamp may be missing
    if not is_ours or (os.path.lexists(VENV) and not VENV.is_dir()):
        raise SetupError(f"{VENV} was not made by make setup, and stays; move it away and run this again")
    try:
        VENV.mkdir(exist_ok=True)
        write_stamp(VENV_STAMP, "", ros)
        for path in contents:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path != VENV_STAMP:
                path.unlink(missing_ok=True)
    except OSError as error:
        raise SetupError(f"{error.filename} cannot be replaced ({error.strerror})") from error


def build_command(ros: str, command: list[str]) -> tuple[list[str], dict[str, str]]:
    """The command and its environment: ROS and ``.venv``, without the workspace to be built."""
    if ros != SYSTEM:
        command = ["sh", "-c", f". {shlex.quote(str(VENV / 'local_setup.sh'))}; exec {shlex.join(command)}"]
        return command, bare_environment()
    environment = bare_environment(keep_ros=True)
    return command, environment | {"PATH": f"{VENV / 'bin'}{os.pathsep}{environment['PATH']}"}


def write_local_setup(ros: str) -> None:
    """Make ``.venv`` a prefix that colcon's setup files source like ``/opt/ros/jazzy``."""
    libraries = [VENV / "lib", *sorted(SITE.glob("ros_*.libs"))]
    lists = {
        "AMENT_PREFIX_PATH": str(VENV),
        "CMAKE_PREFIX_PATH": str(VENV),
        "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries)),
        "PATH": str(VENV / "bin"),
    }
    values = {"ROS_DISTRO": ros, "ROS_VERSION": "2", "ROS_PYTHON_VERSION": "3"}
    values["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"  # else the wheels start each python twice to set these
    text = f"# Made by make setup: ROS 2 {ros} from wheels, for colcon's setup files.\n"
    variable, profiles = PROFILES[ros]
    text += _assignments(lists, values, DEFAULTS | {variable: str(ROOT / "config" / profiles)})
    for shell in ("sh", "bash", "zsh"):
        write_file(VENV / f"local_setup.{shell}", text)


def install_environment(ros: str) -> None:
    """Store the result of sourcing the built workspace for ``activate`` and ``trackslip``."""
    variables = _sourced()
    packages = sorted(path.parent for path in (ROOT / "src").glob("*/setup.py"))
    modules = [*map(str, packages), *variables.pop("PYTHONPATH", "").split(os.pathsep)]
    write_file(SITE / "trackslip.pth", "\n".join(modules) + "\n")

    lists = {name: variables.pop(name) for name in LISTS if name in variables}
    defaults = {name: variables.pop(name) for name in USERS if name in variables}
    text = "# Made by make setup: what sourcing ros2_ws/install/setup.sh gave; source this or that.\n"
    write_file(ENVIRONMENT, text + _assignments(lists, variables, defaults))

    environment, python = shlex.quote(str(ENVIRONMENT)), shlex.quote(str(VENV / "bin" / "python"))
    write_file(VENV / "bin" / "trackslip", _WRAPPER.format(environment=environment, python=python), 0o755)
    activate, line = VENV / "bin" / "activate", f". {environment}"
    if line not in (text := activate.read_text(encoding="utf-8")).splitlines():
        write_file(activate, f"{text}\n{line}\n")
    if ros != SYSTEM:  # without sourcing, the wheels search libraries of messages here
        for library in WORKSPACE.glob("install/*/lib/*.so"):
            link = VENV / "lib" / library.name
            link.unlink(missing_ok=True)
            link.symlink_to(library)


def _sourced() -> dict[str, str]:
    """Variables that the workspace's setup file adds to an empty environment; of PATH, the added part."""
    before = {"PATH": os.defpath}
    script = f". {shlex.quote(str(WORKSPACE / 'install' / 'setup.sh'))} && exec env -0"
    output = subprocess.run(
        ["sh", "-c", script], env=before, capture_output=True, text=True, check=True
    ).stdout
    variables = dict(entry.split("=", 1) for entry in output.split("\0") if entry)
    variables["PATH"] = variables["PATH"].removesuffix(os.defpath).rstrip(os.pathsep)
    unwanted = ("PWD", "OLDPWD", "SHLVL", "_")
    return {name: value for name, value in variables.items() if value and name not in unwanted}


def _assignments(lists: dict[str, str], values: dict[str, str], defaults: dict[str, str]) -> str:
    """Lines for any POSIX shell: lists are prepended once, defaults set only if the variable is empty."""
    lines = [f"export {name}={shlex.quote(value)}" for name, value in values.items()]
    for name, value in defaults.items():
        lines.append(f'[ -n "${{{name}-}}" ] || export {name}={shlex.quote(value)}')
    lines += [f"_trackslip_prepend {name} {shlex.quote(value)}" for name, value in lists.items()]
    lines += ["unset -f _trackslip_prepend", "unset _trackslip_now"]
    return _PREPEND + "\n".join(lines) + "\n"
