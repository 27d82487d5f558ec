# SPDX-License-Identifier: Apache-2.0
"""Arguments of the formulas: arrays of finite numbers inside their range, or an ``InputError``."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackslip_common.errors import InputError
from trackslip_common.parameters import Spec

FloatArray = NDArray[np.float64]


def checked(
    field: str,
    value: ArrayLike,
    unit: str = "",
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> FloatArray:
    """``value`` as an array of any shape.

    Raises:
        InputError: a number is missing, not finite or out of range; the line shows the first such one.
    """
    spec = Spec(field, unit, gt, ge, lt, le)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{field} = {value!r} is refused; accepted: numbers {spec.accepted()}") from error
    good = np.isfinite(array)
    for bound, holds in ((gt, np.greater), (ge, np.greater_equal), (lt, np.less), (le, np.less_equal)):
        if bound is not None:
            good = good & holds(array, bound)
    if not np.all(good):
        first = float(array[~good].flat[0])
        raise InputError(f"{field} = {first:g} is refused; accepted: {spec.accepted()}")
    return array
