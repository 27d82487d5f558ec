# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of a page written by measurements: ``<!-- numbers: NAME -->`` … ``<!-- end of NAME -->``."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("deploy/*.md")])

_BLOCK = re.compile(r"(<!-- numbers: (\w+) -->\n)(.*?)(<!-- end of \2 -->)", re.DOTALL)
_MARK = re.compile(r"<!-- (?:numbers:|end of) \w* ?-->")


def blocks_of(text: str) -> dict[str, str]:
    """Name → content between its marks.

    Raises:
        ValueError: a mark has no partner, or a name occurs twice.
    """
    blocks = {name: content for _, name, content, _ in _BLOCK.findall(text)}
    marks = len(_MARK.findall(text))
    if marks != 2 * len(blocks):
        raise ValueError(f"{marks} marks make {len(blocks)} blocks: one is not closed, or stands twice")
    return blocks


def without_blocks(text: str) -> str:
    """The text without the content of blocks; lines keep their numbers."""
    return _BLOCK.sub(lambda match: "\n" * match[0].count("\n"), text)


def rewrite_blocks(text: str, contents: Mapping[str, str]) -> str:
    """The text with new contents of the named blocks; other blocks are unchanged."""

    def one(match: re.Match[str]) -> str:
        head, name, content, foot = match.groups()
        return f"{head}{contents.get(name, content)}{foot}"

    return _BLOCK.sub(one, text)


def names_on(pages: Callable[[Path], bool]) -> dict[str, Path]:
    """Name → page of all blocks on the selected pages."""
    return {
        name: page for page in PAGES if pages(page) for name in blocks_of(page.read_text(encoding="utf-8"))
    }
