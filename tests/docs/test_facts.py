# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers that code or configuration decides are the same in the documents."""

import pytest
from fixtures.documents import ROOT
from fixtures.facts import FACTS, Fact


@pytest.mark.parametrize("fact", FACTS, ids=str)
def test_the_page_says_what_the_code_does(fact: Fact) -> None:
    text = " ".join((ROOT / fact.page).read_text(encoding="utf-8").split())
    assert str(fact) in text
