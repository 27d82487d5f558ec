# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Validation of the arguments of formulas: arrays of finite numbers in range, or an ``InputError``."""

from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.parameter_spec import Spec

_COMPARISONS = MappingProxyType(
    {"gt": np.greater, "ge": np.greater_equal, "lt": np.less, "le": np.less_equal}
)  # by the name of a bound


def validate(field: str, value: ArrayLike, unit: str = "", **bounds: float) -> FloatArray:
    """Return ``value`` as an array of any shape; ``bounds``: gt, ge, lt, le.

    Raises:
        InputError: a number is missing, not finite or out of range; the message names the first one.
    """
    gt, ge, lt, le = (bounds.get(name) for name in _COMPARISONS)
    spec = Spec(field, unit, gt, ge, lt, le)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{field} = {value!r} is refused; accepted: numbers {spec.accepted_range()}"
        ) from error
    is_valid = np.isfinite(array)
    for name, bound in bounds.items():
        is_valid = is_valid & _COMPARISONS[name](array, bound)
    if not np.all(is_valid):
        first = float(array[~is_valid].flat[0])
        raise InputError(f"{field} = {first:g} is refused; accepted: {spec.accepted_range()}")
    return array
