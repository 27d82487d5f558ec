# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Words per sentence, without code, tables and headings."""

import pytest

import readability


@pytest.mark.parametrize(
    ("text", "lengths"),
    [
        ("One two three. Four five.\n", [3, 2]),
        ("# A heading. Of two\n\nOne two\nthree.\n", [3]),
        ("One two `code with spaces` three.\n\n    a block. of code\n", [4]),
        ("| a table. With words |\n|---|\n\nOne [link text](page.md) two.\n", [4]),
        ("- First item here\n- second item\n", [3, 2]),
        ("One two. `code` begins the next. κ too.\n", [2, 4, 2]),
        ("By Fig. 3 one sees it.\n", [6]),
        ("```\nA block. Of code\n```\nOne two.\n", [2]),
        ("<!-- numbers: a -->\nA figure of it.\n<!-- end of a -->\nOne two.\n", [2]),
    ],
)
def test_sentences_are_counted_by_hand(text: str, lengths: list[int]) -> None:
    assert [len(sentence.split()) for sentence in readability.sentences(text)] == lengths


def test_a_page_without_prose_has_no_sentence() -> None:
    assert readability.count("# Title\n\n    code\n") == (0, 0.0, 0)
