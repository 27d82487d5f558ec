# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``package.xml`` declares the imports of a package; programs of the vehicle load no library of the desk."""

import ast
import os
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

SOURCES = Path(__file__).resolve().parents[2] / "src"
PACKAGES = [
    "trackslip",
    *(f"trackslip_{name}" for name in ("common", "drivers", "estimation", "bags", "tools", "sim")),
]
ROSDEP_KEYS = {
    "bokeh": "python3-bokeh-pip",
    "can": "python3-can",
    "cantools": "python3-cantools-pip",
    "distributed": "python3-distributed-pip",
    "jinja2": "python3-jinja2",
    "llvmlite": "python3-numba",  # build dependency
    "lz4": "python3-lz4",
    "matplotlib": "python3-matplotlib",
    "mcap": "python3-mcap-pip",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "polars": "python3-polars-pip",
    "pymap3d": "python3-pymap3d",
    "pynmeagps": "python3-pynmeagps-pip",
    "pyrtcm": "python3-pyrtcm-pip",
    "pyubx2": "python3-pyubx2-pip",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "tornado": "python3-tornado",
    "yaml": "python3-yaml",
    "zstandard": "python3-zstandard",
}
OF_LIBRARIES = {"python3-msgpack"}  # imported by python-can's udp_multicast
SYSTEMS = {"debian", "ubuntu"}


def imported(package: str) -> dict[str, set[str]]:
    """Top-level names imported by each file of a package, at any depth of the code."""
    files = sorted(file for root in (package, "launch") for file in (SOURCES / package / root).rglob("*.py"))
    assert files
    return {str(file.relative_to(SOURCES)): set(_names(file)) - {package} for file in files}


def _names(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.split(".")[0]


def declared(package: str) -> set[str]:
    """Keys of the runtime dependencies of a package."""
    description = ElementTree.parse(SOURCES / package / "package.xml").getroot()
    return {str(element.text) for tag in ("depend", "exec_depend") for element in description.iter(tag)}


def imported_keys(package: str) -> set[str]:
    used = set.union(*imported(package).values()) - sys.stdlib_module_names
    return {ROSDEP_KEYS.get(name, name) for name in used}


@pytest.mark.parametrize("package", PACKAGES)
def test_package_declares_what_it_imports(package: str) -> None:
    assert imported_keys(package) - declared(package) == set()


@pytest.mark.parametrize("package", PACKAGES)
def test_package_declares_no_library_that_it_does_not_import(package: str) -> None:
    libraries = {key for key in declared(package) if key.startswith("python3-")}
    assert libraries - imported_keys(package) - OF_LIBRARIES == set()


DESK = {"rosbags", "polars", "bokeh", "matplotlib", "distributed", "dask", "rich", "jinja2", "ruamel"}
# A recorder needs the definitions of its topics beyond its imports.
LOAD_DEFINITIONS = """
from trackslip_bags.writer import own_schema
from trackslip_common.topics import TOPICS
for name, topic in TOPICS.items():
    if name != "tf":  # its package is optional
        own_schema(topic.type_name)
"""


def test_keys_that_install_by_pip_are_defined_for_each_system_that_the_packages_run_on() -> None:
    """A rosdep database may lack them: ours is shipped, and has no unused key."""
    defined = yaml.safe_load((SOURCES.parent / "deploy" / "rosdep.yaml").read_text(encoding="utf-8"))
    assert {key for key, rules in defined.items() if rules.keys() != SYSTEMS} == set()
    needed = set.union(*(declared(package) for package in PACKAGES))
    assert defined.keys() - needed == set()
    assert {key for key in needed if key.endswith("-pip")} - defined.keys() == {"python3-bokeh-pip"}


@pytest.mark.parametrize("file", ["docs/install.md", "deploy/Dockerfile", ".github/workflows/ci.yml"])
def test_rosdep_instructions_name_our_keys_and_the_remaining_pip_packages(file: str) -> None:
    text = (SOURCES.parent / file).read_text(encoding="utf-8")
    assert "deploy/rosdep.yaml" in text
    line = text.split("pip install ", 1)[1].splitlines()[0]
    assert shlex.split(line.split("#")[0].rstrip(" \\")) == [least_numba()]


def least_numba() -> str:
    """The requirement line of numba, whose version in Debian 12 is too old for the kernels."""
    lines = (SOURCES.parent / "requirements" / "with-apt-ros.txt").read_text(encoding="utf-8").splitlines()
    (line,) = (line for line in lines if line.startswith("numba"))
    return line


def _sourced() -> list[str]:
    """Command prefix that sources ROS, where this process was started without it."""
    script = Path(sys.prefix) / "trackslip.sh"
    if os.environ.get("AMENT_PREFIX_PATH") or not script.is_file():
        return []
    return ["sh", "-c", f'. "{script}"; exec "$0" "$@"']


def test_recorder_loads_no_library_of_the_desk() -> None:
    """Definitions of topics load none either; ``test_house.py`` covers imports of other programs."""
    names = "{name.partition('.')[0] for name in sys.modules}"
    code = f"import sys, trackslip_bags.nodes.record\n{LOAD_DEFINITIONS}\nprint(*{names})"
    command = [*_sourced(), sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert loaded >= {"rclpy", "mcap"}
    assert loaded & DESK == set()
