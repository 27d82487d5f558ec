# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Summaries for programs: the file of ``--json``."""

import json
import math
from pathlib import Path
from typing import Any

from trackslip_common.errors import InputError
from trackslip_common.whole_file import write_whole


def write_json(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Write a summary; what is no finite number becomes null, for JSON has neither.

    Raises:
        InputError: the file cannot be written.
    """
    try:
        write_whole(path, json.dumps(_without_nan(content), indent=2, allow_nan=False) + "\n")
    except OSError as error:
        raise InputError(f"--json: '{path}' cannot be written ({error.strerror})") from error


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
