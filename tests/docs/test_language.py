# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Names of code and headings of pages use the words of the field."""

from pathlib import Path

import pytest
from fixtures.documents import DOCUMENTS, ROOT

import words

PACKAGES = tuple(Path(folder).name for folder in words.CODE)


@pytest.mark.parametrize("package", PACKAGES)
def test_names_of_a_package_have_no_replaced_word(package: str) -> None:
    assert [f"{f.file.name}: {f.name}" for f in words.in_code(ROOT / "src" / package)] == []


@pytest.mark.parametrize("file", DOCUMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_headings_have_no_replaced_word(file: Path) -> None:
    assert [found.name for found in words.in_headings(file)] == []


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("_least_surprise", ["surprise"]),
        ("DoubtedHeading", ["doubted"]),
        ("insists", ["insists"]),
        ("Whether_to_believe_it", ["believe"]),
        ("measured_share", []),
        ("essay", []),
        ("lose_track", ["lose_track"]),
    ],
)
def test_replaced_words_are_found_in_any_case(name: str, found: list[str]) -> None:
    assert words.words_of(name) == found
