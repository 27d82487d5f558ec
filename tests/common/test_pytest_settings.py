# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tests run with ROS from apt: beside its plugins for pytest, with the distribution's pytest."""

import os
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = [ROOT / "pyproject.toml", *sorted(ROOT.glob("src/*/pytest.ini"))]
PLUGINS = ("launch_testing", "launch_ros")
VERSIONS = {  # pytest → compatible plugins
    "7.4.4": ["pytest-rerunfailures==12.0", "pytest-timeout==2.2.0", "pytest-xdist==3.4.0"],  # Ubuntu 24.04's
    "8.4.2": ["pytest-rerunfailures==15.1", "pytest-timeout==2.4.0", "pytest-xdist==3.8.0"],
}


@pytest.mark.parametrize("name", PLUGINS)
def test_plugins_of_ros_are_not_loaded(name: str, request: pytest.FixtureRequest) -> None:
    assert request.config.pluginmanager.is_blocked(name)


@pytest.mark.parametrize("file", SETTINGS[1:], ids=lambda file: file.parent.name)
def test_settings_of_every_package_serve_its_tests(file: Path, request: pytest.FixtureRequest) -> None:
    """They declare the markers of plugins that may be missing, and find the modules that tests import."""
    settings = ConfigParser()
    settings.read(file)
    declared = {line.split(":")[0] for line in settings["pytest"]["markers"].splitlines() if line}
    assert declared >= {"slow", "soak", "timeout", "xdist_group"}
    paths = {(file.parent / name).resolve() for name in settings["pytest"]["pythonpath"].split()}
    assert paths == {Path(path).resolve() for path in request.config.getini("pythonpath")}


@pytest.mark.parametrize("file", SETTINGS, ids=lambda file: file.parent.name)
def test_settings_of_every_package_leave_plugins_of_ros_out(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert all(f"no:{name}" in text for name in PLUGINS)


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_all_tests_are_collected_by_the_pytest_of(version: str, tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(tmp_path)]
    subprocess.run([*pip, f"pytest=={version}", *VERSIONS[version]], check=True)
    paths = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    collect = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(collect, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
