# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as compiled code takes them: one numpy record, nested groups as nested records."""

from types import UnionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, own_fields
from trackslip_common.vehicle import Vehicle, VehicleParameters

_KINDS = {bool: "?", int: "i8", float: "f8"}


def record_of(parameters: Parameters) -> NDArray[Any]:
    """(1,) record of all numbers, by their names; a vehicle is given whole.

    Texts, lists and groups that may be absent are left out.

    Raises:
        InputError: the vehicle cannot be given whole.
    """
    record = np.zeros(1, _dtype_of(type(parameters)))
    _fill(record[0], parameters)
    return record


def _dtype_of(cls: type) -> np.dtype[Any]:
    fields: list[tuple[str, Any]] = []
    for name, kind, spec in own_fields(cls):
        if isinstance(kind, UnionType):  # may be absent
            continue
        if spec is None:
            fields.append((name, _dtype_of(Vehicle if kind is VehicleParameters else kind)))
        elif kind in _KINDS:
            fields.append((name, _KINDS[kind]))
    return np.dtype(fields, align=True)


def _fill(record: Any, parameters: Parameters) -> None:
    for name in record.dtype.names:
        value = getattr(parameters, name)
        if isinstance(value, VehicleParameters):
            value = value.whole()
        if isinstance(value, Parameters):
            _fill(record[name], value)
        else:
            record[name] = value
