# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Words that those of the field replace, in names, headings and messages: ``python scripts/words.py``.

Measurements are accepted, rejected, gated or down-weighted; they do not speak. Filters propagate and update.
"""

import ast
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
REPLACED = {  # by: what the field says
    r"believ[a-z]*": "accept",
    r"doubt[a-z]*": "inflate, or uncertain",
    r"insist[a-z]*": "persist, or rejected for longer than its timeout",
    r"hear|hears|heard": "receive, or update",
    r"teach[a-z]*|taught": "observe, or correct",
    r"meets?": "the verb of what is done",
    r"befell|befall[a-z]*": "event",
    r"tell|tells|told|say|says|said|nobody": "report, state, or unspecified",
    r"surpris[a-z]*": "innovation, or NIS",
    r"lasting": "time-correlated, or bias",
    r"modest|sure": "conservative, overconfident, or certain",
    r"anew|of_late|by_and_by": "again, recently, gradually",
    r"pass_time|lose_track|follow_motion|follow_tracks|follow_ground": "add_process_noise, and so on",
}
_WORD = re.compile(r"(?:^|_)(" + "|".join(REPLACED) + r")(?=_|$)")
_HEADING = re.compile(r"^#+ +(.*)", re.MULTILINE)
_COMMENT = re.compile(r"#(.*)")
_PACKAGES = ("common", "drivers", "bags", "tools", "sim", "estimation")
CODE = ("src/trackslip", *(f"src/trackslip_{name}" for name in _PACKAGES), "scripts", "tests")


class Found(NamedTuple):
    """A replaced word."""

    file: Path
    name: str
    word: str


def in_code(folder: Path) -> Iterator[Found]:
    """Modules, classes, functions and arguments below a folder."""
    for file in sorted(folder.rglob("*.py")):
        names = {file.stem}
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                names.add(node.name)
            elif isinstance(node, ast.arg):
                names.add(node.arg)
        for name in sorted(names):
            yield from (Found(file, name, word) for word in words_of(name))


def in_headings(file: Path) -> Iterator[Found]:
    """Headings of a page."""
    for heading in _HEADING.findall(file.read_text(encoding="utf-8")):
        yield from (Found(file, heading, word) for word in words_of(re.sub(r"\W+", "_", heading)))


def in_comments(file: Path) -> Iterator[Found]:
    """Comments of the definition of a message."""
    for comment in _COMMENT.findall(file.read_text(encoding="utf-8")):
        yield from (Found(file, comment, word) for word in words_of(re.sub(r"\W+", "_", comment)))


def words_of(name: str) -> list[str]:
    """The replaced words of a name in snake or camel case."""
    return _WORD.findall(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())


def main() -> None:
    """Print them by folder."""
    pages = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("deploy/*.md")])
    of_code = (found for name in CODE for found in in_code(ROOT / name))
    of_pages = (found for file in pages for found in in_headings(file))
    of_messages = (found for file in sorted(ROOT.glob("src/*/msg/*.msg")) for found in in_comments(file))
    for found in chain(of_code, of_pages, of_messages):
        print(f"{found.file.relative_to(ROOT)}: {found.name.strip()} ({found.word})")


if __name__ == "__main__":
    main()
