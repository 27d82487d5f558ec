# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Loads the readable frames of a DBC: cantools rejects the file for one bad frame, or one bad statement.

A DBC is split into its frames, each with the statements about it, and the shared rest. Bad frames are found
by bisection. Choices, comments and attributes that fail are dropped. Statements that define a signal
(multiplexing, floating-point values) are not dropped, so a frame is read whole or not at all.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cantools
from cantools.database import Database

_MAX_BAD_FRAMES = 100  # frames left out, after which bisection stops: the text is no DBC
_STRING = re.compile(r'"(?:\\"|[^"])*"')
_STATEMENT = re.compile(
    r"^[ \t]*(?:BO_|CM_|VAL_|BA_|SG_MUL_VAL_|SIG_VALTYPE_|BO_TX_BU_|SIG_GROUP_|BA_DEF_|BA_DEF_DEF_|EV_)\s",
    re.MULTILINE,
)
_FRAME = re.compile(r"\s*BO_\s+(\d+)\s+(\w+)")
_FRAME_STATEMENT = re.compile(
    r'\s*(?:CM_\s+(?:BO_|SG_)|VAL_|BA_\s+"[^"]*"\s+(?:BO_|SG_)|SG_MUL_VAL_|SIG_VALTYPE_|BO_TX_BU_|SIG_GROUP_)'
    r"\s+(\d+)\b"
)
_SIGNAL_DEFINITION = re.compile(r"\s*(?:SG_MUL_VAL_|SIG_VALTYPE_)\s")


class _FrameText(NamedTuple):
    """One frame, and the statements about it."""

    name: str
    frame: str
    statements: Sequence[str]

    def text(self) -> str:
        return self.frame + "\n" + "\n".join(self.statements) + "\n"


def load_readable_frames(text: str) -> tuple[Database, Mapping[str, str]]:
    """The readable frames of a DBC, and the reason for each frame left out, by name.

    Raises:
        Exception: from cantools, if the text is no DBC.
    """
    try:
        return _load(text), {}
    except Exception:
        shared, parts = _split_frames(text)
        try:
            _load(shared)
        except Exception:  # noqa: BLE001 (damaged text can raise anything in the parser)
            parts = []
        if not parts:
            raise
        left_out: dict[str, str] = {}
        good = _loadable_frames(shared, parts, left_out)
        if not good:
            raise
        return _load(shared, *good), left_out


def _load(shared: str, *frames: _FrameText) -> Database:
    text = "\n".join((shared, *(frame.text() for frame in frames)))
    database = cantools.database.load_string(text, database_format="dbc", strict=False)
    if not isinstance(database, Database):
        raise ValueError("not of CAN frames")
    return database


def _split_frames(text: str) -> tuple[str, list[_FrameText]]:
    """(text shared by all frames, the frames)."""
    # Keywords in strings are hidden.
    blank = _STRING.sub(lambda match: '"' + "x" * (len(match[0]) - 2) + '"', text)
    starts = [match.start() for match in _STATEMENT.finditer(blank)]
    pieces = [text[start:end] for start, end in zip([0, *starts], [*starts, len(text)], strict=True)]
    frames: dict[str, tuple[str, str]] = {}
    statements: defaultdict[str, list[str]] = defaultdict(list)
    shared = []
    for piece in pieces:
        if (frame := _FRAME.match(piece)) is not None:
            frames[frame[1]] = (frame[2], piece)
        elif (match := _FRAME_STATEMENT.match(piece)) is not None:
            statements[match[1]].append(piece)
        else:
            shared.append(piece)
    return "".join(shared), [
        _FrameText(name, piece, statements[key]) for key, (name, piece) in frames.items()
    ]


def _loadable_frames(shared: str, parts: Sequence[_FrameText], left_out: dict[str, str]) -> list[_FrameText]:
    """The parts that load, found by bisection; the others are added to ``left_out``."""
    try:
        _load(shared, *parts)
        return list(parts)
    except Exception as error:  # noqa: BLE001 (damaged text can raise anything in the parser)
        if len(parts) > 1 and len(left_out) <= _MAX_BAD_FRAMES:
            middle = len(parts) // 2
            return _loadable_frames(shared, parts[:middle], left_out) + _loadable_frames(
                shared, parts[middle:], left_out
            )
        reduced = None if len(parts) > 1 else _drop_bad_statements(shared, parts[0])
        if reduced is not None:
            return [reduced]
        left_out |= {part.name: " ".join(str(error).split()) or type(error).__name__ for part in parts}
        return []


def _drop_bad_statements(shared: str, part: _FrameText) -> _FrameText | None:
    """A frame without the choices, comments and attributes that fail; None if the frame itself fails."""
    statements: list[str] = []
    for piece in sorted(part.statements, key=lambda piece: _SIGNAL_DEFINITION.match(piece) is None):
        try:
            _load(shared, part._replace(statements=[*statements, piece]))
            statements.append(piece)
        except Exception:  # noqa: BLE001 (damaged text can raise anything in the parser)
            if _SIGNAL_DEFINITION.match(piece):
                return None
    reduced = part._replace(statements=statements)
    try:
        _load(shared, reduced)
    except Exception:  # noqa: BLE001 (damaged text can raise anything in the parser)
        return None
    return reduced
