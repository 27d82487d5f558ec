# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Data frames from columns; pandas is optional."""

import importlib
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from trackslip_common.errors import InputError


def to_pandas(columns: Mapping[str, NDArray[Any]]) -> Any:
    """A ``pandas.DataFrame`` of (n,) columns.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ImportError as error:
        raise InputError("to_pandas: pandas is not installed; accepted: pip install pandas") from error
    return pandas.DataFrame(dict(columns))
