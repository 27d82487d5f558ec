# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Converts arguments to values, as the readers of files and options do."""

import json
import os
from collections.abc import Iterable, Mapping

import numpy as np

from trackslip_common.errors import InputError

_LONGEST_VALUE = 60  # characters


def as_number(where: str, value: object) -> float:
    """The value as a number.

    Raises:
        InputError: the value is no number; ``where`` is the start of the message.
    """
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    raise InputError(f"{where}: {value!r} is refused; accepted: a number")


def as_count(where: str, value: object) -> int:
    """The value as a whole number that is not negative.

    Raises:
        InputError: the value is none; ``where`` is the start of the message.
    """
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= 0:
        return int(value)
    raise InputError(f"{where}: {value!r} is refused; accepted: a whole number >= 0")


def as_text(where: str, value: object) -> str:
    """The value, a text or a path, as a text.

    Raises:
        InputError: the value is neither; ``where`` is the start of the message.
    """
    if isinstance(value, (str, os.PathLike)):
        return os.fspath(value)
    raise InputError(f"{where}: {_shown(value)} is refused; accepted: text")


def _shown(value: object) -> str:
    """The value as Python writes it, or its type where that is long: a frame, a result."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"a {type(value).__name__}"


def as_name(where: str, value: object) -> str | None:
    """The value as a text; None stays None.

    Raises:
        InputError: the value is neither; ``where`` is the start of the message.
    """
    return None if value is None else as_text(where, value)


def as_texts(where: str, value: object) -> tuple[str, ...]:
    """The value as several texts; a single text counts as one.

    Raises:
        InputError: the value has other contents; ``where`` is the start of the message.
    """
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes, Mapping)):
        return tuple(as_text(where, one) for one in value)
    return (as_text(where, value),)


def json_text(where: str, value: object) -> str:
    """The value as JSON (which is YAML too); numbers and arrays of numpy are converted to those of Python.

    Raises:
        InputError: the value has contents that no file can have; ``where`` is the start of the message.
    """

    def plain(one: object) -> object:
        if isinstance(one, (np.generic, np.ndarray)):
            return one.tolist()
        if isinstance(one, os.PathLike):
            return os.fspath(one)
        if isinstance(one, Mapping):
            return dict(one)
        accepted = "a number, text, true or false, or a list or mapping of them"
        raise InputError(f"{where}: {one!r} is refused; accepted: {accepted}")

    return json.dumps(value, default=plain, ensure_ascii=False, sort_keys=True)
