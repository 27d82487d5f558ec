# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Values of arguments as the readers of files and options read them."""

import json
import os
from collections.abc import Iterable, Mapping

import numpy as np

from trackslip_common.errors import InputError


def as_number(where: str, value: object) -> float:
    """A number.

    Raises:
        InputError: it is none; ``where`` opens the message.
    """
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    raise InputError(f"{where}: {value!r} is refused; accepted: a number")


def as_count(where: str, value: object) -> int:
    """A whole number that is not negative.

    Raises:
        InputError: it is none; ``where`` opens the message.
    """
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= 0:
        return int(value)
    raise InputError(f"{where}: {value!r} is refused; accepted: a whole number >= 0")


def as_text(where: str, value: object) -> str:
    """A text, or a path as one.

    Raises:
        InputError: it is neither; ``where`` opens the message.
    """
    if isinstance(value, (str, os.PathLike)):
        return os.fspath(value)
    raise InputError(f"{where}: {value!r} is refused; accepted: text")


def as_name(where: str, value: object) -> str | None:
    """A text, or None where there is none.

    Raises:
        InputError: it is neither; ``where`` opens the message.
    """
    return None if value is None else as_text(where, value)


def as_texts(where: str, value: object) -> tuple[str, ...]:
    """Several texts; one alone stands for itself.

    Raises:
        InputError: it is no text, or holds something else; ``where`` opens the message.
    """
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes, Mapping)):
        return tuple(as_text(where, one) for one in value)
    return (as_text(where, value),)


def json_text(where: str, value: object) -> str:
    """A value as JSON, which is YAML too; numbers and arrays of numpy are as those of Python.

    Raises:
        InputError: it holds something that no file states; ``where`` opens the message.
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
