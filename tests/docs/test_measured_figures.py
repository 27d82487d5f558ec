# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measured figures of the documents are written by a command, or state how they were measured.

A section has measured figures if one of its tables has decimals, or if a paragraph has a number with a word
of measuring. Code and the output of ``make numbers`` are excluded. Such a section names a test file, or
states ``measured on DATE by …`` (``in MONTH YEAR with …``).
"""

import re
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest
from fixtures.documents import DOCUMENTS, ROOT, Document

import make_numbers
import reference_pages
from measurements import CHEAP, MEASUREMENTS
from measurements.blocks import blocks_of, names_on, rewrite_blocks, without_blocks
from measurements.workbench import NotMeasured

WRITTEN = {  # whole pages, written by trackslip study and by make docs
    "study_table.md",
    "slope_table.md",
    "soil_table.md",
    *reference_pages.WRITTEN,
}
NUMBER = re.compile(r"\d+(?:\.\d+)?")
CELL = re.compile(r"\| *\**[−+]?\d+\.\d+")  # a table cell that begins with a decimal number
FIGURE = re.compile(r"(?<![\w.(])(?:\d+\.\d+(?![\d.)])|\d+ (?:%|mm|cm|m|rad|mrad|µs|ms|MB)(?!\w))")
MEASURING = re.compile(
    r"\b(?:RMSE|RMS|NEES|measured)\b|\d (?:mm|µs)\b|\d %? ?of a core"
    r"|times (?:the|its) bound|\b(?:m|mm|rad) off\b"
)
SOURCE = re.compile(
    r"\b[Mm]easured\s(?:on\s20\d\d-\d\d-\d\d|in\s[A-Z][a-z]+\s20\d\d)\s(?:by|with)\s"
    r"|\btests/(?:\w+/)+\w+\.py|\(cited\)"
)


def test_each_block_names_a_measurement_and_each_measurement_has_a_block() -> None:
    assert set(names_on(lambda _: True)) == set(MEASUREMENTS)
    assert set(CHEAP) < set(MEASUREMENTS)


@pytest.mark.parametrize("name", CHEAP)
def test_figures_from_files_in_the_tree_are_current(name: str) -> None:
    """The tolerance is one unit of the last digit: processors round differently."""
    page = names_on(lambda _: True)[name]
    on_page = blocks_of(page.read_text(encoding="utf-8"))[name]
    _, measured, reason = make_numbers.measure_block(None, name)
    assert not reason
    assert NUMBER.split(on_page) == NUMBER.split(measured)
    for old, new in zip(NUMBER.findall(on_page), NUMBER.findall(measured), strict=True):
        assert float(old) == pytest.approx(float(new), abs=1.01 * 10.0 ** -len(old.partition(".")[2]))


def test_figure_that_cannot_be_measured_states_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(make_numbers, "MEASUREMENTS", {"a": Mock(side_effect=NotMeasured("no log"))})
    assert make_numbers.measure_block(None, "a") == ("a", "", "no log")


def test_a_block_is_rewritten_and_the_rest_stays() -> None:
    text = "before 1\n<!-- numbers: a -->\nold 2\n<!-- end of a -->\nafter 3\n"
    assert blocks_of(text) == {"a": "old 2\n"}
    new = rewrite_blocks(text, {"a": "new 4\n", "b": "none 5\n"})
    assert new == text.replace("old 2", "new 4")
    assert without_blocks(text) == "before 1\n\n\n\nafter 3\n"


@pytest.mark.parametrize(
    "text",
    [
        "<!-- numbers: a -->\n1\n",
        "<!-- numbers: a -->\n1\n<!-- end of b -->\n",
        "<!-- numbers: a -->\n<!-- end of a -->\n<!-- numbers: a -->\n<!-- end of a -->\n",
    ],
)
def test_unterminated_or_repeated_block_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="marks"):
        blocks_of(text)


@pytest.mark.parametrize("file", DOCUMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_measured_figures_name_what_they_were_measured_with(file: Path) -> None:
    if file.name not in WRITTEN:
        text = file.read_text(encoding="utf-8")
        assert list(unsourced(file, text)) == []


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("# A\n\n| mm |\n|---|\n| 1.5 |\n", 1),
        ("# A\n\n| what |\n|---|\n| by (3.8), Fig. 4.3 |\n", 0),
        ("# A\n\nThe RMSE is\n7 m (`tests/sim/test_swing.py`).\n", 0),
        ("# A\n\nMeasured in November 2026 with `make bench`.\n\n# B\n\nIt takes 7 µs.\n", 1),
        ("# A\n\nA timeout of 0.5 s.\n\n    RMSE 0.5\n", 0),
        ("# A\n\n<!-- numbers: a -->\nRMSE 0.5\n<!-- end of a -->\n", 0),
    ],
)
def test_figures_without_a_source_are_seen(text: str, count: int) -> None:
    assert len(list(unsourced(ROOT / "README.md", text))) == count


def unsourced(file: Path, text: str) -> Iterator[str]:
    """Measured figures of sections without a source."""
    prose = "\n".join(place.text for place in Document(file, without_blocks(text)).prose)
    for section in re.split(r"\n(?=#)", prose):
        if SOURCE.search(section):
            continue
        for paragraph in re.split(r"\n\s*\n|\n(?=[-*|] ?)|\n(?=\d+\. )", section):
            bare = " ".join(re.sub(r"`[^`]*`", "``", paragraph).split())
            measured_here = FIGURE.search(bare) and MEASURING.search(bare)
            if CELL.search(bare) if bare.startswith("|") else measured_here:
                yield bare
