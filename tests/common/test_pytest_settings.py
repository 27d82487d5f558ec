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
# launch_testing imports each test module, in any import mode: two with the same name clash.
PLUGIN = """
from _pytest.pathlib import import_path

def pytest_pycollect_makemodule(module_path):
    import_path(module_path, root=module_path.parent, **OPTIONS)
"""
TWO_OF_ONE_NAME = ("tests/estimation/slip/test_swing.py", "tests/sim/test_swing.py")
VERSIONS = {  # pytest → compatible plugins
    "7.4.4": ["pytest-rerunfailures==12.0", "pytest-timeout==2.2.0", "pytest-xdist==3.4.0"],  # Ubuntu 24.04's
    "8.4.2": ["pytest-rerunfailures==15.1", "pytest-timeout==2.4.0", "pytest-xdist==3.8.0"],
}


def collected(settings: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-c", str(settings), f"--rootdir={ROOT}"]
    return subprocess.run(
        [*command, "--collect-only", "-q", "-p", "no:cacheprovider", *arguments],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )


def with_entry_point(folder: Path, name: str) -> str:
    """Write an entry point ``name`` of a pytest plugin; return the PYTHONPATH with it."""
    about = folder / f"{name}-1.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(f"[pytest11]\n{name} = plugin_of_{name}\n", encoding="utf-8")
    keywords = "{}" if pytest.version_tuple < (8, 1) else "{'consider_namespace_packages': False}"
    text = PLUGIN.replace("OPTIONS", keywords)
    (folder / f"plugin_of_{name}.py").write_text(text, encoding="utf-8")
    return f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"


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


@pytest.mark.slow
@pytest.mark.parametrize("name", PLUGINS)
def test_plugins_of_ros_do_not_import_our_modules_again(tmp_path: Path, name: str) -> None:
    paths = with_entry_point(tmp_path, name)
    done = collected(SETTINGS[0], *TWO_OF_ONE_NAME, PYTHONPATH=paths)
    assert done.returncode == 0, done.stdout + done.stderr
    enabled = collected(SETTINGS[0], "-p", f"plugin_of_{name}", *TWO_OF_ONE_NAME, PYTHONPATH=paths)
    assert "ImportPathMismatchError" in enabled.stdout  # expected with the plugin


@pytest.mark.parametrize("file", SETTINGS, ids=lambda file: file.parent.name)
def test_settings_of_every_package_leave_plugins_of_ros_out(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert all(f"no:{name}" in text for name in PLUGINS)


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_all_tests_are_collected_by_the_pytest_of(version: str, tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(tmp_path)]
    subprocess.run([*pip, f"pytest=={version}", *VERSIONS[version]], check=True)
    done = collected(SETTINGS[0], PYTHONPATH=f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
