# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Names of code and headings of pages use the words of the field."""

from pathlib import Path

import pytest
from fixtures import replaced_words as words
from fixtures.documents import DOCUMENTS, ROOT


@pytest.mark.parametrize("folder", words.CODE)
def test_names_of_code_and_tests_have_no_replaced_word(folder: str) -> None:
    assert [f"{f.file.name}: {f.name}" for f in words.in_code(ROOT / folder)] == []


@pytest.mark.parametrize(
    "file", sorted(ROOT.glob("src/trackslip_msgs/msg/*.msg")), ids=lambda file: file.stem
)
def test_comments_of_messages_have_no_replaced_word(file: Path) -> None:
    assert [found.name for found in words.in_comments(file)] == []


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
