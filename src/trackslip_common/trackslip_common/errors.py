# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The one error a user's input can cause, and the exit codes of every executable."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import IntEnum
from typing import TextIO

_LONGEST_LINE = 900  # characters
_LIKE = 0.66  # of 1: how near a word must be to one that was mistyped
_MOST_NAMES = 12  # that are listed
_collected: ContextVar[list[str] | None] = ContextVar("_collected", default=None)


def printable(text: str, longest: int = 200) -> str:
    """A text on one line, with what a terminal would interpret escaped; cut where it is longer."""
    shown = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: longest + 1]
    )
    return shown if len(text) <= longest else f"{shown[:longest]} …"


def show(*texts: object, file: TextIO | None = None, is_note: bool = False) -> None:
    """Print lines in which names and values may be anybody's: what would steer a terminal is escaped.

    What goes to stderr, or ``is_note``, is kept where lines are collected.
    """
    lines = _collected.get()
    if lines is not None:
        lines += map(str, texts if is_note or file is sys.stderr else ())
        return
    for text in texts:
        print(*(printable(line, len(line)) for line in str(text).split("\n")), sep="\n", file=file)


@contextmanager
def collected() -> Iterator[list[str]]:
    """Nothing is shown meanwhile; notes, and what would have gone to stderr, are in the list."""
    lines: list[str] = []
    token = _collected.set(lines)
    try:
        yield lines
    finally:
        _collected.reset(token)


class InputError(ValueError):
    """What the user gave cannot be used.

    Its text is the single line shown on stderr before leaving with ``ExitCode.BAD_INPUT``: it names the
    thing, the value given, and what is accepted. Names and values in it may be anybody's: what would steer a
    terminal is shown escaped, and what is endless is cut.
    """

    def __str__(self) -> str:
        """One printable line."""
        return printable(super().__str__(), _LONGEST_LINE)


class ExitCode(IntEnum):
    """Exit codes of all executables."""

    DONE = 0
    FAILED = 1  # ran, and failed its check
    BAD_INPUT = 2
    INTERRUPTED = 130


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """What to add to "'word' is unknown": the known word that is nearest to it; empty where none is near."""
    from difflib import get_close_matches  # only for the one who mistyped

    found = get_close_matches(word, list(known), n=1, cutoff=_LIKE)
    return f", did you mean '{found[0]}'?" if found else ""


def suggestion(word: str, known: Iterable[str], more: str = "") -> str:
    """What to add to "'word' is unknown": the nearest known word, or else what is accepted, a dozen at most.

    ``more``: what is accepted beside the known words, as ", or a YAML file".
    """
    names = list(known)
    return did_you_mean(word, names) or f"; accepted: {listed(names)}{more}"


def listed(names: Iterable[str]) -> str:
    """Names, a dozen at most, and how many there are."""
    known = list(names)
    rest = f" … ({len(known)} in all)" if len(known) > _MOST_NAMES else ""
    return ", ".join(known[:_MOST_NAMES]) + rest
