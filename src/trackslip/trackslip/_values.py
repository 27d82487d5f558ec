# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Values of arguments as text, which the readers of files and options read."""

import json
import os
from collections.abc import Mapping

import numpy as np

from trackslip_common.errors import InputError


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
