# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Words per sentence of a Markdown page, without code, tables, headings and generated blocks."""

import re
from typing import NamedTuple

_FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_BLOCK = re.compile(r"<!-- numbers: .*?<!-- end of .*?-->", re.DOTALL)
_INDENTED = re.compile(r"\n\n(?: {4,}.*\n?)+")  # after a blank line; not the second line of an item
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_ITEM = re.compile(r"^ *(?:[-*]|\d+\.) +", re.MULTILINE)
_END = re.compile(r"(?<=[.!?])[\"')*]*\s+(?=[\"'(*`]*[A-ZÄÖÜΑ-Ωα-ω0-9`])")  # not of "e.g. a", nor "Fig. 3"
_SHORT = re.compile(r"\b(e\.g|i\.e|Fig|et al|cf|vs)\.")


class Count(NamedTuple):
    """Sentence counts of one page."""

    sentences: int
    mean: float  # words
    longest: int  # words


def sentences(text: str) -> list[str]:
    """The sentences of a page's prose."""
    for pattern in (_FENCED, _BLOCK):
        text = pattern.sub("\n", text)
    text = _INDENTED.sub("\n\n", text)
    text = re.sub(r"^(?:\|.*|#.*|<!--.*-->|!\[.*)$", "", text, flags=re.MULTILINE)
    text = _LINK.sub(r"\1", re.sub(r"`[^`]*`", "`x`", text))
    parts = []
    for paragraph in re.split(r"\n\s*\n", _ITEM.sub("\n\n", text)):
        one_line = " ".join(_SHORT.sub(r"\1", paragraph).split())
        parts += [s for s in _END.split(one_line) if len(s.split()) > 1]
    return parts


def count(text: str) -> Count:
    """Number and lengths of the sentences."""
    lengths = [len(sentence.split()) for sentence in sentences(text)]
    return Count(len(lengths), sum(lengths) / len(lengths), max(lengths)) if lengths else Count(0, 0.0, 0)
