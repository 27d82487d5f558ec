# SPDX-License-Identifier: Apache-2.0
"""Imports between the packages run one way, and ``package.xml`` declares all others."""

import ast
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "src"
LAYERS = ("trackslip_common", "trackslip_estimation", "trackslip_bags", "trackslip_tools", "trackslip_sim")
ALLOWED = {package: {"trackslip_msgs", *LAYERS[:k]} for k, package in enumerate(LAYERS)}
ALLOWED["trackslip_drivers"] = {"trackslip_msgs", "trackslip_common"}
ALLOWED["trackslip_sim"].add("trackslip_drivers")
ROSDEP_KEYS = {
    "can": "python3-can",
    "cantools": "python3-cantools-pip",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "msgpack": "python3-msgpack",
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "yaml": "python3-yaml",
}
# From pip, as the README says (Ubuntu 24.04 has no rosdep key of numba): requirements/with-apt-ros.txt.
PIP_ONLY = {"bokeh", "distributed", "joblib", "mcap", "numba", "rich", "rosbags"}


def imported(package: str) -> dict[str, set[str]]:
    """Top-level names of what the files of a package import, at any depth of their code."""
    files = sorted((SOURCES / package / package).rglob("*.py"))
    assert files
    return {str(file.relative_to(SOURCES)): set(_names(file)) - {package} for file in files}


def _names(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("package", ALLOWED)
def test_package_imports_only_those_below_it(package: str) -> None:
    barred = ALLOWED.keys() - ALLOWED[package]
    wrong = {file: names & barred for file, names in imported(package).items()}
    assert {file: names for file, names in wrong.items() if names} == {}


@pytest.mark.parametrize("package", ALLOWED)
def test_package_declares_what_it_imports(package: str) -> None:
    description = ElementTree.parse(SOURCES / package / "package.xml").getroot()
    declared = {element.text for tag in ("depend", "exec_depend") for element in description.iter(tag)}
    used = set.union(*imported(package).values()) - sys.stdlib_module_names - PIP_ONLY
    assert {ROSDEP_KEYS.get(name, name) for name in used} - declared == set()
