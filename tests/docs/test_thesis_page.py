# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Functions and tests that ``docs/thesis.md`` names exist."""

import importlib
import re

import pytest
from fixtures.documents import ROOT

PAGE = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8")
TABLE = PAGE.split("## Equation", 1)[1].split("\n## ", 1)[0]
ROWS = [line.strip("|").split(" | ") for line in TABLE.splitlines() if re.match(r"\| [^e-]", line)]
SHORT = {
    "values": "tests/estimation/terramechanics/test_values.py",
    "soil laws": "tests/estimation/terramechanics/test_soil_laws.py",
    "motion laws": "tests/estimation/terramechanics/test_motion_laws.py",
}
PREFIXES = ("trackslip_estimation.terramechanics.", "trackslip_estimation.", "")
DEMANDED = [f"(3.{n})" for n in range(15, 28)] + [f"(4.{n})" for n in range(1, 31)] + ["(6.1)"]


def is_importable(name: str) -> bool:
    for prefix in PREFIXES:
        module, _, attribute = f"{prefix}{name}".rpartition(".")
        try:
            if hasattr(importlib.import_module(module), attribute):
                return True
        except (ImportError, ValueError):
            continue
    return False


def functions() -> list[str]:
    """Dotted names in the second column; a bare name belongs to the module named before it."""
    names = []
    for row in ROWS:
        module = ""
        for span in re.findall(r"`([\w.]+)`", row[1]):
            if "." in span:
                module = span.rpartition(".")[0]
                names.append(span)
            elif module:
                names.append(f"{module}.{span}")
    return names


def named_tests() -> list[tuple[str, str]]:
    """File and name of each test in the last column."""
    tests, file = [], ""
    for row in ROWS:
        parts = re.split(r"`(tests/[\w/]+\.py)`|(values|soil laws|motion laws)(?= `)", row[-1])
        for path, short, text in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
            file = path or SHORT[short]
            tests += [(file, name) for name in re.findall(r"`(\w+)`", text)]
        if len(parts) == 1 and "the same:" in row[-1]:
            tests += [(file, name) for name in re.findall(r"`(\w+)`", row[-1])]
    return tests


@pytest.mark.parametrize("name", functions())
def test_each_function_exists(name: str) -> None:
    assert is_importable(name)


def test_missing_function_is_detected() -> None:
    assert not is_importable("strength.thrust_limits")
    assert not is_importable("soil.dynamics_kernel.predict")


@pytest.mark.parametrize(("file", "name"), named_tests())
def test_each_test_exists(file: str, name: str) -> None:
    assert f"def test_{name}(" in (ROOT / file).read_text(encoding="utf-8")


def test_each_equation_of_the_model_and_the_filters_has_a_row() -> None:
    named = " ".join(row[0] for row in ROWS)
    for first, last in re.findall(r"\((\d\.\d+)\)–\((\d\.\d+)\)", named):
        chapter = first.partition(".")[0]
        numbers = range(int(first.partition(".")[2]), int(last.partition(".")[2]) + 1)
        named += "".join(f" ({chapter}.{n})" for n in numbers)
    assert [equation for equation in DEMANDED if equation not in named] == []
