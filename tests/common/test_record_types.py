# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""dtypes from declarations of records."""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.parameter_record import record_of
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_common.vehicle import Vehicle
from trackslip_common.vehicle_files import ParametersWithVehicle, load_vehicle


class Part(Record):
    """A nested record."""

    number: int
    is_valid: bool


class Whole(Record):
    """A record with all kinds of fields."""

    KIND: ClassVar[str] = "no field"
    value: float
    mean: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, (3, 3)]
    counts: Annotated[IntArray, 2]
    part: Part
    parts: Annotated[Table[Part], 4]


class More(Whole):
    """A record with more fields after the inherited ones."""

    last: int


@dataclass(frozen=True, kw_only=True)
class Size(Parameters):
    """A parameter group."""

    count: int = parameter("a number")


@dataclass(frozen=True, kw_only=True)
class Numbers(Parameters):
    """A group of numbers, and another that may be absent."""

    size: Size
    share: float = parameter("a number")
    absent: Size | None


@dataclass(frozen=True, kw_only=True)
class Machine(Numbers, ParametersWithVehicle):
    """Parameters with a text and a vehicle, which records cannot hold as they are."""

    frame: str = parameter("a text")


class MachineRecord(Numbers, Record):
    """Parameters for compiled code, and a value computed from them."""

    vehicle: Vehicle
    square: float


def test_a_declaration_has_the_dtype_of_its_fields_in_their_order() -> None:
    part = np.dtype([("number", np.int64), ("is_valid", np.bool_)], align=True)
    fields = [
        ("value", np.float64),
        ("mean", np.float64, (3,)),
        ("covariance", np.float64, (3, 3)),
        ("counts", np.int64, (2,)),
        ("part", part),
        ("parts", part, (4,)),
    ]
    assert dtype_of(Whole) == np.dtype(fields, align=True)
    assert dtype_of(More) == np.dtype([*fields, ("last", np.int64)], align=True)


def test_field_of_an_unsupported_type_is_refused() -> None:
    class Wrong(Record):
        name: str

    with pytest.raises(TypeError, match="name"):
        dtype_of(Wrong)


def test_a_table_is_an_array_of_records() -> None:
    table = make_table(Part, dtype_of(Part), 2, 3)
    assert table.shape == (2, 3)
    table[1, 2]["number"] = 7
    assert table["number"].tolist() == [[0, 0, 0], [0, 0, 7]]


def test_parameters_become_a_record_but_for_groups_that_may_be_absent() -> None:
    p = Numbers(size=Size(count=3), share=0.5, absent=Size(count=4))
    size = np.dtype([("count", np.int64)], align=True)
    assert dtype_of(Numbers) == np.dtype([("size", size), ("share", np.float64)], align=True)
    record: Any = record_of(Numbers, p)[0]
    assert record.item() == ((3,), 0.5)


def test_a_record_has_those_parameters_that_it_declares_and_its_vehicle_whole() -> None:
    vehicle = load_vehicle("pc05")
    p = Machine(size=Size(count=3), share=0.5, absent=None, vehicle=vehicle, frame="base_link")
    record = record_of(MachineRecord, p)[0]
    assert (record["size"]["count"], record["share"], record["square"]) == (3, 0.5, 0.0)
    assert record["vehicle"]["tread"] == vehicle.whole().tread
    assert record["vehicle"]["mass"] == vehicle.whole().mass
