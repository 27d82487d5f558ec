# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of functions as the commands have them, so that both are checked by the same code."""

import json
from collections.abc import Mapping
from typing import Any

from trackslip_common.errors import InputError


def setting_texts(settings: Mapping[str, Any] | None) -> list[str]:
    """``{"slip_estimator.max_gap": 3.0}`` as ``--set`` takes it.

    Raises:
        InputError: a value is none that a parameter may have.
    """
    texts = []
    for name, value in (settings or {}).items():
        try:
            texts.append(f"{name}={json.dumps(value)}")
        except TypeError as error:
            accepted = "a number, text, true or false, or a list of them"
            raise InputError(f"settings: {name}: {value!r} is refused; accepted: {accepted}") from error
    return texts
