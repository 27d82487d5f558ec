# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as compiled code takes them: one numpy record, nested groups as nested records.

All numbers, by their names. Texts, lists and groups that may be absent are left out; a vehicle is given
whole.
"""

from types import UnionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, own_fields
from trackslip_common.vehicle import Vehicle, VehicleParameters

_KINDS = {bool: "?", int: "i8", float: "f8"}


def record_of(parameters: Parameters) -> NDArray[Any]:
    """(1,) record of the parameters.

    Raises:
        InputError: the vehicle cannot be given whole.
    """
    record = np.zeros(1, np.dtype(fields_of(type(parameters)), align=True))
    fill_record(record[0], parameters)
    return record


def fields_of(cls: type) -> list[tuple[str, Any]]:
    """Fields of the record of a class of parameters; another record may have more beside them."""
    fields: list[tuple[str, Any]] = []
    for name, kind, spec in own_fields(cls):
        if isinstance(kind, UnionType):  # may be absent
            continue
        if spec is None:
            group = Vehicle if kind is VehicleParameters else kind
            fields.append((name, np.dtype(fields_of(group), align=True)))
        elif kind in _KINDS:
            fields.append((name, _KINDS[kind]))
    return fields


def fill_record(record: Any, parameters: Parameters) -> None:
    """Set the fields of a record that are those of parameters.

    Raises:
        InputError: the vehicle cannot be given whole.
    """
    for name, _ in fields_of(type(parameters)):
        value = getattr(parameters, name)
        if isinstance(value, VehicleParameters):
            value = value.whole()
        if isinstance(value, Parameters):
            fill_record(record[name], value)
        else:
            record[name] = value
