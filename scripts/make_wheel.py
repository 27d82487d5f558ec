# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Builds the wheel of the desk commands in dist/ (``make wheel``).

The commands themselves compile its machine code, on the example bag, for any x86-64 processor. The code is
valid for this version of Python and numba; others compile at the first run. ``--pure`` omits it.
"""

import argparse
import gc
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KERNELS, DIST = ROOT / "out/wheel/kernels", ROOT / "dist"
KEPT = ROOT / "out/wheel/compiled"  # kept between builds: unchanged kernels are not compiled again

os.environ |= {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(KEPT)}  # before numba is loaded

from trackslip_common.machine_code import KernelCache  # noqa: E402
from trackslip_sim.demo import warm_up  # noqa: E402
from trackslip_tools.cli.main import main as trackslip  # noqa: E402

EXAMPLE = str(ROOT / "bags/example")
COMMANDS = (
    ("replay", EXAMPLE),
    ("check", EXAMPLE),
    ("calibrate", EXAMPLE),
    ("smooth", EXAMPLE, "--output", "smoothed"),
    ("demo", "--duration", "8", "--no-browser"),
    ("demo", "--vehicle", "pc05", "--duration", "8", "--output", "laser", "--no-browser"),  # the box
)


def main() -> int:
    """Compile the kernels and build the wheel; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pure", action="store_true", help="without machine code")
    arguments = parser.parse_args()
    shutil.rmtree(KERNELS, ignore_errors=True)
    shutil.rmtree(DIST, ignore_errors=True)
    if not arguments.pure and platform.machine() == "x86_64":
        compile_kernels()
    environment = os.environ | {"SOURCE_DATE_EPOCH": os.environ.get("SOURCE_DATE_EPOCH", "1577836800")}
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(DIST)]
    return subprocess.run(command, cwd=ROOT, env=environment).returncode


def compile_kernels() -> None:
    """Run the users' commands, and copy the machine code of the current sources to ``KERNELS``."""
    os.environ.pop("ROS_DISTRO", None)
    with tempfile.TemporaryDirectory() as folder:
        before = Path.cwd()
        os.chdir(folder)
        for command in COMMANDS:
            print(f"$ trackslip {' '.join(command)}", flush=True)
            trackslip(command)
        os.chdir(before)
    warm_up.main(["soil", "box"])
    caches = [each for each in gc.get_objects() if isinstance(each, KernelCache)]
    for directory in {Path(each.cache_path) for each in caches if Path(each.cache_path).is_dir()}:
        shutil.copytree(directory, KERNELS / directory.name)


if __name__ == "__main__":
    sys.exit(main())
