# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as records for compiled code; nested groups become nested records.

The declaration of a record (``record_types``) selects its parameters: a class of parameters itself, or one
with fields of their names. A vehicle becomes a whole machine (``VehicleParameters.whole``).
"""

from typing import cast

import numpy as np

from trackslip_common.parameters import Parameters, own_fields
from trackslip_common.record_types import DeclaredT, Record, Table, dtype_of, make_table
from trackslip_common.vehicle import VehicleParameters


def record_of(declared: type[DeclaredT], parameters: Parameters) -> Table[DeclaredT]:
    """(1,) record of a declaration, with the parameters that have the names of its fields.

    Raises:
        InputError: the vehicle lacks mass or hydraulics.
    """
    table = make_table(declared, dtype_of(declared), 1)
    fill_record(table[0], parameters)
    return table


def fill_record(record: Record | Parameters, parameters: Parameters) -> None:
    """Set the fields of a record that have the names of parameters.

    Raises:
        InputError: the vehicle lacks mass or hydraulics.
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
