# SPDX-License-Identifier: Apache-2.0
"""Imports between the packages run one way: common <- drivers, estimation <- sim."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "src"
ALLOWED = {
    "trackslip_common": set(),
    "trackslip_drivers": {"trackslip_common"},
    "trackslip_estimation": {"trackslip_common"},
    "trackslip_sim": {"trackslip_common", "trackslip_drivers", "trackslip_estimation"},
}


def imported(file: Path) -> Iterator[str]:
    """Top-level names of the packages a file imports, at any depth of its code."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("package", ALLOWED)
def test_package_imports_only_those_below_it(package: str) -> None:
    files = sorted((SOURCES / package).rglob("*.py"))
    assert files
    barred = ALLOWED.keys() - ALLOWED[package] - {package}
    found = {str(file.relative_to(SOURCES)): sorted(barred & set(imported(file))) for file in files}
    assert {file: names for file, names in found.items() if names} == {}
