# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the contents of a YAML file; ``where`` begins each message, and names file and place."""

import math
from collections.abc import Collection, Mapping
from typing import Any

from trackslip_common.errors import InputError, did_you_mean

_MAX_SECONDS = 2.0**32  # s, as from day numbers, which count from 1899, to stamps


def check_keys(
    where: str,
    tree: Mapping[str, Any],
    required: Collection[str],
    optional: Collection[str],
    what: str = "key",
) -> None:
    """Check that all required keys are present and none is unknown; ``what``: word for a key in messages.

    Raises:
        InputError: a key is unknown or missing.
    """
    known = (*required, *(key for key in optional if key not in required))
    for key in tree:
        if key not in known:
            hint = did_you_mean(str(key), known)
            raise InputError(f"{where}: unknown {what} '{key}'{hint}; accepted: {', '.join(known)}")
    for key in required:
        if key not in tree:
            raise InputError(f"{where}: {what} '{key}' is missing; accepted: {', '.join(known)}")


def section(where: str, value: Any) -> Mapping[str, Any]:
    """The value, which must be a YAML mapping.

    Raises:
        InputError: the value is no mapping.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: names and values (a YAML mapping)")
    return value


def text(where: str, value: Any) -> str:
    """The value, which must be a text that is not empty.

    Raises:
        InputError: the value is no text, or empty.
    """
    if not isinstance(value, str) or not value:
        raise InputError(f"{where}: {value!r} is not accepted; accepted: text")
    return value


def texts(where: str, value: Any) -> tuple[str, ...]:
    """The texts of a value, which must be one text or a list of them.

    Raises:
        InputError: the value is neither.
    """
    values = value if isinstance(value, list) and value else [value]
    return tuple(text(where, one) for one in values)


def flag(where: str, value: Any) -> bool:
    """The value, which must be true or false.

    Raises:
        InputError: the value is neither.
    """
    if not isinstance(value, bool):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: true or false")
    return value


def number(where: str, value: Any) -> float:
    """The value, which must be a finite number.

    Raises:
        InputError: the value is no finite number.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: a finite number")
    return float(value)


def positive_number(where: str, value: Any) -> float:
    """The value, which must be a finite number above zero.

    Raises:
        InputError: the value is no such number.
    """
    parsed = number(where, value)
    if parsed <= 0.0:
        raise InputError(f"{where}: {parsed:g} is out of range; accepted: > 0")
    return parsed


def nanoseconds(where: str, value: Any) -> int:
    """A value in seconds, converted to ns.

    Raises:
        InputError: the value is no finite number, or larger than any stamp.
    """
    seconds = number(where, value)
    if abs(seconds) > _MAX_SECONDS:
        raise InputError(f"{where}: {seconds:g} is out of range; accepted: at most 2^32 s either way")
    return round(seconds * 1e9)


def choice(where: str, value: Any, accepted: Collection[str]) -> str:
    """The value, which must be one of some words.

    Raises:
        InputError: the value is none of them.
    """
    if not isinstance(value, str) or value not in accepted:
        hint = did_you_mean(str(value), accepted)
        raise InputError(f"{where}: {value!r} is not accepted{hint}; accepted: {', '.join(accepted)}")
    return value
