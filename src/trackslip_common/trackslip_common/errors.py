# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The error for invalid user input, and the exit codes of all executables."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import IntEnum
from typing import TextIO

_LONGEST_LINE = 900  # characters
_MIN_SIMILARITY = 0.66  # of 1: least similarity of a suggested word
_MAX_NAMES = 12  # listed at most
_collected: ContextVar[list[str] | None] = ContextVar("_collected", default=None)


def printable(text: str, longest: int = 200) -> str:
    """A text on one line, with control characters escaped; cut after ``longest`` characters."""
    escaped = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: longest + 1]
    )
    return escaped if len(text) <= longest else f"{escaped[:longest]} …"


def show(*texts: object, file: TextIO | None = None, is_note: bool = False) -> None:
    """Print lines with control characters escaped, as names and values may come from anywhere.

    While lines are collected, those for stderr and notes (``is_note``) are kept, and others are dropped.
    """
    lines = _collected.get()
    if lines is not None:
        lines += map(str, texts if is_note or file is sys.stderr else ())
        return
    for text in texts:
        print(*(printable(line, len(line)) for line in str(text).split("\n")), sep="\n", file=file)


@contextmanager
def collect_output() -> Iterator[list[str]]:
    """Print nothing inside the block; the list receives notes and lines for stderr."""
    lines: list[str] = []
    token = _collected.set(lines)
    try:
        yield lines
    finally:
        _collected.reset(token)


class InputError(ValueError):
    """User input that cannot be used.

    Its text is the single line shown on stderr before the exit with ``ExitCode.BAD_INPUT``. It names the
    thing, the given value, and the accepted values. Names and values may come from anywhere: control
    characters are escaped, and long texts are cut.
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
    """Suffix of "'word' is unknown": the most similar known word; empty if none is similar."""
    from difflib import get_close_matches  # loaded only after a mistyped word

    matches = get_close_matches(word, list(known), n=1, cutoff=_MIN_SIMILARITY)
    return f", did you mean '{matches[0]}'?" if matches else ""


def suggestion(word: str, known: Iterable[str], more: str = "") -> str:
    """Suffix of "'word' is unknown": the most similar known word, else the accepted ones, at most a dozen.

    ``more``: what is accepted beside the known words, such as ", or a YAML file".
    """
    names = list(known)
    return did_you_mean(word, names) or f"; accepted: {joined_names(names)}{more}"


def joined_names(names: Iterable[str]) -> str:
    """Names, at most a dozen, with their number if there are more."""
    known = list(names)
    rest = f" … ({len(known)} in all)" if len(known) > _MAX_NAMES else ""
    return ", ".join(known[:_MAX_NAMES]) + rest
