# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The units of ``deploy/systemd``: each command starts and works in the file system of its service."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from fixtures.programs import INSTALL
from fixtures.units import ROOT, SYSTEMD, Unit, refusal

NODES = {
    "trackslip-drivers": ("can_driver", "watson_imu", "sick_pls"),
    "trackslip-navigation": ("box_localizer", "slip_estimator", "soil_estimator"),
    "trackslip-record": ("record",),
}
CAN_DEVICE = "sys-subsystem-net-devices-can0.device"
# Copy the kernels that make setup compiled (directories named by digest) to the units' directory.
COPY_KERNELS = """find "$CHECKOUT/src" -type d -path '*/__pycache__/????????????????' \\
    -exec cp -r {} /var/lib/trackslip/kernels \\;"""
SCRIPT = Path(sys.prefix) / "trackslip.sh"

confined = pytest.mark.skipif(bool(refusal()), reason=f"no mount namespace: {refusal()}")


def started(programs: Any, unit: str, preparation: str = "") -> Any:
    """Start the unit's command in the test's domain, with the setup file and ros2 of this installation."""
    here = {
        "TRACKSLIP_SETUP": str(SCRIPT if SCRIPT.is_file() else INSTALL / "setup.bash"),
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(ROOT / "config" / "fastrtps.xml"),
        **{name: programs.environment[name] for name in ("ROS_DOMAIN_ID", "TRACKSLIP_TEST")},
    }
    path = f"{Unit(SYSTEMD / f'{unit}.service').environment()['PATH']}:{ROOT / 'tests' / 'fixtures' / 'bin'}"
    return programs.start(*Unit(SYSTEMD / f"{unit}.service").command(preparation, PATH=path, **here))


def test_every_unit_that_starts_nodes_is_tested() -> None:
    units = {file.stem for file in SYSTEMD.glob("*.service")}
    assert units - {"trackslip-can"} == {*NODES}


@pytest.mark.slow
@confined
@pytest.mark.xdist_group("graph")
@pytest.mark.parametrize("unit", NODES)
def test_command_starts_its_nodes_where_only_its_own_directories_can_be_written(
    programs: Any, observer: Any, unit: str
) -> None:
    program = started(programs, unit, COPY_KERNELS)
    observer.wait_until_active(*NODES[unit])
    assert "Traceback" not in program.stderr


@confined
@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.xdist_group("graph")
@pytest.mark.parametrize("unit", NODES)
def test_command_works_for_half_a_minute_with_kernels_of_its_own(
    programs: Any, observer: Any, unit: str
) -> None:
    healths = observer.healths()
    program = started(programs, unit)

    def not_active() -> set[str]:
        """Nodes that have not reported to be active; a compiling node does not answer requests."""
        active = {
            h.name for h in healths if h.message != "inactive" and not h.message.startswith("compiling")
        }
        return {*NODES[unit]} - active

    observer.wait(lambda: not not_active(), "all nodes to be active", deadline=1500.0)
    until = time.monotonic() + 30.0
    observer.wait(lambda: time.monotonic() > until, "30 s")
    assert [node for node in NODES[unit] if observer.state(f"/{node}") != "active"] == []
    assert "Traceback" not in program.stderr
    assert "Read-only file system" not in program.stderr
    assert program.end()[0] == 0, program.stderr


@confined
def test_only_the_directories_of_the_unit_are_writable() -> None:
    unit = Unit(SYSTEMD / "trackslip-record.service")
    writable = ["/tmp", "/var/lib/trackslip/bags", "/var/lib/trackslip/ros"]
    places = ["/etc", str(ROOT), "/var/lib", "/home", *writable]
    *around, _bash, _c, _script = unit.command()
    script = 'for p in "$@"; do touch "$p/probe" 2>/dev/null && echo "$p"; done; true'
    done = subprocess.run(
        [*around, "sh", "-c", script, "sh", *places], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == writable
    assert not Path("/tmp/probe").exists()


@pytest.mark.skipif(not shutil.which("systemctl"), reason="no systemctl")
def test_can_bus_is_brought_up_whenever_its_adapter_appears(tmp_path: Path) -> None:
    units = tmp_path / "etc" / "systemd" / "system"
    units.mkdir(parents=True)
    shutil.copy(SYSTEMD / "trackslip-can.service", units)
    subprocess.run(
        ["systemctl", f"--root={tmp_path}", "enable", "trackslip-can"], check=True, capture_output=True
    )
    unit = Unit(units / "trackslip-can.service")
    assert unit.all("BindsTo") == [CAN_DEVICE]  # stops with the adapter …
    assert (units / f"{CAN_DEVICE}.wants" / "trackslip-can.service").is_symlink()  # … and starts with it


def shell_of_the_image() -> list[str]:
    """The shell that the Dockerfile sets for ``RUN``."""
    lines = (ROOT / "deploy" / "Dockerfile").read_text(encoding="utf-8").splitlines()
    (line,) = (line for line in lines if line.startswith("SHELL "))
    words: list[str] = json.loads(line.removeprefix("SHELL "))
    return words


def test_shell_of_the_image_reads_setup_files_and_finds_the_command() -> None:
    script = f". {INSTALL / 'setup.bash'} && command -v trackslip"
    done = subprocess.run(
        [*shell_of_the_image(), script], env={"PATH": os.defpath}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(INSTALL / "trackslip_tools" / "bin" / "trackslip")
