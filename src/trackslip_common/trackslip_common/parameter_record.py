# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as compiled code takes them: a record, nested groups as nested records.

What a record has of them its declaration says (``record_types``): a class of parameters itself, or one that
has fields of their names. A vehicle is given whole.
"""

from typing import cast

import numpy as np

from trackslip_common.parameters import Parameters, own_fields
from trackslip_common.record_types import DeclaredT, Record, Table, dtype_of, make_table
from trackslip_common.vehicle import VehicleParameters


def record_of(declared: type[DeclaredT], parameters: Parameters) -> Table[DeclaredT]:
    """(1,) of a declaration, with parameters in the fields of their names.

    Raises:
        InputError: the vehicle cannot be given whole.
    """
    table = make_table(declared, dtype_of(declared), 1)
    fill_record(table[0], parameters)
    return table


def fill_record(record: Record | Parameters, parameters: Parameters) -> None:
    """Set the fields of a record that have the names of parameters.

    Raises:
        InputError: the vehicle cannot be given whole.
    """
    fields = cast("np.void", record)
    for name, _, _ in own_fields(type(parameters)):
        if name not in (fields.dtype.names or ()):
            continue
        value = getattr(parameters, name)
        if isinstance(value, VehicleParameters):
            value = value.whole()
        if isinstance(value, Parameters):
            fill_record(fields[name], value)
        else:
            fields[name] = value
