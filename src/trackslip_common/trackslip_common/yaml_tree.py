# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of what a YAML file holds; ``where`` opens each message, and names file and place."""

import math
from collections.abc import Collection, Mapping
from typing import Any

from trackslip_common.errors import InputError, did_you_mean

_LONGEST = 2.0**31  # s


def check_keys(
    where: str,
    tree: Mapping[str, Any],
    required: Collection[str],
    optional: Collection[str],
    what: str = "key",
) -> None:
    """All required keys are there, and no unknown ones; ``what`` they are called.

    Raises:
        InputError: a key is unknown or missing.
    """
    known = (*required, *(key for key in optional if key not in required))
    for key in tree:
        if key not in known:
            like = did_you_mean(str(key), known)
            raise InputError(f"{where}: unknown {what} '{key}'{like}; accepted: {', '.join(known)}")
    for key in required:
        if key not in tree:
            raise InputError(f"{where}: {what} '{key}' is missing; accepted: {', '.join(known)}")


def section(where: str, value: Any) -> Mapping[str, Any]:
    """A YAML mapping.

    Raises:
        InputError: it is none.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: names and values (a YAML mapping)")
    return value


def text(where: str, value: Any) -> str:
    """A text that is not empty.

    Raises:
        InputError: it is none.
    """
    if not isinstance(value, str) or not value:
        raise InputError(f"{where}: {value!r} is not accepted; accepted: text")
    return value


def texts(where: str, value: Any) -> tuple[str, ...]:
    """One text, or a list of them.

    Raises:
        InputError: it is neither.
    """
    values = value if isinstance(value, list) and value else [value]
    return tuple(text(where, one) for one in values)


def flag(where: str, value: Any) -> bool:
    """True or false.

    Raises:
        InputError: it is neither.
    """
    if not isinstance(value, bool):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: true or false")
    return value


def number(where: str, value: Any) -> float:
    """A finite number.

    Raises:
        InputError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: a finite number")
    return float(value)


def positive(where: str, value: Any) -> float:
    """A finite number above zero.

    Raises:
        InputError: it is none.
    """
    found = number(where, value)
    if found <= 0.0:
        raise InputError(f"{where}: {found:g} is out of range; accepted: > 0")
    return found


def nanoseconds(where: str, value: Any) -> int:
    """A number of seconds, as ns.

    Raises:
        InputError: it is none, or larger than any stamp.
    """
    seconds = number(where, value)
    if abs(seconds) > _LONGEST:
        raise InputError(f"{where}: {seconds:g} is out of range; accepted: at most 2^31 s either way")
    return round(seconds * 1e9)


def choice(where: str, value: Any, accepted: Collection[str]) -> str:
    """One of some words.

    Raises:
        InputError: it is another.
    """
    if not isinstance(value, str) or value not in accepted:
        like = did_you_mean(str(value), accepted)
        raise InputError(f"{where}: {value!r} is not accepted{like}; accepted: {', '.join(accepted)}")
    return value
