# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a DBC, after checks of its numbers: unphysical ones cost cantools hours or all memory.

cantools builds a string as long as start bit plus length, a list of all selectors in a range, an integer of
any exponent, and the tree below each selector of a multiplexer separately. For 30 nested multiplexers of two
selectors each, that is 2³⁰ nodes.
"""

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from cantools.database import Database
from cantools.database.errors import Error as CantoolsError

from trackslip_common.errors import InputError
from trackslip_drivers.protocols.dbc_recovery import load_readable_frames

_MAX_FILE_SIZE = 8_000_000  # bytes; a complete J1939 DBC has about 4 million
_LONGEST_FRAME = 1785  # bytes: limit of J1939's transport protocol; CAN FD has 64
_MOST_BITS = 8 * _LONGEST_FRAME
_MOST_SELECTORS = 20_000  # of all multiplexers; a nested one counts once for each path to it
_MAX_DEPTH = 8  # levels of nested multiplexers
_LARGEST_EXPONENT = 308  # of a double
_LONGEST_NUMBER = 308  # digits: a double holds any such number

_STRING_OR_COMMENT = re.compile(r'"(?:\\"|[^"])*"|//.*?\n')  # strings and comments
_FRAME = re.compile(r"\bBO_\s+(\d+)\s+(\w+)\s*:\s*(\w+)")
_SIGNAL = re.compile(r"\bSG_\s+(\w+)(?:\s+(m?)(\d*)(M?))?\s*:\s*([-+]?\d+)\s*\|\s*([-+]?\d+)\s*@")
_RANGES = re.compile(r"\bSG_MUL_VAL_\s+(\d+)\s+(\w+)\s+(\w+)\s+([^;]*);")
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")
_CHOICES = re.compile(r"\bVAL_\s+(\d+)\s+(\w+)\s+([^;]*);")
_CHOICE = re.compile(r'[-+]?\d+(?=\s*"")')
_EXPONENT = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*[eE][-+]?(\d+)")
_DIGITS = re.compile(rf"\d{{{_LONGEST_NUMBER + 1},}}")


class _Signal(NamedTuple):
    """Multiplexing of one signal."""

    name: str
    is_multiplexer: bool
    selector: int | None  # value of the multiplexer that selects the signal


class Dbc(NamedTuple):
    """A parsed DBC, and the reason for each frame that cannot be read."""

    database: Database
    left_out: Mapping[str, str]


def read_dbc(path: Path) -> Dbc:
    """Parse a DBC; frames with overlapping or misplaced signals are kept, as they may have no role.

    Raises:
        InputError: the file cannot be read, is no DBC, or has numbers beyond those of any CAN bus.
    """
    where = f"dbc_file {path}"
    try:
        if path.stat().st_size > _MAX_FILE_SIZE:
            raise InputError(f"{where}: more than {_MAX_FILE_SIZE // 10**6} MB; accepted: a DBC")
        content = path.read_bytes()
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("cp1252")  # of Windows tools
        _check_numbers(where, _STRING_OR_COMMENT.sub(_blank_text, text))
        return Dbc(*load_readable_frames(text))
    except InputError:
        raise
    except (OSError, UnicodeDecodeError, CantoolsError) as error:
        raise InputError(f"{where}: not a usable DBC ({error_line(error)})") from error
    except Exception as error:  # damaged text can raise anything in the parser
        raise InputError(f"{where}: not a usable DBC ({type(error).__name__})") from error


def error_line(error: Exception) -> str:
    """The error's text on one line."""
    return " ".join(str(error).split())


def _blank_text(match: re.Match[str]) -> str:
    """Replacement of a string or a comment."""
    return '""' if match[0].startswith('"') else " "


def _check_numbers(where: str, text: str) -> None:
    """Raise ``InputError`` for a number out of bounds in a DBC's text without strings and comments."""
    if (digits := _DIGITS.search(text)) is not None:
        raise InputError(f"{where}: a number of {len(digits[0])} digits; accepted: up to {_LONGEST_NUMBER}")
    for number in _EXPONENT.finditer(text):
        if int(number[1]) > _LARGEST_EXPONENT or math.isinf(float(number[0])):
            accepted = f"exponents up to {_LARGEST_EXPONENT}"
            raise InputError(f"{where}: the number {number[0]} is too large; accepted: {accepted}")
    selectors = _parse_selectors(where, text)
    count = 0
    heads = list(_FRAME.finditer(text))
    ends = [head.start() for head in heads[1:]] + [len(text)]
    for head, end in zip(heads, ends, strict=False):
        frame = f"{where}: frame '{head[2]}'"
        if not head[3].isdecimal() or int(head[3]) > _LONGEST_FRAME:
            raise InputError(f"{frame} of {head[3]} bytes; accepted: 0 to {_LONGEST_FRAME}")
        signals = [_parse_signal(frame, match) for match in _SIGNAL.finditer(text, head.end(), end)]
        if any(signal.is_multiplexer for signal in signals):
            count += _MultiplexerTree(frame, signals, selectors.get(head[1], {})).count_nodes()
        if count > _MOST_SELECTORS:
            accepted = f"up to {_MOST_SELECTORS} in a DBC, below each selector again"
            raise InputError(f"{frame}: too many selectors of multiplexers; accepted: {accepted}")


def _parse_signal(frame: str, match: re.Match[str]) -> _Signal:
    name, multiplexed, selector, multiplexer, start, length = match.groups()
    for quantity, value, minimum in (("start bit", int(start), 0), ("length", int(length), 1)):
        if not minimum <= value <= _MOST_BITS:
            raise InputError(
                f"{frame}: signal '{name}': {quantity} {value}; accepted: {minimum} to {_MOST_BITS}, "
                f"of up to {_LONGEST_FRAME} bytes"
            )
    selected_by = int(selector) if multiplexed and selector else None
    return _Signal(name, bool(multiplexer), selected_by)


_Selectors = Mapping[str, Mapping[str, frozenset[int]]]  # multiplexer → signal → its selectors; "" → choices


def _parse_selectors(where: str, text: str) -> Mapping[str, _Selectors]:
    """By frame: the selectors of ``SG_MUL_VAL_``, and the choices of ``VAL_`` under the signal name ''."""
    selectors: defaultdict[str, dict[str, dict[str, frozenset[int]]]] = defaultdict(dict)
    count = 0
    for frame, signal, multiplexer, ranges in _RANGES.findall(text):
        bounds = [(int(low), int(high)) for low, high in _RANGE.findall(ranges)]
        count += sum(max(high - low + 1, 0) for low, high in bounds)
        if count > _MOST_SELECTORS:
            accepted = f"up to {_MOST_SELECTORS} in a DBC"
            raise InputError(
                f"{where}: signal '{signal}': too many selectors of multiplexers; accepted: {accepted}"
            )
        values = frozenset(k for low, high in bounds for k in range(low, high + 1))
        selectors[frame].setdefault(multiplexer, {})[signal] = values
    for frame, signal, choices in _CHOICES.findall(text):
        selectors[frame].setdefault(signal, {})[""] = frozenset(map(int, _CHOICE.findall(choices)))
    return selectors


class _MultiplexerTree:
    """Counts the nodes that cantools builds below the multiplexers of a frame."""

    def __init__(self, frame: str, signals: list[_Signal], selectors: _Selectors) -> None:
        self._frame = frame
        self._multiplexers = [signal.name for signal in signals if signal.is_multiplexer]
        only = self._multiplexers[0] if len(self._multiplexers) == 1 else ""
        selector_of = {signal.name: signal.selector for signal in signals if signal.selector is not None}
        self._signals_below: dict[str, dict[str, frozenset[int]]] = {
            name: dict(selectors.get(name, {})) for name in self._multiplexers
        }
        for name, selector in selector_of.items() if only else ():
            selectors_of_ranges = self._signals_below[only].get(name, frozenset())
            self._signals_below[only][name] = selectors_of_ranges | {selector}
        self._node_counts: dict[str, int] = {}

    def count_nodes(self) -> int:
        """Nodes below all outermost multiplexers."""
        inner = {name for below in self._signals_below.values() for name in below}
        return sum(self._count_below(name, 1) for name in self._multiplexers if name not in inner)

    def _count_below(self, name: str, depth: int) -> int:
        if depth > _MAX_DEPTH:
            accepted = f"up to {_MAX_DEPTH} in each other"
            raise InputError(f"{self._frame}: multiplexer '{name}' is nested too deep; accepted: {accepted}")
        if name not in self._node_counts:
            below = self._signals_below[name]
            ids = frozenset[int]().union(*below.values())
            inner = (
                len(values) * self._count_below(one, depth + 1)
                for one, values in below.items()
                if one in self._signals_below
            )
            self._node_counts[name] = len(ids) + sum(inner)
        return self._node_counts[name]
