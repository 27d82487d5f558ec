# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The built workspace: declared files of the packages are installed where ROS 2 and users look for them."""

import configparser
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.patience import PATIENCE

from trackslip_common.config_files import config_directory
from trackslip_estimation.slip.motion import Motion

ROOT = Path(__file__).resolve().parents[2]
INSTALL = ROOT / "ros2_ws" / "install"
PACKAGES = sorted(path.parent for path in ROOT.glob("src/*/package.xml"))
PYTHON_PACKAGES = [package.name for package in PACKAGES if (package / "setup.py").is_file()]
EXECUTABLES = {
    "trackslip_bags": {"record"},
    "trackslip_drivers": {"can_driver", "watson_imu", "sick_pls", "nmea_gnss", "wheel_adapter"},
    "trackslip_estimation": {"box_localizer", "gnss_localizer", "slip_estimator", "soil_estimator", "record"},
    "trackslip_tools": {"trackslip", "live"},
    "trackslip_sim": {"emulator", "demo"},
}


@pytest.mark.parametrize("name", ["TrackSlip", "MachineState"])
def test_messages_number_the_states_of_motion_as_the_estimator_does(name: str) -> None:
    import trackslip_msgs.msg

    kind = getattr(trackslip_msgs.msg, name)
    assert [getattr(kind, state.name) for state in Motion] == list(Motion)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_package_is_described_and_indexed(package: Path) -> None:
    description = ElementTree.parse(package / "package.xml").getroot()
    assert description.get("format") == "3"
    assert description.findtext("name") == package.name
    assert description.findtext("license") == "Apache-2.0"
    share = INSTALL / package.name / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / package.name).exists()
    assert (share / package.name / "package.xml").is_file()


@pytest.mark.parametrize("package", EXECUTABLES)
def test_executables_are_installed_where_ros2_run_finds_them(package: str) -> None:
    folder = INSTALL / package / "lib" / package
    runnable = {path.name for path in folder.iterdir() if os.access(path, os.X_OK)}
    assert runnable == EXECUTABLES[package]
    options = configparser.ConfigParser()
    options.read(ROOT / "src" / package / "setup.cfg")
    assert options["install"]["install_scripts"] == f"$base/lib/{package}"


@pytest.mark.parametrize("package", EXECUTABLES)
def test_executables_have_code_behind_them(package: str) -> None:
    declared = [e for e in entry_points(group="console_scripts") if e.value.startswith(f"{package}.")]
    assert {entry.name for entry in declared} == EXECUTABLES[package]
    assert [entry.value for entry in declared if find_spec(entry.module) is None] == []


def test_all_configuration_and_launch_files_are_installed() -> None:
    files = {path.relative_to(ROOT / "config") for path in (ROOT / "config").rglob("*") if path.is_file()}
    installed = config_directory()
    assert {path.relative_to(installed) for path in installed.rglob("*") if path.is_file()} == files
    for launch in ROOT.glob("src/*/launch/*.launch.py"):
        package = launch.parents[1].name
        assert (INSTALL / package / "share" / package / "launch" / launch.name).is_file()


made_by_setup = pytest.mark.skipif(Path(sys.prefix) != ROOT / ".venv", reason="not the python of make setup")


def from_nothing(*command: str, **environment: str) -> str:
    """Output of a command started in an otherwise empty environment; stderr must be empty."""
    result = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=PATIENCE, cwd=ROOT
    )
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


@made_by_setup
def test_python_needs_nothing_sourced() -> None:
    """Python of ``.venv`` in an empty environment finds ROS, the messages and the packages of the project."""
    program = f"import sys, rclpy, trackslip_msgs.msg, {', '.join(PYTHON_PACKAGES)}; print(sys.argv[1:])"
    assert from_nothing(sys.executable, "-c", program, "one", "two words") == "['one', 'two words']\n"


@made_by_setup
def test_plain_python_makes_a_publisher_of_our_messages(domain: int, tmp_path: Path) -> None:
    """Creating a publisher loads the message libraries by name from the wheels' search path."""
    if os.environ.get("_ROS_WHEELS_BOOTSTRAP_COMPLETE") is None:
        pytest.skip("ROS is not from wheels")
    program = """
import rclpy
from trackslip_msgs.msg import TrackSlip
rclpy.init()
rclpy.create_node("plain").create_publisher(TrackSlip, "slip", 1).publish(TrackSlip())
rclpy.shutdown()
"""
    environment = {"HOME": str(tmp_path), "ROS_DOMAIN_ID": str(domain)}
    assert from_nothing(sys.executable, "-c", program, **environment) == ""


@made_by_setup
def test_no_code_of_ours_runs_at_the_start_of_python() -> None:
    site = Path(np.__file__).parents[1]
    lines = (site / "trackslip.pth").read_text(encoding="utf-8").splitlines()
    assert all(Path(line).is_dir() for line in lines)
    assert [path.name for path in site.glob("*trackslip*")] == ["trackslip.pth"]


@pytest.mark.parametrize("script", ["ros2_ws/install/setup.bash", ".venv/bin/activate"])
def test_sourcing_finds_all_packages(script: str) -> None:
    """Every package is on AMENT_PREFIX_PATH, where ros2 run, launch and interface look for it."""
    if Path(sys.prefix) != ROOT / ".venv" and script.startswith(".venv"):
        pytest.skip("not the python of make setup")
    output = from_nothing("bash", "-c", f'PATH=/usr/bin:/bin; . {script}; echo "$AMENT_PREFIX_PATH"')
    assert {str(INSTALL / package.name) for package in PACKAGES} <= set(output.strip().split(":"))


@made_by_setup
def test_sourcing_twice_keeps_the_environment_and_the_settings_of_the_user() -> None:
    once = "export RMW_IMPLEMENTATION=mine; . .venv/trackslip.sh"
    first, second = (from_nothing("sh", "-c", f"{lines}; exec env") for lines in (once, f"{once}; {once}"))
    assert "RMW_IMPLEMENTATION=mine" in first.splitlines()
    assert sorted(second.splitlines()) == sorted(first.splitlines())


@made_by_setup
def test_command_needs_nothing_sourced() -> None:
    assert "trackslip vehicle new" in from_nothing(str(ROOT / ".venv" / "bin" / "trackslip"), "--help")


def test_recorder_answers_by_its_name_in_the_estimators_too(programs: Any) -> None:
    """``ros2 run trackslip_estimation record`` is an alias of the recorder in trackslip_bags."""
    alias = INSTALL / "trackslip_estimation" / "lib" / "trackslip_estimation" / "record"
    recorder = programs.start(str(alias), "--ros-args", "-p", "output:=bag")
    bag = programs.folder / "bag"
    recorder.until(lambda: bag.is_dir() and any(bag.iterdir()), "a bag")
    assert recorder.end()[0] == 0


def test_fast_dds_reads_the_profiles_that_set_up_names(programs: Any, tmp_path: Path) -> None:
    """Fast DDS 2 and 3 have a variable and a file each: 2 ignores that of 3; 3 refuses the file of 2."""
    names = [name for name in os.environ if name.endswith("_PROFILES_FILE")]
    if not names:
        pytest.skip("a ROS from apt keeps the profiles of its vehicle")
    make_node = "import rclpy; rclpy.init(); rclpy.create_node('profiled'); rclpy.shutdown()"
    accepted = programs.python("-c", make_node)
    assert accepted.wait() == 0
    broken = tmp_path / "broken.xml"
    broken.write_text("<profiles", encoding="utf-8")
    programs.environment |= dict.fromkeys(names, str(broken))
    refused = programs.python("-c", make_node)
    refused.wait()
    assert "XMLPARSER" not in accepted.stdout + accepted.stderr
    assert "XMLPARSER" in refused.stdout + refused.stderr


@pytest.mark.slow
@pytest.mark.skipif(find_spec("colcon_core") is None, reason="colcon is another python's")
@pytest.mark.parametrize("layout", [[], ["--merge-install"]], ids=["isolated", "merged"])
def test_command_is_on_the_path_after_a_build_by_hand(layout: list[str], tmp_path: Path) -> None:
    build = [sys.executable, "-m", "colcon", "--log-base", str(tmp_path / "log"), "build", *layout]
    places = [f"--{place}-base={tmp_path / place}" for place in ("build", "install")]
    packages = ["--base-paths", str(ROOT / "src" / "trackslip_tools")]
    subprocess.run(
        [*build, *places, *packages], check=True, capture_output=True, cwd=tmp_path, timeout=PATIENCE
    )
    script = f". {tmp_path / 'install' / 'setup.bash'} && command -v trackslip && trackslip --version"
    place, version = from_nothing("bash", "-c", f"PATH={os.defpath}; {script}").splitlines()
    assert Path(place).parent in {
        tmp_path / "install" / "bin",
        tmp_path / "install" / "trackslip_tools" / "bin",
    }
    assert version.startswith("trackslip ")
